"""Checks what a planner keeps of its contract, point by point, on real episodes."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.dynamics import FREE, Dynamics, Holonomic
from crowdbench.errors import InputError
from crowdbench.evaluate.check.again import BATCHES, NETWORKS, ROUNDING, Tolerance, same_point
from crowdbench.evaluate.check.point import Findings, Point, changed
from crowdbench.evaluate.check.sight import UNEXAMINED, few
from crowdbench.evaluate.contract import Asked, Fault, examine
from crowdbench.evaluate.driver import DecisionLimitExceeded, Driver
from crowdbench.evaluate.replanning import Replanning
from crowdbench.evaluate.rollout import rollout
from crowdbench.geometry import norm
from crowdbench.planners.base import OneStepOnly, Planner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Observation

MISSING = "not examined: the planner returned no array of commands"

AHEAD = 8
"""Steps that `plan_ahead` is asked for."""

COMMANDS = "commands"


def check_planner(
    make: Callable[[], Planner],
    name: str,
    scenario: Scenario,
    cases: Cases,
    decision_limit: float,
    limited: Scenario | None = None,
) -> list[Point]:
    """Drive planners through cases and examine each point of the contract by itself.

    Commands that break the contract are replaced by ones that keep it, so that the episodes go on.

    Args:
        make: Makes a new planner.
        name: What the planner is called in errors.
        scenario: The scenario of the cases.
        cases: The cases.
        decision_limit: Seconds that the planner may take for a decision, for all worlds together.
        limited: A scenario in which the vehicle does not see everybody, if planners are to drive through some of its
            cases too.

    Raises:
        InputError: Something other than the planner breaks its contract.
    """
    witness = _Witness(make(), cases.indices)
    late = raised = ""
    try:
        rollout(Driver(witness, name, decision_limit), scenario, cases)
    except DecisionLimitExceeded as error:
        late = str(error)
    except InputError as error:
        if not witness.raised:
            raise
        raised = str(error)
    again = _Replay(name, decision_limit, witness)
    batches = {when: (make, split(len(cases))) for when, split in BATCHES.items()}
    # The same planner, so that what it remembers beyond its `reset` is found too.
    same = {"when it sees the same episodes again": (lambda: witness.planner, [np.arange(len(cases))])}
    points = [
        Point("exceptions", not raised, raised or f"none in {len(witness.calls)} calls"),
        _decision_time(witness, late, decision_limit),
        *_answers(witness),
        again.point("deterministic", same, Tolerance(ROUNDING, 0.0)),
        again.point("batch", batches, NETWORKS),
        *(_plan_ahead(make(), name, scenario, cases, decision_limit) if witness.calls else ()),
    ]
    if limited is not None:
        sound = all(point.kept for point in points)
        points.append(_limited_sight(make(), name, limited, cases, decision_limit) if sound else UNEXAMINED)
    return points


@dataclass(frozen=True)
class _Call:
    """What a planner was shown, its commands in m/s (None where it returned something else), and how long it took."""

    obs: Observation
    command: Float[np.ndarray, "world 2"] | None
    seconds: float


class _Witness(Planner):
    """Keeps all that a planner is shown and answers, and passes on commands that keep the contract.

    Attributes:
        raised: Whether the planner raised an exception.
        calls: Its answers.
        dtypes: The types that they had.
        findings: What was found at each point, with case and step.
        one_step: Whether it has said that it decides one step at a time.

    Args:
        planner: The planner.
        cases: The case numbers by `Observation.row`.
    """

    def __init__(self, planner: Planner, cases: Int[np.ndarray, "case"]) -> None:
        self.planner = planner
        self.cases = cases
        self.privileged = planner.privileged
        self.native = planner.native
        self.raised = False
        self.calls: list[_Call] = []
        self.dtypes: set[str] = set()
        self.findings = Findings(COMMANDS, MISSING)
        self.one_step = False

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        with self._noticing():
            self.planner.reset(rows)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        shown = obs.take(slice(None))
        start = time.perf_counter()
        with self._noticing():
            answer = self.planner.plan(obs)
        seconds = time.perf_counter() - start
        self.dtypes.add(str(answer.dtype) if isinstance(answer, np.ndarray) else type(answer).__name__)
        dynamics = shown.vehicle.dynamics if self.native else FREE
        examined = examine(answer, shown.vehicle.preferred_speed, dynamics=dynamics)
        self.calls.append(_Call(shown, examined.commands, seconds))
        for point, fault in examined.points.items():
            self._note(point, fault, shown)
        found = changed("obs", shown, obs)
        self._note("observation", found and Fault(f"changes {found[0]}", found[1]), shown)
        return _legal(examined.commands, shown.vehicle.preferred_speed, dynamics)

    def plan_ahead(self, obs: Observation, steps: int) -> Any:
        try:
            return self.planner.plan_ahead(obs, steps)
        except OneStepOnly:
            self.one_step = True
            raise

    @contextlib.contextmanager
    def _noticing(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self.raised = True
            raise

    def _note(self, point: str, fault: Fault | None, shown: Observation) -> None:
        sentence = None if fault is None else fault.at(Asked.of(shown, self.cases))
        self.findings.note(point, len(shown), sentence)


def _decision_time(witness: _Witness, late: str, limit: float) -> Point:
    commands = sum(len(call.obs) for call in witness.calls)
    if late or not commands:
        return Point("decision time", False if late else None, late or MISSING)
    seconds = [call.seconds for call in witness.calls]
    seen = (
        f"{1e3 * sum(seconds) / commands:.3g} ms per command, at most {max(seconds):.3g} s per call (limit {limit:g} s)"
    )
    return Point("decision time", True, seen)


def _answers(witness: _Witness) -> Iterator[Point]:
    """The points that are examined at every answer."""
    for point, kept in (
        ("dtype", ", ".join(sorted(witness.dtypes))),
        ("shape", "[world, 2]"),
        ("finite", "no NaN, no infinity"),
        (
            "speed",
            "never above the vehicle's maximum speed" if not witness.native else "never beyond the vehicle's limits",
        ),
        ("observation", "left unchanged"),
    ):
        yield witness.findings.point(point, kept)


def _limited_sight(planner: Planner, name: str, scenario: Scenario, cases: Cases, decision_limit: float) -> Point:
    """The point of driving without seeing everybody. Arguments as in `check_planner`."""
    cases = few(cases)
    try:
        rollout(Driver(planner, name, decision_limit), scenario, cases)
    except InputError as error:
        return Point("limited sight", False, str(error))
    return Point("limited sight", True, f"keeps the contract in {len(cases)} cases in which it does not see everybody")


def _plan_ahead(
    planner: Planner, name: str, scenario: Scenario, cases: Cases, decision_limit: float
) -> Iterator[Point]:
    """The point of a planner that decides several steps at once; none for others. Arguments as in `check_planner`."""
    witness = _Witness(planner, cases.indices)
    kept, seen = True, f"{AHEAD} steps at once: dtype, shape, finite and speed as above"
    try:
        rollout(Driver(witness, name, decision_limit), scenario, cases, replanning=Replanning(AHEAD, look_first=1))
    except InputError as error:
        kept, seen = False, str(error)
    if not witness.one_step:
        yield Point("plan_ahead", kept, seen)


class _Replay:
    """Shows planners again what the first one was shown, and compares their commands with its own."""

    def __init__(self, name: str, decision_limit: float, first: _Witness) -> None:
        self.name, self.decision_limit, self.first = name, decision_limit, first
        in_time = [call for call in first.calls if call.seconds <= decision_limit]
        self.shown = [(call.obs, call.command) for call in in_time if call.command is not None]

    def point(
        self,
        name: str,
        again: Mapping[str, tuple[Callable[[], Planner], list[Int[np.ndarray, "_"]]]],
        tolerance: Tolerance,
    ) -> Point:
        """Whether planners give the same commands.

        Args:
            name: Name of the point.
            again: By when they might not, what makes a planner for each batch, and the rows of each batch.
            tolerance: What may differ.
        """
        if not self.shown:
            return Point(name, None, MISSING)
        asks = {when: functools.partial(self._driven, *batches) for when, batches in again.items()}
        return same_point(name, COMMANDS, [command for _, command in self.shown], asks, tolerance)

    def _driven(
        self, make: Callable[[], Planner], batches: list[Int[np.ndarray, "_"]]
    ) -> list[Float[np.ndarray, "_ 2"]]:
        """What planners answer where each drives one of the batches."""
        again = [np.full_like(command, np.nan) for _, command in self.shown]
        for rows in batches:
            self._drive(make(), rows, again)
        return again

    def _drive(self, planner: Planner, group: Int[np.ndarray, "row"], again: list[np.ndarray]) -> None:
        """Write into `again` what a planner answers in the given rows, which it sees as a batch of their own.

        Raises InputError where it raises, takes too long, or breaks a point that the first one has kept.
        """
        cases = self.first.cases[group]
        witness = _Witness(planner, cases)
        driver = Driver(witness, self.name, self.decision_limit)
        driver.reset(cases)
        row_of = np.full(len(self.first.cases), -1)
        row_of[group] = np.arange(len(group))
        for (obs, _), commands in zip(self.shown, again, strict=True):
            own = row_of[obs.row]
            running = np.argsort(own)[(own < 0).sum() :]
            if len(running):
                driver.decide(dataclasses.replace(obs.take(running), row=own[running]))
                if (answer := witness.calls[-1].command) is not None:
                    commands[running] = answer
        for point, fault in witness.findings.faults.items():
            if point not in self.first.findings.faults:
                raise InputError(f"planner {self.name} {fault}")


def _legal(
    commands: Float[np.ndarray, "world 2"] | None, max_speed: Float[np.ndarray, "world"], dynamics: Dynamics
) -> Float[np.ndarray, "world 2"]:
    """Commands that keep the contract: made smaller, or standing still where nothing else can be made of them."""
    if commands is None:
        return np.zeros((len(max_speed), 2))
    finite = np.where(np.isfinite(commands).all(axis=1, keepdims=True), commands, 0.0)
    if not isinstance(dynamics, Holonomic):
        return np.clip(finite, *dynamics.space(max_speed))
    speed = norm(finite)
    fast = speed > max_speed
    return finite * np.where(fast, max_speed / np.where(fast, speed, 1.0), 1.0)[:, None]
