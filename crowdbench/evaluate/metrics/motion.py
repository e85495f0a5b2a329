"""Metrics of how the vehicle moves."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.metrics.outcomes import success_rate
from crowdbench.evaluate.metrics.sums import total
from crowdbench.geometry import norm, wrap_angle
from crowdbench.types import Trace

STANDSTILL = 0.05
"""Speed in m/s below which the vehicle counts as standing."""


def max_velocity_change(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of velocity from one step to the next, the start from rest included [m/s].

    We take it for the "Max Acc" of Li et al. (2020), because their figures are of this size.
    """
    return np.nanmax(_velocity_changes(trace), axis=1)


def max_acceleration(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of velocity divided by the time step, the start from rest included [m/s^2]."""
    return max_velocity_change(trace) / trace.rules.dt


def mean_acceleration(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean over steps of the change of velocity divided by the time step [m/s^2]."""
    return total(_velocity_changes(trace)) / trace.rules.dt / trace.steps


def jerk(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean size of the change of acceleration divided by the time step [m/s^3].

    Undefined in an episode of one step.
    """
    change = norm(np.diff(trace.velocity[:, :, 0], n=2, axis=1)) / trace.rules.dt**2
    return total(change) / np.where(trace.steps > 1, trace.steps - 1, np.nan)


def max_turn(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of heading between two steps that are both driven at 0.05 m/s or more [rad]."""
    velocity = trace.velocity[:, 1:, 0]
    heading = np.where(norm(velocity) >= STANDSTILL, np.arctan2(velocity[..., 1], velocity[..., 0]), np.nan)
    turn = np.abs(wrap_angle(np.diff(heading, axis=1)))
    return np.max(turn, axis=1, initial=0.0, where=~np.isnan(turn))


def cumulative_heading_change(trace: Trace) -> Float[np.ndarray, "world"]:
    """Sum of the sizes of the vehicle's changes of heading from one step to the next [rad].

    HuNavSim (Pérez-Higueras et al. 2023). A holonomic vehicle faces where it last moved, and its goal before it has
    moved.
    """
    return total(np.abs(wrap_angle(np.diff(trace.heading, axis=1))))


def success_heading_change(trace: Trace) -> Float[np.ndarray, "world"]:
    """`cumulative_heading_change`, over successes [rad]."""
    return np.where(success_rate(trace), cumulative_heading_change(trace), np.nan)


def stopped_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time spent slower than 0.05 m/s [s].

    The stalled time of Francis et al. (2023).
    """
    return total(1.0 * (norm(trace.velocity[:, 1:, 0]) < STANDSTILL)) * trace.rules.dt


def success_stopped_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """`stopped_time`, over successes [s]."""
    return np.where(success_rate(trace), stopped_time(trace), np.nan)


def _velocity_changes(trace: Trace) -> Float[np.ndarray, "world step"]:
    return norm(np.diff(trace.velocity[:, :, 0], axis=1))
