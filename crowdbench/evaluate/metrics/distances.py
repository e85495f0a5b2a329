"""Metrics of the distances that the vehicle keeps."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.metrics.sums import dot, total
from crowdbench.geometry import norm
from crowdbench.types import DISCOMFORT_GAP, Trace

HALL_ZONES = {"intimate": 0.45, "personal": 1.2, "social": 3.6}
"""Outer bounds in metres of the zones of Hall (1966)."""

PERSONAL_SPACE = 0.5
"""Gap in metres that keeps out of a pedestrian's personal space (Francis et al. 2023)."""

INTRUSION_STEPS = 5
"""So many steps ahead a pedestrian's own way is looked at, of CrowdNav++ (Liu et al. 2023)."""

INTRUSION_DISTANCE = 0.6
"""Distance between centres in metres below which the vehicle is in a pedestrian's way (Liu et al. 2023)."""


def minimum_gap(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest gap between vehicle and pedestrians, as the simulator's collision check measured it [m].

    The gap is the distance between the rims of two discs: negative where they overlapped. Undefined where there are
    no pedestrians.
    """
    gap = np.nanmin(trace.gap, axis=1)
    return np.where(np.isfinite(gap), gap, np.nan)


def clearing_distance(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest distance between the vehicle's rim and the obstacles [m].

    Francis et al. (2023). Undefined where there are no obstacles.
    """
    gap = np.nanmin(trace.wall_gap, axis=1)
    return np.where(np.isfinite(gap), gap, np.nan)


def discomfort(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps with a gap to a pedestrian below 0.2 m [1]."""
    return total(1.0 * (trace.gap < DISCOMFORT_GAP)) / trace.steps


def discomfort_frequency(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of all steps with a gap below 0.2 m that did not end the episode, pooled as in CrowdNav [1].

    Differs from CrowdNav because an episode that times out counts its own steps, not those of the whole time limit.
    """
    before_last = np.arange(trace.gap.shape[1]) < trace.steps[:, None] - 1
    return total(1.0 * ((trace.gap < DISCOMFORT_GAP) & before_last)) / trace.steps


def intimate_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps with a gap to a pedestrian within Hall's intimate distance, 0.45 m [1]."""
    return _in_zone(trace, "intimate")


def personal_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps with a gap to a pedestrian within Hall's personal distance, 1.2 m [1]."""
    return _in_zone(trace, "personal")


def social_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps with a gap to a pedestrian within Hall's social distance, 3.6 m [1]."""
    return _in_zone(trace, "social")


def personal_space_compliance(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps without a gap to a pedestrian below 0.5 m [1].

    Francis et al. (2023), with their threshold.
    """
    return total(1.0 * (trace.gap >= PERSONAL_SPACE)) / trace.steps


def intrusion_time_ratio(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of steps in which a pedestrian that is seen will be within 0.6 m of where the vehicle is, in 5 steps [1].

    Liu et al. (2023): the distance is between centres, and the pedestrian's positions are its true ones in the next
    `INTRUSION_STEPS` steps. Differs from theirs because no position after the end of the episode is known.
    """
    return total(1.0 * np.isfinite(_intrusions(trace))) / trace.steps


def social_distance(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest distance between centres in each step that `intrusion_time_ratio` counts, the mean of these [m].

    Liu et al. (2023). Undefined in an episode without an intrusion.
    """
    nearest = _intrusions(trace)
    intrusions = np.isfinite(nearest)
    count = intrusions.sum(axis=1)
    return total(np.where(intrusions, nearest, 0.0)) / np.where(count > 0, count, np.nan)


def time_to_collision(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest time until the vehicle would touch a pedestrian if both kept their velocities of the step [s].

    Undefined in an episode in which they would never touch.
    """
    position = trace.position[:, :-1, 1:] - trace.position[:, :-1, :1]
    velocity = trace.velocity[:, 1:, 1:] - trace.velocity[:, 1:, :1]
    reach = trace.radius[:, :-1, 1:] + trace.radius[:, :-1, :1]
    a = dot(velocity, velocity)
    b = dot(position, velocity)
    c = dot(position, position) - reach**2
    root = b**2 - a * c
    same = trace.person[:, :-1] == trace.person[:, 1:]
    meets = (b < 0) & (root >= 0) & same
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(meets, c / (np.sqrt(np.where(meets, root, 0.0)) - b), np.inf)
    least = np.min(np.maximum(time, 0.0), axis=(1, 2), initial=np.inf)
    return np.where(np.isfinite(least), least, np.nan)


def _in_zone(trace: Trace, zone: str) -> Float[np.ndarray, "world"]:
    return total(1.0 * (trace.gap < HALL_ZONES[zone])) / trace.steps


def _intrusions(trace: Trace) -> Float[np.ndarray, "world step"]:
    """The smallest distance in metres from the vehicle to where those whom it sees will be, infinite beyond 0.6 m."""
    steps = trace.gap.shape[1]
    nearest = np.full((len(trace), steps), np.inf)
    vehicle, seen = trace.position[:, :steps, :1], trace.seen[:, :steps]
    for ahead in range(1, min(INTRUSION_STEPS, steps) + 1):
        known = slice(0, steps + 1 - ahead)
        same = trace.person[:, ahead:][:, : steps + 1 - ahead] == trace.person[:, known]
        there = trace.present[:, ahead:, 1:] & same & seen[:, known]
        distance = norm(trace.position[:, ahead:, 1:] - vehicle[:, known])
        least = np.fmin.reduce(np.where(there, distance, np.inf), axis=2, initial=np.inf)
        nearest[:, known] = np.fmin(nearest[:, known], least)
    return np.where(nearest < INTRUSION_DISTANCE, nearest, np.inf)
