"""Metrics of the distances that the vehicle keeps, from pedestrians, their groups and obstacles."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.dynamics import disc_centres
from crowdbench.core.geometry import norm
from crowdbench.core.types import DISCOMFORT_GAP, Trace
from crowdbench.metrics.info import describe, finite_or_nan, total

HALL_ZONES = {"intimate": 0.45, "personal": 1.2, "social": 3.6}
"""Outer bounds in metres of the zones of Hall (1966)."""

PERSONAL_SPACE = 0.5
"""Smallest gap in metres outside a pedestrian's personal space (Francis et al. 2023)."""

INTRUSION_STEPS = 5
"""Number of future steps of a pedestrian that count as its path, as in CrowdNav++ (Liu et al. 2023)."""

INTRUSION_DISTANCE = 0.6
"""Distance between centres in metres below which the vehicle is on a pedestrian's path (Liu et al. 2023)."""


@describe("smallest gap", "more", of_successes=True)
def minimum_gap(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest gap between vehicle and pedestrians in the simulator's collision check, over successes [m].

    The gap is the distance between the rims of two discs. Undefined without pedestrians.
    """
    return finite_or_nan(np.nanmin(trace.gap, axis=1))


@describe("clearing distance", "more", source="Francis et al. (2023)")
def clearing_distance(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest distance between the vehicle's rim and the obstacles [m].

    Francis et al. (2023). Undefined without obstacles.
    """
    return finite_or_nan(np.nanmin(trace.wall_gap, axis=1))


@describe("discomfort", "less", share=True, digits=4, of_successes=True)
def discomfort(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of the steps of a success with a gap to a pedestrian below 0.2 m [1]."""
    return total(1.0 * (trace.gap < DISCOMFORT_GAP)) / trace.steps


@describe("discomfort frequency", "less", share=True, digits=4, pooled=True, source="Chen et al. (2019)")
def discomfort_frequency(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of all steps with a gap below 0.2 m that did not end the episode, pooled as in CrowdNav [1].

    An early end may improve it, as in CrowdNav: `discomfort` is over successes.

    Differs from CrowdNav because an episode that times out counts its own steps, not the steps of the whole time limit.
    """
    before_last = np.arange(trace.gap.shape[1]) < trace.steps[:, None] - 1
    return total(1.0 * ((trace.gap < DISCOMFORT_GAP) & before_last)) / trace.steps


@describe("time in intimate zone", "less", share=True, source="Hall (1966)", of_successes=True)
def intimate_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of the steps of a success with a gap to a pedestrian within Hall's intimate distance, 0.45 m [1]."""
    return _in_zone(trace, "intimate")


@describe("time in personal zone", "less", share=True, source="Hall (1966)", of_successes=True)
def personal_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of the steps of a success with a gap to a pedestrian within Hall's personal distance, 1.2 m [1]."""
    return _in_zone(trace, "personal")


@describe("time in social zone", "less", share=True, source="Hall (1966)", of_successes=True)
def social_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of the steps of a success with a gap to a pedestrian within Hall's social distance, 3.6 m [1]."""
    return _in_zone(trace, "social")


@describe("personal space compliance", "more", share=True, source="Francis et al. (2023)", of_successes=True)
def personal_space_compliance(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of the steps of a success without a gap to a pedestrian below 0.5 m [1].

    Francis et al. (2023), with their threshold.
    """
    return total(1.0 * (trace.gap >= PERSONAL_SPACE)) / trace.steps


@describe("intrusion time", "less", share=True, source="Liu et al. (2023)")
def intrusion_time_ratio(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of steps in which a visible pedestrian comes within 0.6 m of the vehicle's current position in 5 steps [1].

    Liu et al. (2023): the distance is between centres, and the pedestrian's positions are its true ones in the next
    `INTRUSION_STEPS` steps. Differs from theirs because no position after the end of the episode is known. It is over
    all episodes, as theirs is: an early end may improve it.
    """
    return total(1.0 * np.isfinite(_intrusions(trace))) / trace.steps


@describe("social distance", "more", source="Liu et al. (2023)")
def social_distance(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean of the smallest distance between centres, over the steps that `intrusion_time_ratio` counts [m].

    Liu et al. (2023). Undefined in an episode without an intrusion. It is over all episodes, as theirs is: an early end
    may improve it.
    """
    nearest = _intrusions(trace)
    intrusions = np.isfinite(nearest)
    count = intrusions.sum(axis=1)
    return total(np.where(intrusions, nearest, 0.0)) / np.where(count > 0, count, np.nan)


@describe("group intrusion", "less", share=True, source="Katyal et al. (2022)", of_successes=True)
def group_intrusion(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of the steps of a success that end with the vehicle in a group of pedestrians, or between two of them [1].

    The space of a group is the convex hull of its members' centres, as in Katyal et al. (2022), and a disc of the
    vehicle must overlap it. A group counts while no two of its members are farther apart than Hall's social distance,
    3.6 m: members farther apart leave room. Undefined in an episode without groups.
    """
    if trace.group is None:
        return np.full(len(trace), np.nan)
    from shapely import convex_hull, distance, multipoints, points

    group, position = trace.group[:, 1:], trace.position[:, 1:, 1:]
    discs = disc_centres(trace.rules.body, trace.position[:, 1:, 0], trace.heading[:, 1:])
    within = np.zeros(trace.gap.shape, bool)
    for number in np.unique(group[group >= 0]):
        is_member = (group == number) & np.isfinite(position[..., 0])
        world, step = np.nonzero(is_member.sum(axis=2) > 1)
        is_member, person = is_member[world, step], position[world, step]
        hulls = convex_hull(multipoints(person[is_member], indices=np.nonzero(is_member)[0]))
        gap = distance(hulls[:, None], points(discs[world, step])).min(axis=1) - trace.radius[world, step + 1, 0]
        within[world, step] |= (gap < 0.0) & _are_together(np.where(is_member[..., None], person, np.nan))
    return np.where((trace.group[:, 0] >= 0).any(axis=1), total(1.0 * within) / trace.steps, np.nan)


def _are_together(member: Float[np.ndarray, "state pedestrian 2"]) -> Bool[np.ndarray, "state"]:
    """Return whether no two members of a group, NaN for all others, are farther apart than Hall's social distance."""
    are_near = [~(norm(member - other[:, None]) > HALL_ZONES["social"]).any(axis=1) for other in member.swapaxes(0, 1)]
    return np.all(are_near, axis=0)


def _in_zone(trace: Trace, zone: str) -> Float[np.ndarray, "world"]:
    return total(1.0 * (trace.gap < HALL_ZONES[zone])) / trace.steps


def _intrusions(trace: Trace) -> Float[np.ndarray, "world step"]:
    """Return the smallest distance in metres from the vehicle to the future positions of visible pedestrians, infinite
    beyond 0.6 m."""
    steps = trace.gap.shape[1]
    nearest = np.full((len(trace), steps), np.inf)
    vehicle, seen = trace.position[:, :steps, :1], trace.seen[:, :steps]
    for ahead in range(1, min(INTRUSION_STEPS, steps) + 1):
        known = slice(0, steps + 1 - ahead)
        same = trace.person[:, ahead:][:, : steps + 1 - ahead] == trace.person[:, known]
        present = trace.present[:, ahead:, 1:] & same & seen[:, known]
        distance = norm(trace.position[:, ahead:, 1:] - vehicle[:, known])
        least = np.fmin.reduce(np.where(present, distance, np.inf), axis=2, initial=np.inf)
        nearest[:, known] = np.fmin(nearest[:, known], least)
    return np.where(nearest < INTRUSION_DISTANCE, nearest, np.inf)
