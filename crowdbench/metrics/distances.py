"""Metrics of the distances that the vehicle keeps, from pedestrians, their groups and obstacles."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.geometry import dot, norm
from crowdbench.core.types import DISCOMFORT_GAP, Trace
from crowdbench.metrics.info import describe, finite_or_nan, total

Pairs = Int[np.ndarray, "pair"]

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


@describe("intimate zone", "less", share=True, source="Hall (1966)", of_successes=True)
def intimate_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of the steps of a success with a gap to a pedestrian within Hall's intimate distance, 0.45 m [1]."""
    return _in_zone(trace, "intimate")


@describe("personal zone", "less", share=True, source="Hall (1966)", of_successes=True)
def personal_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of the steps of a success with a gap to a pedestrian within Hall's personal distance, 1.2 m [1]."""
    return _in_zone(trace, "personal")


@describe("social zone", "less", share=True, source="Hall (1966)", of_successes=True)
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
    first = trace.group[:, 0]
    # Pedestrians that replace the members of a group form a group again.
    mates = ((first[:, :, None] == first[:, None]) & (first >= 0)[:, :, None]).any(axis=0)
    member, mate = np.nonzero(mates & ~np.eye(len(mates), dtype=bool))
    within = _find_within(trace, trace.group[:, 1:], member, mate) if len(member) else np.zeros(trace.gap.shape, bool)
    return np.where((first >= 0).any(axis=1), total(1.0 * within) / trace.steps, np.nan)


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


def _find_within(
    trace: Trace, group: Int[np.ndarray, "world step pedestrian"], one: Pairs, two: Pairs
) -> Bool[np.ndarray, "world step"]:
    """Return whether a disc of the vehicle overlaps the hull of a group.

    Args:
        group: The groups after each step, see `Trace`.
        one: Indices of pedestrians, in order, each once for each other member of its group.
        two: Those members.
    """
    person = trace.position[:, 1:, 1:]
    a, b = person[:, :, one], person[:, :, two]
    mates = (group[:, :, one] == group[:, :, two]) & (group[:, :, one] >= 0) & np.isfinite(a + b).all(axis=3)
    members, starts, of_one = np.unique(one, return_index=True, return_inverse=True)
    of_two = np.searchsorted(members, two)

    def by_all(holds: Bool[np.ndarray, "world step pair"]) -> Bool[np.ndarray, "world step member"]:
        return np.logical_and.reduceat(~mates | holds, starts, axis=2)

    near = by_all(norm(b - a) <= HALL_ZONES["social"])
    together = near & by_all(near[:, :, of_two])
    length = np.maximum(dot(b - a, b - a), np.finfo(float).tiny)
    direction = np.stack([np.cos(trace.heading), np.sin(trace.heading)], axis=-1)
    within = np.zeros(trace.gap.shape, bool)
    for ahead in trace.rules.body:
        centre = (trace.position[:, :, 0] + ahead * direction)[:, 1:, None]
        # The centre is within the hull if no line through it has all members on one side.
        left, right = a - centre, b - centre
        clockwise = left[..., 0] * right[..., 1] - left[..., 1] * right[..., 0] < 0.0
        follows = np.logical_or.reduceat(mates & clockwise, starts, axis=2)
        inside = together & follows & by_all(follows[:, :, of_two])
        share = np.clip(dot(centre - a, b - a) / length, 0.0, 1.0)
        beside = norm(a + share[..., None] * (b - a) - centre) < trace.radius[:, 1:, :1]
        within |= inside.any(axis=2) | (mates & beside & together[:, :, of_one]).any(axis=2)
    return within
