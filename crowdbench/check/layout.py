"""Checks what a layout keeps of its contract, on the crowds of a scenario."""

from __future__ import annotations

import contextlib
import dataclasses
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.check.examination import Examination
from crowdbench.check.result import CheckResult
from crowdbench.core import rng
from crowdbench.core.geometry import norm
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.placement import (
    Layout,
    LayoutCall,
    Placement,
    Way,
    add_routes,
    check_finite,
    check_obstacles,
    check_routes,
    check_shape,
    complete_placement,
)
from crowdbench.scenario.respawn import LayoutWithRespawn, Room, draw_again
from crowdbench.scenario.scenario import Scenario
from crowdbench.scenario.starts import LayoutStarts
from crowdbench.utils.errors import InputError, plugin_errors


@dataclass(frozen=True)
class _Crowd:
    """The agents of a case, to be placed: a batch of one world.

    Attributes:
        case: Its number.
        key: Start of the random streams of the case.
        radius: Radii in metres.
        speed: Preferred speeds in m/s.
        before: The state of the random generators that all code shares, before the first try.
    """

    case: int
    key: np.uint64
    radius: Float[np.ndarray, "agent"]
    speed: Float[np.ndarray, "agent"]
    before: tuple[Any, Any]

    def __len__(self) -> int:
        return 1


def check_layout(layout: Layout, name: str, scenario: Scenario, cases: Cases) -> list[CheckResult]:
    """Let a layout place the crowds of some cases and examine each part of its contract by itself.

    Args:
        layout: A layout, with its options if any: a function `(rng, radius, preferred_speed) -> Placement`.
        name: What the layout is called in errors.
        scenario: The scenario whose crowds are placed.
        cases: The cases.
    """
    call = layout if isinstance(layout, LayoutCall) else LayoutCall(layout)
    starts = LayoutStarts(call, getattr(scenario.starts, "crowdnav_cases", 0))
    whole = dataclasses.replace(scenario, starts=starts)
    examination = _LayoutExamination(lambda: layout, name)
    findings = examination.findings
    placed = []
    keys = rng.case_keys(scenario.seed, cases.split, cases.indices)
    for case, key in zip(cases.indices.tolist(), keys, strict=True):
        traits = scenario.crowd.draw(rng.generator(key, "crowd"))
        radius = np.append(scenario.vehicle.radius, traits.radius)
        speed = np.append(scenario.vehicle.speed, traits.preferred_speed)
        crowd = _Crowd(case, key, radius, speed, _shared_state())
        placement = examination.ask(crowd)
        if placement is not None:
            placed.append((crowd, placement))
            findings.note("whole cases", 1, _find_fault(whole, cases.split, crowd, placement))
    return [
        findings.result("exceptions", "none"),
        findings.result("shape", "a Placement with a start and a goal [agent, 2]"),
        findings.result("finite", "all numbers"),
        findings.result("obstacles", "sound, and nobody in a wall"),
        findings.result("ways", "one for everybody, through no wall"),
        findings.result("overlap", "none at the start"),
        findings.result("goal", "no start is its own goal"),
        findings.result("whole cases", "can be started, with groups and all else that the scenario says"),
        findings.result("random numbers", "only from its stream"),
        examination.check_deterministic("when it is given the same again, from the last to the first"),
        _check_respawn(call, f"layout {name}", placed, is_needed=scenario.renewal is not None),
    ]


class _LayoutExamination(Examination[Layout, _Crowd]):
    units = "cases"
    answers = "placements"
    missing = "not examined: the layout returned no placement"
    after: tuple[Any, Any] = (None, ())
    """The state of the random generators that all code shares, after the last try."""
    batch_names = "crowd", "crowd"

    def ask(self, batch: _Crowd) -> Placement | None:
        """Let the layout place a crowd, and examine also what would not keep it from being used."""
        placement: Placement | None = super().ask(batch)
        name = self._title(batch)
        used = _find_used(batch.before, self.after)
        self.findings.note("random numbers", 1, f"{name} draws from {used} instead of its stream" if used else None)
        if placement is not None:
            radius = batch.radius
            self.findings.note("overlap", 1, _find_overlap(placement.start, radius, name))
            self.findings.note("goal", 1, _find_at_goal(placement, radius, name))
            steps = {
                "obstacles": _named(name)(lambda _: check_obstacles(placement, radius)),
                "ways": _named(name)(lambda among: check_routes(add_routes(among, radius), radius)),
            }
            self.findings.examine(1, steps)
        return placement

    def query(self, plugin: Layout, batch: _Crowd) -> object:
        # Whoever draws from the shared generators is told so by another check.
        python, numpy = batch.before
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
        with plugin_errors(f"{self._title(batch)} raised"):
            try:
                return plugin(rng.generator(batch.key, "places"), batch.radius.copy(), batch.speed.copy())
            finally:
                self.after = _shared_state()

    def validators(self, batch: _Crowd) -> dict[str, Callable[[Any], Any]]:
        name, agents = self._title(batch), len(batch.radius)
        shape = _named(name)(lambda answer: check_shape(answer, agents))
        return {"shape": shape, "finite": _named(name)(check_finite)}

    def numbers(self, plugin: Layout, answer: Placement, batch: _Crowd) -> Float[np.ndarray, "1 n"]:
        parts = (answer.start, answer.goal, answer.route, answer.obstacles)
        return np.concatenate([part.ravel() for part in parts if part is not None])[None]

    def take(self, batch: _Crowd, rows: Int[np.ndarray, "row"]) -> _Crowd:
        return batch

    def _title(self, crowd: _Crowd) -> str:
        return f"layout {self.name} in case {crowd.case}"


