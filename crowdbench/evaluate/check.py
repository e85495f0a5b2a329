"""Checks what a planner keeps of its contract, point by point, on real episodes."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.errors import InputError
from crowdbench.evaluate.contract import Asked, Fault, examine
from crowdbench.evaluate.driver import DecisionLimitExceeded, Driver
from crowdbench.evaluate.rollout import rollout
from crowdbench.geometry import norm
from crowdbench.planners.base import Planner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Observation

ROUNDING = 1e-6
"""Commands that differ by no more than this, in m/s, are the same up to rounding."""

TIES = 0.01
"""Share of commands that may depend on the batch, whose size changes how a network's values are rounded."""

NO_COMMAND = "not examined: the planner returned no array of velocities"


@dataclass(frozen=True)
class Point:
    """One point of the contract.

    Attributes:
        name: What it is called.
        kept: Whether the planner keeps it; None where that could not be examined.
        seen: What was seen, in a few words.
    """

    name: str
    kept: bool | None
    seen: str


def check(
    make: Callable[[], Planner], name: str, scenario: Scenario, cases: Cases, decision_limit: float
) -> list[Point]:
    """Drive planners through cases and examine each point of the contract by itself.

    Commands that break the contract are replaced by ones that keep it, so that the episodes go on.

    Args:
        make: Makes a new planner.
        name: What the planner is called in errors.
        scenario: The scenario of the cases.
        cases: The cases.
        decision_limit: Seconds that the planner may take for a decision, for all worlds together.

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
    everybody = np.arange(len(cases))
    alone = [everybody[row : row + 1] for row in everybody]
    return [
        Point("exceptions", not raised, raised or f"none in {len(witness.calls)} calls"),
        _decision_time(witness, late, decision_limit),
        *_answers(witness),
        # The same planner, so that what it remembers beyond its `reset` is found too.
        again.point("deterministic", "when it sees the same episodes again", lambda: witness.planner, [everybody], 0.0),
        again.point("batch", "when a case runs alone", make, alone, TIES),
    ]


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
        examined: At how many commands each point could be examined.
        faults: The first fault found at each point, with case and step.

    Args:
        planner: The planner.
        cases: The case numbers by `Observation.row`.
    """

    def __init__(self, planner: Planner, cases: Int[np.ndarray, "case"]) -> None:
        self.planner = planner
        self.cases = cases
        self.privileged = planner.privileged
        self.raised = False
        self.calls: list[_Call] = []
        self.dtypes: set[str] = set()
        self.examined: Counter[str] = Counter()
        self.faults: dict[str, str] = {}

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
        examined = examine(answer, shown.vehicle.preferred_speed)
        self.calls.append(_Call(shown, examined.commands, seconds))
        for point, fault in examined.points.items():
            self._note(point, fault, shown)
        self._note("observation", _changed(shown, obs), shown)
        return _legal(examined.commands, shown.vehicle.preferred_speed)

    @contextlib.contextmanager
    def _noticing(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self.raised = True
            raise

    def _note(self, point: str, fault: Fault | None, shown: Observation) -> None:
        self.examined[point] += len(shown)
        if fault is not None:
            self.faults.setdefault(point, fault.at(Asked.of(shown, self.cases)))


def _decision_time(witness: _Witness, late: str, limit: float) -> Point:
    commands = sum(len(call.obs) for call in witness.calls)
    if late or not commands:
        return Point("decision time", False if late else None, late or NO_COMMAND)
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
        ("speed", "never above the vehicle's maximum speed"),
        ("observation", "left unchanged"),
    ):
        if point in witness.faults:
            yield Point(point, False, witness.faults[point])
        elif witness.examined[point]:
            yield Point(point, True, f"{kept} ({witness.examined[point]} commands)")
        else:
            yield Point(point, None, NO_COMMAND)


class _Replay:
    """Shows planners again what the first one was shown, and compares their commands with its own."""

    def __init__(self, name: str, decision_limit: float, first: _Witness) -> None:
        self.name, self.decision_limit, self.first = name, decision_limit, first
        in_time = [call for call in first.calls if call.seconds <= decision_limit]
        self.shown = [(call.obs, call.command) for call in in_time if call.command is not None]

    def point(
        self,
        name: str,
        when: str,
        make: Callable[[], Planner],
        groups: Sequence[Int[np.ndarray, "row"]],
        most: float,
    ) -> Point:
        """Whether planners give the same commands.

        Args:
            name: Name of the point.
            when: When they might not, as said to people.
            make: The planner for each group.
            groups: The rows, in ascending order, that each planner is shown.
            most: Share of the commands that may differ.
        """
        if not self.shown:
            return Point(name, None, NO_COMMAND)
        again = [np.full_like(command, np.nan) for _, command in self.shown]
        try:
            for rows in groups:
                self._drive(make(), rows, again)
        except InputError as error:
            return Point(name, False, f"{when}: {error}")
        before = np.concatenate([command for _, command in self.shown])
        same = np.isclose(np.concatenate(again), before, rtol=0.0, atol=ROUNDING, equal_nan=True).all(axis=1)
        share = float(1.0 - same.mean())
        return Point(name, share <= most, f"{share:.2%} of commands differ {when} (at most {most:.0%} may)")

    def _drive(self, planner: Planner, group: Int[np.ndarray, "row"], again: list[np.ndarray]) -> None:
        """Write into `again` what a planner answers in the given rows, which it sees as a batch of their own.

        Raises InputError where it raises, takes too long, or breaks a point that the first one has kept.
        """
        cases = self.first.cases[group]
        witness = _Witness(planner, cases)
        driver = Driver(witness, self.name, self.decision_limit)
        driver.reset(cases)
        for (obs, _), commands in zip(self.shown, again, strict=True):
            running = np.flatnonzero(np.isin(obs.row, group))
            if len(running):
                shown = obs.take(running)
                driver.decide(dataclasses.replace(shown, row=np.searchsorted(group, shown.row)))
                if (answer := witness.calls[-1].command) is not None:
                    commands[running] = answer
        for point, fault in witness.faults.items():
            if point not in self.first.faults:
                raise InputError(f"planner {self.name} {fault}")


def _legal(
    commands: Float[np.ndarray, "world 2"] | None, max_speed: Float[np.ndarray, "world"]
) -> Float[np.ndarray, "world 2"]:
    """Commands in m/s that keep the contract: slowed down, or standing still where nothing else can be made of them."""
    if commands is None:
        return np.zeros((len(max_speed), 2))
    finite = np.where(np.isfinite(commands).all(axis=1, keepdims=True), commands, 0.0)
    speed = norm(finite)
    fast = speed > max_speed
    return finite * np.where(fast, max_speed / np.where(fast, speed, 1.0), 1.0)[:, None]


def _changed(before: Observation, after: Observation) -> Fault | None:
    """Which array of an observation is another after the planner has seen it."""
    for (path, array), (_, now) in zip(_arrays("obs", before), _arrays("obs", after), strict=True):
        same = (array == now) | ((array != array) & (now != now))
        if not same.all():
            return Fault(f"changes {path}", int(np.argwhere(~same)[0, 0]))
    return None


def _arrays(path: str, part: Any) -> Iterator[tuple[str, np.ndarray]]:
    for field in dataclasses.fields(part):
        value, name = getattr(part, field.name), f"{path}.{field.name}"
        if isinstance(value, np.ndarray):
            yield name, value
        elif dataclasses.is_dataclass(value):
            yield from _arrays(name, value)
