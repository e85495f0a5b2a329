"""Checks what a layout keeps of its contract, on the crowds of a scenario."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench import rng
from crowdbench.errors import InputError, plugin_errors
from crowdbench.evaluate.check.again import EXACT, same_point
from crowdbench.evaluate.check.point import Findings, Point
from crowdbench.geometry import norm
from crowdbench.scenario.again import Again, LayoutWithAgain, Room, Way, again_of, drawn
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.placement import Layout, Placement
from crowdbench.scenario.placing import clear, finite, shaped, sound, with_ways
from crowdbench.scenario.scenario import Scenario

MISSING = "not examined: the layout returned no placement"


@dataclass(frozen=True)
class _Crowd:
    """The agents of a case, to be placed.

    Attributes:
        key: Start of the random streams of the case.
        radius: Radii in metres.
        speed: Preferred speeds in m/s.
        before: The state of the random generators that all code shares, before the first try.
    """

    key: np.uint64
    radius: Float[np.ndarray, "agent"]
    speed: Float[np.ndarray, "agent"]
    before: _GlobalState


def check_layout(
    layout: Layout, name: str, scenario: Scenario, cases: Cases, again: Again | None = None
) -> list[Point]:
    """Let a layout place the crowds of some cases and examine each point of its contract by itself.

    Args:
        layout: A layout, with its options if any: a function `(rng, radius, preferred_speed) -> Placement`.
        name: What the layout is called in errors.
        scenario: The scenario whose crowds are placed.
        cases: The cases.
        again: How it draws people again, with its options if any; as `again_of` says if None.
    """
    findings = Findings("cases", MISSING)
    placed = []
    keys = rng.case_keys(scenario.seed, cases.split, cases.indices)
    for case, key in zip(cases.indices.tolist(), keys, strict=True):
        traits = scenario.people(rng.generator(key, "crowd"))
        radius = np.append(scenario.vehicle_radius, traits.radius)
        speed = np.append(scenario.vehicle_speed, traits.preferred_speed)
        crowd = _Crowd(key, radius, speed, _GlobalState.now())
        placement = _examined(layout, f"layout {name} in case {case}", crowd, findings)
        if placement is not None:
            placed.append((crowd, placement))
    return [
        findings.point("exceptions", "none"),
        findings.point("shape", "a Placement with a start and a goal [agent, 2]"),
        findings.point("finite", "all numbers"),
        findings.point("obstacles", "sound, and nobody in a wall"),
        findings.point("ways", "one for everybody, through no wall"),
        findings.point("overlap", "none at the start"),
        findings.point("goal", "no start is its own goal"),
        findings.point("random numbers", "only from its stream"),
        _deterministic(layout, name, placed),
        _drawn_again(again, layout, f"layout {name}", placed),
    ]


def _drawn_again(again: Again | None, layout: Layout, name: str, placed: list[tuple[_Crowd, Placement]]) -> Point:
    """Whether somebody new, and another goal, can be drawn among those who are placed."""
    # Whether a layout that draws by itself is deterministic is another point.
    times = 1 if again is None and not isinstance(layout, LayoutWithAgain) else 2
    draw = again or again_of(layout)
    crowds = [(crowd, placement) for crowd, placement in placed if len(crowd.radius) > 1]
    if not crowds:
        return Point("again", None, "not examined: the layout placed no pedestrian")
    found = 0
    for crowd, placement in crowds:
        for position in (None, placement.start[-1]):
            try:
                one, *others = (_one_again(draw, crowd, placement, position) for _ in range(times))
            except InputError as error:
                return Point("again", False, f"{name}: {error}")
            if not all(np.array_equal(np.array(one), np.array(other)) for other in others):
                return Point("again", False, f"{name} draws {one} from a stream and then {others} from the same one")
            found += one is not None
    return Point("again", True, f"room for {found} of {2 * len(crowds)} new people and goals")


def _one_again(again: Again, crowd: _Crowd, placement: Placement, position: np.ndarray | None) -> Way | None:
    """What is drawn for the last pedestrian of a crowd. Raises InputError where that cannot be."""
    none = np.empty((0, 0, 2))
    obstacles = none if placement.obstacles is None else placement.obstacles
    room = Room(placement.start[:-1], placement.goal[:-1], crowd.radius[:-1], crowd.speed[:-1], obstacles)
    radius, speed = float(crowd.radius[-1]), float(crowd.speed[-1])
    way = drawn(again, rng.generator(crowd.key, "places again"), room, radius, speed, position)
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


def _examined(layout: Layout, name: str, crowd: _Crowd, findings: Findings) -> Placement | None:
    """What a layout places; None where that is no placement with finite numbers."""
    placement = findings.examine(
        1,
        {
            "exceptions": lambda _: _asked(layout, name, crowd),
            "shape": lambda answer: _named(name, lambda: shaped(answer, len(crowd.radius))),
            "finite": lambda answer: _named(name, lambda: finite(answer)),
        },
    )
    drawn = _GlobalState.now().difference(crowd.before)
    findings.note("random numbers", 1, f"{name} draws from {drawn} instead of its stream" if drawn else None)
    if placement is not None:
        findings.note("overlap", 1, _overlap(placement.start, crowd.radius, name))
        findings.note("goal", 1, _at_goal(placement, crowd.radius, name))
        findings.examine(
            1,
            {
                "obstacles": lambda _: _named(name, lambda: sound(placement, crowd.radius)),
                "ways": lambda among: _named(name, lambda: clear(with_ways(among, crowd.radius), crowd.radius)),
            },
        )
    return placement


def _named(name: str, examined: Callable[[], Placement]) -> Placement:
    """What is examined; an InputError says of what."""
    try:
        return examined()
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _asked(layout: Layout, name: str, crowd: _Crowd) -> object:
    with plugin_errors(f"{name} raised"):
        return layout(rng.generator(crowd.key, "places"), crowd.radius.copy(), crowd.speed.copy())


def _overlap(start: Float[np.ndarray, "agent 2"], radius: Float[np.ndarray, "agent"], name: str) -> str | None:
    """Which two agents overlap at the start."""
    gap = norm(start[:, None] - start) - (radius[:, None] + radius)
    np.fill_diagonal(gap, np.inf)
    one, other = sorted(int(agent) for agent in np.unravel_index(gap.argmin(), gap.shape))
    if gap[one, other] >= 0.0:
        return None
    return f"{name} lets agents {one} and {other} overlap by {-gap[one, other]:.3g} m at the start"


def _at_goal(placement: Placement, radius: Float[np.ndarray, "agent"], name: str) -> str | None:
    """Which agent starts at its goal."""
    distance = norm(placement.goal - placement.start)
    if distance[0] < radius[0]:
        return f"{name} lets the vehicle start {distance[0]:.3g} m from its goal, where it has arrived"
    if (distance == 0.0).any():
        return f"{name} lets agent {int((distance == 0.0).argmax())} start at its goal"
    return None


def _deterministic(layout: Layout, name: str, placed: list[tuple[_Crowd, Placement]]) -> Point:
    if not placed:
        return Point("deterministic", None, MISSING)

    def again(crowd: _Crowd) -> np.ndarray:
        # Whoever draws from the shared generators is told so at another point.
        crowd.before.restore()
        return _numbers(finite(shaped(_asked(layout, f"layout {name}", crowd), len(crowd.radius))))

    def backwards() -> list[np.ndarray]:
        return [again(crowd) for crowd, _ in reversed(placed)][::-1]

    first = [_numbers(placement) for _, placement in placed]
    when = "when it is given the same again, from the last to the first"
    return same_point("deterministic", "placements", first, {when: backwards}, EXACT)


def _numbers(placement: Placement) -> Float[np.ndarray, "1 n"]:
    """All numbers of a placement in a row."""
    parts = (placement.start, placement.goal, placement.route, placement.obstacles)
    return np.concatenate([part.ravel() for part in parts if part is not None])[None]


@dataclass(frozen=True)
class _GlobalState:
    """The state of the two random generators that all code shares."""

    python: Any
    numpy: Any

    @classmethod
    def now(cls) -> _GlobalState:
        return cls(random.getstate(), np.random.get_state(legacy=True))  # noqa: NPY002 (to find who uses it)

    def restore(self) -> None:
        random.setstate(self.python)
        np.random.set_state(self.numpy)  # noqa: NPY002

    def difference(self, before: _GlobalState) -> str:
        """The names of the generators whose state has changed."""
        same_numpy = all(np.array_equal(*pair) for pair in zip(self.numpy, before.numpy, strict=True))
        names = {"Python's shared generator": self.python != before.python, "NumPy's shared generator": not same_numpy}
        return " and ".join(name for name, changed in names.items() if changed)
