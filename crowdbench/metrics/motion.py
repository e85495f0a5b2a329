"""Metrics of the vehicle's path and of its motion along the path."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.arrays import Numbers, Vectors
from crowdbench.core.geometry import least_distance, local_goals, norm, wrap_angle
from crowdbench.core.types import DISCOMFORT_GAP, Trace
from crowdbench.metrics.info import describe, total
from crowdbench.metrics.outcomes import success_rate
from crowdbench.sim.obstacles import touches_in_step
from crowdbench.sim.routes import goals_in_trace
from crowdbench.utils.compiled import njit

States = Int[np.ndarray, "state"]

STANDSTILL = 0.05
"""Speed in m/s below which the vehicle counts as standing."""

OPEN_TIME = 2.0
"""Seconds for which the path ahead of a standing vehicle must be free, so that the vehicle counts as frozen."""


@describe("path length")
def path_length(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length of the vehicle's path [m]."""
    return total(norm(np.diff(trace.position[:, :, 0], axis=1)))


@describe("path length of successes", "less")
def success_path_length(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length of the vehicle's path, over successes: an early collision shortens the path [m]."""
    return np.where(success_rate(trace), path_length(trace), np.nan)


@describe("path irregularity", "less", source="Biswas et al. (2022)", of_successes=True)
def path_irregularity(trace: Trace) -> Float[np.ndarray, "world"]:
    """Rotation of the vehicle beyond that of its route, per metre of its path, over successes [rad/m].

    max(0, sum_t |dh_t| - R) / L, as in SocNavBench (Biswas et al. 2022). h is the heading in radians, see
    `cumulative_heading_change`; L is the length of the path in metres. R is the least rotation: from the first heading
    along the vehicle's route to the goal. Undefined if the vehicle does not move.
    """
    goal = trace.goal[:, :1, 0]
    route = np.where(np.isfinite(trace.route), trace.route, goal)
    legs = np.diff(np.concatenate([trace.position[:, :1, 0], route, goal], axis=1), axis=1)
    # The legs after the last waypoint have no length.
    along = np.where(norm(legs) > 0.0, np.arctan2(legs[..., 1], legs[..., 0]), np.nan)
    least = total(np.abs(wrap_angle(np.diff(np.concatenate([trace.heading[:, :1], along], axis=1), axis=1))))
    length = path_length(trace)
    return np.maximum(cumulative_heading_change(trace) - least, 0.0) / np.where(length > 0.0, length, np.nan)


@describe("SPL", "more", over_all=True, source="Anderson et al. (2018)")
def spl(trace: Trace) -> Float[np.ndarray, "world"]:
    """Success weighted by path length: shortest divided by actual path length, 0 for a failure [1].

    Anderson et al. (2018). The shortest path follows the vehicle's route, or the straight line without a route, until
    the goal is within its tolerance. SPL is 1 for a vehicle that starts within its goal.
    """
    shortest = _shortest_way(trace)
    longest = np.maximum(path_length(trace), shortest)
    share = np.where(shortest > 0.0, shortest / np.where(longest > 0.0, longest, 1.0), 1.0)
    return success_rate(trace) * share


@describe("SCT", "more", over_all=True, source="Yokoyama et al. (2021)")
def sct(trace: Trace) -> Float[np.ndarray, "world"]:
    """Success weighted by completion time: least divided by actual time, 0 for a failure [1].

    Yokoyama et al. (2021). The least time is that of the shortest path, as in `spl`, at the preferred speed, in whole
    steps. Differs from theirs because their least time is that of the fastest path under the agent's dynamics: here a
    unicycle or a car cannot reach 1 if it must turn or accelerate first. SCT compares planners of one vehicle.
    """
    least = np.ceil(_shortest_way(trace) / (trace.preferred_speed[:, 0] * trace.rules.dt))
    return success_rate(trace) * np.maximum(least, 1.0) / np.maximum(trace.steps, np.maximum(least, 1.0))


@describe("largest change of velocity", "less", source="Li et al. (2020)")
def max_velocity_change(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of velocity from one step to the next, the start from rest included [m/s].

    We assume that it is "Max Acc" of Li et al. (2020), because their values have this magnitude.
    """
    return np.nanmax(norm(np.diff(trace.velocity[:, :, 0], axis=1)), axis=1)


@describe("largest acceleration", "less")
def max_acceleration(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of velocity divided by the time step, the start from rest included [m/s^2]."""
    return max_velocity_change(trace) / trace.rules.dt


@describe("mean acceleration", "less")
def mean_acceleration(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean over steps of the change of velocity divided by the time step [m/s^2]."""
    return total(norm(np.diff(trace.velocity[:, :, 0], axis=1))) / trace.rules.dt / trace.steps


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

    HuNavSim (Pérez-Higueras et al. 2023). The heading of a holonomic vehicle is the direction of its last motion, and
    that of its goal before it has moved.
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


@describe("frozen time", "less", over_all=True)
def frozen_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time for which the vehicle stood although its path was free for the next 2 s [s].

    It stands below 0.05 m/s. Its path was free if a straight motion along its route, from then on and at its preferred
    speed, would have kept 0.2 m from the actual motion of all pedestrians and touched no obstacle, for 2 s or up to its
    goal. If the route bends within these 2 s, the straight path often ends at a wall, and is not free. The last 2 s of
    an episode do not count, because the motion of pedestrians after its end is unknown. Freezing is described by
    Trautman and Krause (2010); this measure of it is ours.
    """
    ahead = math.ceil(OPEN_TIME / trace.rules.dt - 1e-9)
    stands = norm(trace.velocity[:, 1:, 0]) < STANDSTILL
    row, t = np.nonzero(stands & (np.arange(stands.shape[1]) + ahead <= trace.steps[:, None]))
    start = trace.position[row, t, 0]
    to_goal = goals_in_trace(trace)[row, t] - start
    length = np.hypot(to_goal[:, 0], to_goal[:, 1])
    direction = to_goal / np.where(length > 0.0, length, 1.0)[:, None]
    is_open = (length > 0.0) & _find_clear(trace, row, t, direction, length, ahead)
    if trace.obstacles.shape[1]:
        far = np.minimum(length, ahead * trace.preferred_speed[row, 0] * trace.rules.dt)
        body, obstacles = np.array(trace.rules.body), np.ascontiguousarray(trace.obstacles)
        _keep_off_walls(
            row, start, direction, far[:, None] * direction, body, trace.radius[row, t, 0], obstacles, is_open
        )
    frozen = np.zeros(stands.shape, bool)
    frozen[row, t] = is_open
    return total(1.0 * frozen) * trace.rules.dt


def _shortest_way(trace: Trace) -> Float[np.ndarray, "world"]:
    """Return the length in metres of the vehicle's route from its start to its point of arrival."""
    near = trace.radius[:, 0, 0] if trace.rules.goal_tolerance is None else trace.rules.goal_tolerance
    start, none = trace.position[:, 0, 0], np.zeros(len(trace), np.int64)
    ahead = local_goals(start, trace.goal[:, 0, 0], trace.route, none)
    return np.maximum(norm(ahead - start) - near, 0.0)


def _find_clear(
    trace: Trace, row: States, t: States, direction: Vectors, length: Numbers, ahead: int
) -> Bool[np.ndarray, "state"]:
    """Return True for states from which a straight motion at the preferred speed keeps clear of all pedestrians.

    Args:
        row: The world of each state.
        t: Its time.
        direction: The direction of the local goal, a unit vector.
        length: The distance to the local goal in metres.
        ahead: The number of steps for which the path must be clear.
    """
    stride = trace.preferred_speed[row, 0] * trace.rules.dt
    is_clear = np.ones(len(row), bool)
    for k in range(ahead):
        first, last = k * stride, np.minimum((k + 1) * stride, length)
        person, later = trace.position[row, t + k, 1:], trace.position[row, t + k + 1, 1:]
        is_same = trace.person[row, t + k] == trace.person[row, t + k + 1]
        motion = (later - person) - ((last - first)[:, None] * direction)[:, None]
        for centre in trace.rules.body:
            disc = trace.position[row, t, 0] + (centre + first)[:, None] * direction
            distance = least_distance(person - disc[:, None], motion)
            gap = distance - trace.radius[row, t, 1:] - trace.radius[row, t, :1]
            is_near = (is_same & (gap < DISCOMFORT_GAP)).any(axis=1)
            is_clear &= ~is_near | (first >= length)
    return is_clear


@no_type_check
@njit
def _keep_off_walls(row, start, direction, path, body, radius, obstacles, is_open):
    """Set `is_open` to False for states in which a wall blocks the path.

    Args:
        row: `[state]`, the world of each state.
        start: `[state, 2]`, the position in metres.
        direction: `[state, 2]`, the direction of the path, a unit vector.
        path: `[state, 2]`, the vector to its end in metres.
        body: `[disc]`, see `crowdbench.core.dynamics.body`.
        radius: `[state]`, in metres.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        is_open: `[state]`, changed.
    """
    for s in range(len(row)):
        for centre in body:
            x, y = start[s, 0] + centre * direction[s, 0], start[s, 1] + centre * direction[s, 1]
            if is_open[s] and touches_in_step(x, y, path[s, 0], path[s, 1], radius[s], obstacles[row[s]]):
                is_open[s] = False