@contextlib.contextmanager
def _named(name: str) -> Iterator[None]:
    """Begins the sentence of an InputError that is raised within with the name of what is examined."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _find_fault(scenario: Scenario, split: str, crowd: _Crowd, placement: Placement) -> str | None:
    """What keeps a run from starting a case that the layout alone could start; nothing if it starts."""
    with contextlib.suppress(InputError):  # which other checks tell
        complete_placement(placement, crowd.radius)
        try:
            scenario.draw(split, np.array([crowd.case]))
        except InputError as error:
            return str(error)
    return None


def _check_respawn(
    layout: LayoutCall, name: str, placed: list[tuple[_Crowd, Placement]], is_needed: bool
) -> CheckResult:
    """Whether somebody new, and another goal, can be drawn among those who are placed."""
    # Whether a layout that draws by itself is deterministic is another check.
    times = 2 if isinstance(layout.function, LayoutWithRespawn) else 1
    crowds = [(crowd, placement) for crowd, placement in placed if len(crowd.radius) > 1]
    if not crowds:
        return CheckResult("again", None, "not examined: the layout placed no pedestrian")
    found = 0
    for crowd, placement in crowds:
        for position in (None, placement.start[-1]):
            try:
                one, *others = (_respawn_last(layout, crowd, placement, position) for _ in range(times))
            except InputError as error:
                return CheckResult("again", False, f"{name}: {error}")
            if not all(np.array_equal(np.array(one), np.array(other)) for other in others):
                seen = f"{name} draws {one} from a stream and then {others} from the same one"
                return CheckResult("again", False, seen)
            found += one is not None
    seen = f"room for {found} of {2 * len(crowds)} new people and goals"
    if not found and not is_needed:
        return CheckResult("again", True, f"{seen}, whom this scenario does not draw")
    return CheckResult("again", found > 0, seen)


def _respawn_last(layout: LayoutCall, crowd: _Crowd, placement: Placement, position: np.ndarray | None) -> Way | None:
    """What is drawn for the last pedestrian of a crowd. Raises InputError where that cannot be."""
    obstacles = np.empty((0, 0, 2)) if placement.obstacles is None else placement.obstacles
    room = Room(placement.start[:-1], placement.goal[:-1], crowd.radius[:-1], crowd.speed[:-1], obstacles)
    radius, speed = float(crowd.radius[-1]), float(crowd.speed[-1])
    way = draw_again(layout, rng.generator(crowd.key, "places again"), room, radius, speed, position)
    if way is None:
        return None
    start, goal = way
    if position is not None and not np.array_equal(start, position):
        raise InputError(f"who gets another goal is put at {start.tolist()}, but is at {position.tolist()}")
    if not room.is_clear(start, radius, clearance=0.0, walls=0.0) and position is None:
        raise InputError(f"somebody new at {start.tolist()} overlaps with somebody, a goal or a wall")
    if room.way(start, goal, radius) is None:
        raise InputError(f"no way leads somebody from {start.tolist()} to its goal at {goal.tolist()}")
    return way


def _find_overlap(start: Float[np.ndarray, "agent 2"], radius: Float[np.ndarray, "agent"], name: str) -> str | None:
    """Which two agents overlap at the start."""
    gap = norm(start[:, None] - start) - (radius[:, None] + radius)
    np.fill_diagonal(gap, np.inf)
    one, other = sorted(int(agent) for agent in np.unravel_index(gap.argmin(), gap.shape))
    if gap[one, other] >= 0.0:
        return None
    return f"{name} lets agents {one} and {other} overlap by {-gap[one, other]:.3g} m at the start"


def _find_at_goal(placement: Placement, radius: Float[np.ndarray, "agent"], name: str) -> str | None:
    """Which agent starts at its goal."""
    distance = norm(placement.goal - placement.start)
    if distance[0] < radius[0]:
        return f"{name} lets the vehicle start {distance[0]:.3g} m from its goal, where it has arrived"
    if (distance == 0.0).any():
        return f"{name} lets agent {int((distance == 0.0).argmax())} start at its goal"
    return None


def _shared_state() -> tuple[Any, Any]:
    """The state of the two random generators that all code shares, Python's and NumPy's."""
    return random.getstate(), np.random.get_state(legacy=True)  # noqa: NPY002 (to find who uses it)


def _find_used(before: tuple[Any, Any], after: tuple[Any, Any]) -> str:
    """The names of the shared generators of which there are two different states."""
    (python, numpy), (python_before, numpy_before) = after, before
    same_numpy = all(np.array_equal(*pair) for pair in zip(numpy, numpy_before, strict=True))
    names = {"Python's shared generator": python != python_before, "NumPy's shared generator": not same_numpy}
    return " and ".join(name for name, changed in names.items() if changed)
