"""The metric of intrusion into groups of pedestrians."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.evaluate.metrics.distances import HALL_ZONES
from crowdbench.evaluate.metrics.sums import dot, total
from crowdbench.geometry import norm
from crowdbench.types import Trace


def group_intrusion(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps that end with the vehicle within a group of pedestrians, or between two of them [1].

    The space of a group is the convex hull of its members' centres, as in Katyal et al. (2022), and a disc of the
    vehicle must overlap it. A group counts while no two of its members are farther apart than Hall's social distance,
    3.6 m: those who have parted leave room. Undefined in an episode without groups.
    """
    if trace.group is None:
        return np.full(len(trace), np.nan)
    first = trace.group[:, 0]
    within = np.zeros(trace.gap.shape, bool)
    # People who come in the places of a group are a group again.
    mates = ((first[:, :, None] == first[:, None]) & (first >= 0)[:, :, None]).any(axis=0)
    one, two = np.nonzero(mates & ~np.eye(len(mates), dtype=bool))
    if len(one):
        direction = np.stack([np.cos(trace.heading), np.sin(trace.heading)], axis=-1)
        for ahead in trace.rules.body:
            within |= _overlaps(
                trace, trace.group[:, 1:], (trace.position[:, :, 0] + ahead * direction)[:, 1:, None], one, two
            )
    return np.where((first >= 0).any(axis=1), total(1.0 * within) / trace.steps, np.nan)


def _overlaps(
    trace: Trace,
    group: Int[np.ndarray, "world step pedestrian"],
    centre: Float[np.ndarray, "world step 1 2"],
    one: Int[np.ndarray, "pair"],
    two: Int[np.ndarray, "pair"],
) -> Bool[np.ndarray, "world step"]:
    """Whether a disc of the vehicle overlaps the hull of a group.

    Args:
        trace: The trace.
        group: Their groups after each step, see `Trace`.
        centre: The centre of the disc in metres after each step.
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
    # The centre is within the hull if no line through it has all members on one side.
    left, right = a - centre, b - centre
    clockwise = left[..., 0] * right[..., 1] - left[..., 1] * right[..., 0] < 0.0
    follows = np.logical_or.reduceat(mates & clockwise, starts, axis=2)
    inside = together & follows & by_all(follows[:, :, of_two])
    length = np.maximum(dot(b - a, b - a), np.finfo(float).tiny)
    share = np.clip(dot(centre - a, b - a) / length, 0.0, 1.0)
    beside = norm(a + share[..., None] * (b - a) - centre) < trace.radius[:, 1:, :1]
    return np.asarray(inside.any(axis=2) | (mates & beside & together[:, :, of_one]).any(axis=2))
