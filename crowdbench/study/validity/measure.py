"""The measurements of a pedestrian policy: each has several worlds, which differ only in their random numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.scenario.cases import Cases
from crowdbench.study.validity.corridor import corridor, direction, forward_speed, people_of, walk
from crowdbench.study.validity.door import NUMBER, hall, leave
from crowdbench.study.validity.lanes import lane_order
from crowdbench.study.validity.people import EVERYBODY, People, crowd

WORLDS = 6
"""Worlds of a measurement."""

LENGTH, WIDTH = 10.0, 2.4
"""Of the corridor, in metres. Everybody who counts is within 5 m: the ten nearest, whom ORCA avoids, and for a social
force those whose ellipses are near."""

FILE_WIDTH = 2.5
"""Width of the corridor for single file, in radii."""

TIME = 60.0
"""Seconds that people walk. They start at rest: a jam of ORCA's needs half a minute to move."""

LAST = 20.0
"""The last so many seconds of them are measured."""

STUCK = 0.1
"""Who walks more slowly on average than this share of its preferred speed is stuck."""

DOORS = (0.8, 1.0, 1.2, 1.6)
"""Widths of the door in metres."""


@dataclass(frozen=True)
class Walked:
    """People walking in a corridor.

    Attributes:
        speed: Mean speed in m/s in the direction in which they want to go, negative where they go backwards.
        stuck: Whether they hardly move, on average.
        order: How far they have formed lanes, see `lane_order`; NaN where all walk in one direction.
        overlapping: Share of the people whose disc overlaps another's by more than 1 cm, at the end.
    """

    speed: Float[np.ndarray, "world"]
    stuck: Bool[np.ndarray, "world"]
    order: Float[np.ndarray, "world"]
    overlapping: Float[np.ndarray, "world"]


@dataclass(frozen=True)
class Left:
    """People leaving through a door.

    Attributes:
        flow: Specific flow in 1/(m s).
        share: Share of the people who have passed in time.
        blocked: Whether the door is blocked at the end.
    """

    flow: Float[np.ndarray, "world"]
    share: Float[np.ndarray, "world"]
    blocked: Bool[np.ndarray, "world"]


@dataclass(frozen=True)
class Setting:
    """What is measured: which experiment, by whom, and where.

    Attributes:
        experiment: `one way`, `two ways`, `single file` or `door`.
        policy: The pedestrian policy.
        people: Who walks.
        at: People per square metre or, in single file, per metre; of a door its width in metres.
    """

    experiment: str
    policy: str
    people: People
    at: float


def settings(policies: Sequence[str]) -> Iterator[Setting]:
    """All that is measured of some policies."""
    for policy in policies:
        for people in EVERYBODY:
            for experiment in ("one way", "two ways"):
                yield from (Setting(experiment, policy, people, density) for density in people.densities)
            yield from (Setting("single file", policy, people, per_metre) for per_metre in people.per_metre)
            if people.waiting is not None:
                yield from (Setting("door", policy, people, width) for width in DOORS)


def measured(setting: Setting, worlds: int = WORLDS, time: float = TIME) -> Walked | Left:
    """Measure.

    Args:
        setting: What.
        worlds: In how many worlds.
        time: How long people walk in corridors, in seconds; the last third is measured.

    Returns:
        What was found.

    Raises:
        InputError: There is no such policy, or it fails.
    """
    return _left(setting, worlds) if setting.experiment == "door" else _walked(setting, worlds, time)


def _walked(setting: Setting, worlds: int, time: float) -> Walked:
    """People who walk in a corridor."""
    people, single_file = setting.people, setting.experiment == "single file"
    width = FILE_WIDTH * people.radius if single_file else WIDTH
    number = round(setting.at * LENGTH * (1.0 if single_file else WIDTH))
    layout = corridor(LENGTH, width, 0.5 if setting.experiment == "two ways" else 0.0)
    scenario = crowd(setting.policy, people, 2 * number, layout)
    steps = round(time / scenario.rules.dt)
    first = steps - max(1, round(steps * LAST / TIME))
    speeds, orders = [], []
    start = scenario.worlds(Cases("test", 0, worlds))
    for step, world in enumerate(walk(start, scenario.policies, LENGTH, steps, single_file)):
        if step >= first:
            speeds.append(forward_speed(world))
            if setting.experiment == "two ways":
                across = world.position[:, people_of(world), 1]
                orders.append(lane_order(across, direction(world), people.radius))
    # Worlds first, so that the sum over one is taken in the same order in any batch.
    speed = np.stack(speeds, axis=1).reshape(worlds, -1).mean(axis=1)
    return Walked(
        speed=speed,
        stuck=speed < STUCK * people.free_speed,
        order=np.stack(orders, axis=1).mean(axis=1) if orders else np.full(worlds, np.nan),
        overlapping=_overlapping(world.position[:, 1:], number, people.radius),
    )


def _overlapping(
    position: Float[np.ndarray, "world pedestrian 2"], number: int, radius: float
) -> Float[np.ndarray, "world"]:
    """The share of the people who overlap somebody; the first `number` are people, the others images."""
    apart = position[:, :number, None] - position[:, None]
    touching = np.hypot(apart[..., 0], apart[..., 1]) < 2.0 * radius - 0.01
    return (touching.sum(axis=2) > 1).mean(axis=1)


def _left(setting: Setting, worlds: int) -> Left:
    """People who leave through a door."""
    waiting = setting.people.waiting
    if waiting is None:
        raise ValueError(f"{setting.people.title} do not walk through doors")
    scenario = crowd(setting.policy, setting.people, NUMBER, hall(setting.at, waiting))
    passages = leave(scenario.worlds(Cases("test", 0, worlds)), scenario.policies)
    return Left(passages.flow() / setting.at, passages.share, passages.blocked)
