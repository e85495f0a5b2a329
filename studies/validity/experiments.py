"""The experiments with a pedestrian policy: each has several worlds, which differ only in their random numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from crowdbench import PEDESTRIANS, Cases, Scenario
from crowdbench.scenario import Placement, parse_scenario
from studies.validity.corridor import corridor, direction, forward_speed, lane_order, people_of, walk
from studies.validity.door import NUMBER, Passages, hall, leave

WORLDS = 6
"""Worlds of an experiment."""

LENGTH, WIDTH = 10.0, 2.4
"""Size of the corridor in metres. All relevant neighbours are within 5 m: the ten nearest, which ORCA avoids, and for
a social force agents whose ellipses are near."""

FILE_WIDTH = 2.5
"""Width of the corridor for single file, in radii."""

TIME = 60.0
"""Duration in seconds. Pedestrians start at rest: a jam of ORCA agents needs half a minute to move."""

LAST = 20.0
"""Measured duration at the end in seconds."""

STUCK = 0.1
"""A crowd is stuck if its mean speed is below this share of the preferred speed."""

DOORS = (0.8, 1.0, 1.2, 1.6)
"""Widths of the door in metres."""


@dataclass(frozen=True, eq=False)
class People:
    """Common properties of the pedestrians of a crowd.

    Attributes:
        title: Their name in tables.
        radius: In metres.
        preferred_speed: In m/s, as in a scenario's file.
        densities: Densities in a corridor in 1/m^2. Higher densities than the last one would not fit, or hardly.
        per_metre: Densities in single file in 1/m.
        waiting: Density of the waiting crowd before a door in 1/m^2; None if they do not walk through doors.
    """

    title: str
    radius: float
    preferred_speed: float | Mapping[str, float]
    densities: tuple[float, ...]
    per_metre: tuple[float, ...]
    waiting: float | None

    @property
    def free_speed(self) -> float:
        """Their mean preferred speed in m/s."""
        speed = self.preferred_speed
        return speed["mean"] if isinstance(speed, Mapping) else speed


DEFAULT = People("radius 0.3 m, 1 m/s", 0.3, 1.0, (0.5, 1.0, 1.5, 2.0, 2.5), (0.8, 1.0, 1.2, 1.4), 1.6)
"""As in most scenarios."""

_WALKERS = {"mean": 1.34, "std": 0.26, "low": 0.82, "high": 1.86}
"""Walking speeds of pedestrians in m/s (Weidmann 1993), within two standard deviations."""

MEASURED = People("radius 0.2 m, 1.34 m/s", 0.2, _WALKERS, (0.5, 1.0, 2.0, 3.0, 4.0), (0.8, 1.2, 1.6, 2.0), 3.3)
"""With measured speeds, and bodies of 0.4 m diameter, which allow the same densities as in experiments."""

POINTS = People("radius 0.01 m, 1.34 m/s", 0.01, _WALKERS, (0.5, 1.0, 2.0, 3.0), (), None)
"""Almost points, as in the paper on the social force model (Helbing and Molnár 1995)."""

EVERYBODY = (DEFAULT, MEASURED, POINTS)


@dataclass(frozen=True)
class Walk:
    """Motion of pedestrians in a corridor.

    Attributes:
        speed: Mean speed in m/s in the direction of the goal, negative if they walk backwards.
        stuck: True if they hardly move, on average.
        order: Order of lanes, see `lane_order`; NaN if all walk in one direction.
        overlapping: Share of the pedestrians whose disc overlaps another one by more than 1 cm, at the end.
    """

    speed: Float[np.ndarray, "world"]
    stuck: Bool[np.ndarray, "world"]
    order: Float[np.ndarray, "world"]
    overlapping: Float[np.ndarray, "world"]


@dataclass(frozen=True)
class Setting:
    """A measurement: experiment, policy, pedestrians, and density or width.

    Attributes:
        experiment: `one way`, `two ways`, `single file` or `door`.
        policy: The pedestrian policy.
        people: The pedestrians.
        at: Pedestrians per square metre or, in single file, per metre; for a door its width in metres.
    """

    experiment: str
    policy: str
    people: People
    at: float


def settings(policies: Sequence[str]) -> Iterator[Setting]:
    """Yield all measurements of some policies."""
    for policy in policies:
        for people in EVERYBODY:
            values = {"one way": people.densities, "two ways": people.densities, "single file": people.per_metre}
            if people.waiting is not None:
                values["door"] = DOORS
            yield from (Setting(experiment, policy, people, at) for experiment in values for at in values[experiment])


def crowd(policy: str, people: People, number: int, layout: Callable[..., Placement]) -> Scenario:
    """Return a scenario in which pedestrians do not see the vehicle.

    Args:
        policy: The name of a pedestrian policy, or a file with one.
        people: The pedestrians.
        number: Number of pedestrians.
        layout: Function that places them. It is not a plug-in that a user could name.

    Returns:
        The scenario, with the policy's default parameters.

    Raises:
        InputError: There is no such policy.
    """
    size = {"radius": people.radius}  # the vehicle must fit in the same space
    pedestrians = {"number": number, "policy": policy, "preferred_speed": people.preferred_speed, **size}
    return parse_scenario(
        {"vehicle": size, "pedestrians": pedestrians},
        "validity",
        "validity",
        lambda _: ("validity", layout, None),
        PEDESTRIANS.load_with_digest,
    )


def run_experiment(setting: Setting, worlds: int = WORLDS, time: float = TIME) -> Walk | Passages:
    """Run an experiment.

    Args:
        setting: The experiment.
        worlds: Number of worlds.
        time: Duration in corridors in seconds; the last third is measured.

    Returns:
        The motion in a corridor, or the passages through a door.

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
    """Simulate pedestrians in a corridor, and measure their motion."""
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
    # After the vehicle, the first `number` agents are pedestrians, the others are images.
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
