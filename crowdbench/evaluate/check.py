"""Holds a planner to its contract, point by point, on real episodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.errors import InputError
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.rollout import rollout
from crowdbench.planners.base import Planner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Observation, Pedestrians, Vehicle

ROUNDING = 1e-6
"""Commands that differ by no more than this, in m/s, are the same up to rounding."""

TIES = 0.01
"""Share of commands that may depend on the batch: ties between a network's commands fall either way."""


@dataclass(frozen=True)
class Point:
    """One point of the contract: whether it is kept, and what was seen."""

    name: str
    kept: bool
    seen: str


def check(
    make: Callable[[], Planner], name: str, scenario: Scenario, cases: Cases, decision_limit: float
) -> list[Point]:
    """Drive planners made by `make` through `cases` and say what they keep of the contract.

    A planner that breaks it at once (shape, type, speed, ...) is not examined further.
    """
    witness = _Witness(make())
    driver = Driver(witness, name, decision_limit)
    try:
        trace = rollout(driver, scenario, cases)
    except InputError as error:
        return [Point("commands", False, str(error))]
    steps = int(trace.steps.sum())
    points = [
        Point("shape", True, f"[world, 2] in {len(witness.commands)} calls"),
        Point("dtype", True, f"{witness.dtype}"),
        Point("finite", True, f"all of {steps} commands"),
        Point("speed", True, "never above the vehicle's preferred speed"),
        Point(
            "decision time",
            True,
            f"{1e3 * driver.seconds / steps:.3g} ms per command, limit {decision_limit:g} s a call",
        ),
        Point(
            "observation", not witness.changed, f"changes {witness.changed}" if witness.changed else "left as it was"
        ),
    ]

    def fresh() -> Driver:
        return Driver(make(), name, decision_limit)

    commands = np.concatenate(witness.commands)
    for point, most, when, replay in (
        ("deterministic", 0.0, "when the same episodes are driven again", _replay),
        ("batch", TIES, "when a case runs alone", _alone),
    ):
        try:
            share = _share_changed(commands, replay(fresh, witness.observations, cases.indices))
            seen = f"{share:.2%} of commands differ {when} (at most {most:.0%} may)"
            points.append(Point(point, share <= most, seen))
        except InputError as error:
            points.append(Point(point, False, f"{when}: {error}"))
    return points


class _Witness(Planner):
    """Passes a planner's commands on, and keeps what it was shown, what it said, and whether it touched anything."""

    def __init__(self, planner: Planner) -> None:
        self.planner = planner
        self.privileged = planner.privileged
        self.observations: list[Observation] = []
        self.commands: list[Float[np.ndarray, "world 2"]] = []
        self.changed = ""
        self.dtype = ""

    def reset(self, cases: Int[np.ndarray, "world"]) -> None:
        self.planner.reset(cases)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        before = obs.take(slice(None))
        self.observations.append(before)
        command = self.planner.plan(obs)
        for part, field, seen in _arrays(before):
            if not np.array_equal(seen, getattr(getattr(obs, part) if part else obs, field)):
                self.changed = f"obs.{part}{'.' if part else ''}{field}"
        if isinstance(command, np.ndarray):
            self.dtype = str(command.dtype)
            self.commands.append(command.copy())
        return command


def _replay(make: Callable[[], Driver], observations: list[Observation], cases: Int[np.ndarray, "world"]) -> np.ndarray:
    """The commands of a new planner that is shown the same observations."""
    driver = make()
    driver.reset(cases)
    return np.concatenate([driver.decide(obs.take(slice(None))) for obs in observations])


def _alone(make: Callable[[], Driver], observations: list[Observation], cases: Int[np.ndarray, "world"]) -> np.ndarray:
    """The commands for the same observations, each case shown to a planner of its own."""
    commands = [np.empty((len(obs), 2)) for obs in observations]
    for case in cases:
        driver = make()
        driver.reset(np.array([case]))
        for obs, command in zip(observations, commands, strict=True):
            rows = np.flatnonzero(obs.case == case)
            if len(rows):
                command[rows] = driver.decide(obs.take(rows))
    return np.concatenate(commands)


def _share_changed(a: Float[np.ndarray, "command 2"], b: Float[np.ndarray, "command 2"]) -> float:
    return float((np.abs(a - b).max(axis=1) > ROUNDING).mean())


def _arrays(obs: Observation) -> list[tuple[str, str, np.ndarray]]:
    """Every array of an observation as (part, field, array); the part is empty for the observation's own."""
    parts: dict[str, Observation | Vehicle | Pedestrians] = {
        "": obs,
        "vehicle": obs.vehicle,
        "pedestrians": obs.pedestrians,
    }
    return [
        (part, field.name, getattr(owner, field.name))
        for part, owner in parts.items()
        for field in dataclasses.fields(owner)
        if isinstance(getattr(owner, field.name), np.ndarray)
    ]
