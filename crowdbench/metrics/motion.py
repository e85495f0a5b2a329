"""Metrics of the vehicle's path and of how it moves along it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import local_goals, norm, wrap_angle
from crowdbench.core.types import Trace
from crowdbench.metrics.info import describe
from crowdbench.metrics.outcomes import success_rate
from crowdbench.metrics.sums import total

STANDSTILL = 0.05
"""Speed in m/s below which the vehicle counts as standing."""


@describe("path length")
def path_length(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length of the vehicle's path [m]."""
    return total(norm(np.diff(trace.position[:, :, 0], axis=1)))


@describe("path length of successes", "less")
def success_path_length(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length of the vehicle's path, over successes: who collides early has a short path [m]."""
    return np.where(success_rate(trace), path_length(trace), np.nan)


@describe("SPL", "more", over_all=True, source="Anderson et al. (2018)")
def spl(trace: Trace) -> Float[np.ndarray, "world"]:
    """Success weighted by path length: shortest over real path, 0 for a failure [1].

    Anderson et al. (2018). The shortest path is the way along the vehicle's route, the straight line where it has none,
    to where the goal is nearer than its tolerance. It is 1 for a vehicle that starts within its goal.
    """
    shortest = _shortest_way(trace)
    longest = np.maximum(path_length(trace), shortest)
    share = np.where(shortest > 0.0, shortest / np.where(longest > 0.0, longest, 1.0), 1.0)
    return success_rate(trace) * share


@describe("SCT", "more", over_all=True, source="Yokoyama et al. (2021)")
def sct(trace: Trace) -> Float[np.ndarray, "world"]:
    """Success weighted by completion time: least over real time, 0 for a failure [1].

    Yokoyama et al. (2021). The least time is that of the shortest path, as in `spl`, at the preferred speed, in whole
    steps.
    """
    least = np.ceil(_shortest_way(trace) / (trace.preferred_speed[:, 0] * trace.rules.dt))
    return success_rate(trace) * np.maximum(least, 1.0) / np.maximum(trace.steps, np.maximum(least, 1.0))


@describe("largest change of velocity", "less", source="Li et al. (2020)")
def max_velocity_change(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of velocity from one step to the next, the start from rest included [m/s].

    We take it for the "Max Acc" of Li et al. (2020), because their figures are of this size.
    """
    return np.nanmax(_velocity_changes(trace), axis=1)


@describe("largest acceleration", "less")
def max_acceleration(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of velocity divided by the time step, the start from rest included [m/s^2]."""
    return max_velocity_change(trace) / trace.rules.dt


@describe("mean acceleration", "less")
def mean_acceleration(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean over steps of the change of velocity divided by the time step [m/s^2]."""
    return total(_velocity_changes(trace)) / trace.rules.dt / trace.steps


@describe("jerk", "less")
def jerk(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean size of the change of acceleration divided by the time step [m/s^3].

    Undefined in an episode of one step.
    """
    change = norm(np.diff(trace.velocity[:, :, 0], n=2, axis=1)) / trace.rules.dt**2
    return total(change) / np.where(trace.steps > 1, trace.steps - 1, np.nan)


@describe("largest turn", "less")
def max_turn(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of heading between two steps that are both driven at 0.05 m/s or more [rad]."""
    velocity = trace.velocity[:, 1:, 0]
    heading = np.where(norm(velocity) >= STANDSTILL, np.arctan2(velocity[..., 1], velocity[..., 0]), np.nan)
    turn = np.abs(wrap_angle(np.diff(heading, axis=1)))
    return np.max(turn, axis=1, initial=0.0, where=~np.isnan(turn))


@describe("heading change", "less", source="Pérez-Higueras et al. (2023)")
def cumulative_heading_change(trace: Trace) -> Float[np.ndarray, "world"]:
    """Sum of the sizes of the vehicle's changes of heading from one step to the next [rad].

    HuNavSim (Pérez-Higueras et al. 2023). A holonomic vehicle faces where it last moved, and its goal before it has
    moved.
    """
    return total(np.abs(wrap_angle(np.diff(trace.heading, axis=1))))


@describe("heading change of successes", "less")
def success_heading_change(trace: Trace) -> Float[np.ndarray, "world"]:
    """`cumulative_heading_change`, over successes [rad]."""
    return np.where(success_rate(trace), cumulative_heading_change(trace), np.nan)


@describe("stopped time", "less", source="Francis et al. (2023)")
def stopped_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time spent slower than 0.05 m/s [s].

    The stalled time of Francis et al. (2023).
    """
    return total(1.0 * (norm(trace.velocity[:, 1:, 0]) < STANDSTILL)) * trace.rules.dt


@describe("stopped time of successes", "less")
def success_stopped_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """`stopped_time`, over successes [s]."""
    return np.where(success_rate(trace), stopped_time(trace), np.nan)


def _velocity_changes(trace: Trace) -> Float[np.ndarray, "world step"]:
    return norm(np.diff(trace.velocity[:, :, 0], axis=1))


def _shortest_way(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length in metres of the vehicle's route from its start to where it has arrived."""
    near = trace.radius[:, 0, 0] if trace.rules.goal_tolerance is None else trace.rules.goal_tolerance
    start, none = trace.position[:, 0, 0], np.zeros(len(trace), np.int64)
    ahead = local_goals(start, trace.goal[:, 0, 0], trace.route, none)
    return np.maximum(norm(ahead - start) - near, 0.0)
