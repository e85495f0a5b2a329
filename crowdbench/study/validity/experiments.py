"""The experiments with a pedestrian policy: each has several worlds, which differ only in their random numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.scenario.cases import Cases
from crowdbench.study.validity.corridor import corridor, direction, forward_speed, lane_order, people_of, walk
from crowdbench.study.validity.door import NUMBER, Passages, hall, leave
from crowdbench.study.validity.people import EVERYBODY, People, crowd

WORLDS = 6
"""Worlds of an experiment."""

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
class Walk:
    """How people have walked in a corridor.

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
            values = {"one way": people.densities, "two ways": people.densities, "single file": people.per_metre}
            if people.waiting is not None:
                values["door"] = DOORS
            yield from (Setting(experiment, policy, people, at) for experiment in values for at in values[experiment])


def run_experiment(setting: Setting, worlds: int = WORLDS, time: float = TIME) -> Walk | Passages:
    """Run an experiment.

    Args:
        setting: Which one.
        worlds: In how many worlds.
        time: How long people walk in corridors, in seconds; the last third is measured.

    Returns:
        How people walked, or of a door, how they passed it.

    Raises:
        InputError: There is no such policy, or it fails.
    """
    cases = Cases("test", 0, worlds)
    people, waiting = setting.people, setting.people.waiting
    if setting.experiment != "door":
        return _walk(setting, cases, time)
    if waiting is None:
        raise ValueError(f"{people.title} do not walk through doors")
    scenario = crowd(setting.policy, people, NUMBER, hall(setting.at, waiting))
    return leave(scenario.worlds(cases), scenario.policies)


def _walk(setting: Setting, cases: Cases, time: float) -> Walk:
    """People who walk in a corridor."""
    people = setting.people
    single_file, both_ways = setting.experiment == "single file", setting.experiment == "two ways"
    width = FILE_WIDTH * people.radius if single_file else WIDTH
    number = round(setting.at * LENGTH * (1.0 if single_file else WIDTH))
    scenario = crowd(setting.policy, people, 2 * number, corridor(LENGTH, width, 0.5 if both_ways else 0.0))
    steps = round(time / scenario.rules.dt)
    first = steps - max(1, round(steps * LAST / TIME))
    speeds, orders = [], []
    start = scenario.worlds(cases)
    for step, world in enumerate(walk(start, scenario.policies, LENGTH, steps, single_file)):
        if step >= first:
            speeds.append(forward_speed(world))
            if both_ways:
                across = world.position[:, people_of(world), 1]
                orders.append(lane_order(across, direction(world), people.radius))
    # The first `number` pedestrians are people, the others images.
    apart = world.position[:, 1 : 1 + number, None] - world.position[:, None, 1:]
    touching = np.hypot(apart[..., 0], apart[..., 1]) < 2.0 * people.radius - 0.01
    # Worlds first, so that the sum over one is taken in the same order in any batch.
    speed = np.stack(speeds, axis=1).reshape(len(cases), -1).mean(axis=1)
    return Walk(
        speed=speed,
        stuck=speed < STUCK * people.free_speed,
        order=np.stack(orders, axis=1).mean(axis=1) if orders else np.full(len(cases), np.nan),
        overlapping=(touching.sum(axis=2) > 1).mean(axis=1),
    )
