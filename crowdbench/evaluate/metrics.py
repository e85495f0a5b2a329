"""The metrics: functions of a trace that give one value per episode, NaN where a metric is undefined.

The first line of each docstring is what `crowdbench list metrics` shows; its unit stands in brackets.
Booleans are averaged as rates. To add a metric, write its function and name it in `METRICS`.

Sums add one step after the other, so that an episode's value does not depend on its batch.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.geometry import local_goals, norm, wrap_angle
from crowdbench.reward import discount, episode_rewards
from crowdbench.types import DISCOMFORT_GAP, Outcome, Trace

Metric = Callable[[Trace], Bool[np.ndarray, "world"] | Float[np.ndarray, "world"]]

STANDSTILL = 0.05
"""Speed in m/s below which the vehicle counts as standing."""

HALL_ZONES = {"intimate": 0.45, "personal": 1.2, "social": 3.6}
"""Outer bounds in metres of the zones of Hall (1966)."""


INTRUSION_STEPS = 5
"""So many steps ahead a pedestrian's own way is looked at, of CrowdNav++ (Liu et al. 2023)."""

INTRUSION_DISTANCE = 0.6
"""Distance between centres in metres below which the vehicle is in a pedestrian's way (Liu et al. 2023)."""


def success_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes in which the vehicle reached its goal [1]."""
    return trace.outcome == Outcome.SUCCESS


def collision_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended in a collision, with a pedestrian or an obstacle [1]."""
    return np.isin(trace.outcome, (Outcome.COLLISION, Outcome.WALL_COLLISION))


def wall_collision_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended in a collision with an obstacle [1]."""
    return trace.outcome == Outcome.WALL_COLLISION


def timeout_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ran out of time [1]."""
    return trace.outcome == Outcome.TIMEOUT


def navigation_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time from start to goal, over successes [s]."""
    return np.where(success_rate(trace), trace.steps * trace.rules.dt, np.nan)


def navigation_time_or_limit(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time from start to goal, a failure counting as the time limit [s]."""
    return np.where(success_rate(trace), trace.steps * trace.rules.dt, trace.rules.time_limit)


def path_length(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length of the vehicle's path [m]."""
    return _sum(norm(np.diff(trace.position[:, :, 0], axis=1)))


def spl(trace: Trace) -> Float[np.ndarray, "world"]:
    """Success weighted by path length: shortest over real path, 0 for a failure [1].

    Anderson et al. (2018). The shortest path is the way along the vehicle's route, the straight line where it has none,
    to where the goal is nearer than its tolerance. It is 1 for a vehicle that starts within its goal.
    """
    shortest = _shortest_way(trace)
    longest = np.maximum(path_length(trace), shortest)
    share = np.where(shortest > 0.0, shortest / np.where(longest > 0.0, longest, 1.0), 1.0)
    return success_rate(trace) * share


def sct(trace: Trace) -> Float[np.ndarray, "world"]:
    """Success weighted by completion time: least over real time, 0 for a failure [1].

    Yokoyama et al. (2021). The least time is that of the shortest path, as in `spl`, at the preferred speed, in whole
    steps.
    """
    least = np.ceil(_shortest_way(trace) / (trace.preferred_speed[:, 0] * trace.rules.dt))
    return success_rate(trace) * np.maximum(least, 1.0) / np.maximum(trace.steps, np.maximum(least, 1.0))


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
    return _sum(_velocity_changes(trace)) / trace.rules.dt / trace.steps


def jerk(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean size of the change of acceleration divided by the time step [m/s^3].

    Undefined in an episode of one step.
    """
    change = norm(np.diff(trace.velocity[:, :, 0], n=2, axis=1)) / trace.rules.dt**2
    return _sum(change) / np.where(trace.steps > 1, trace.steps - 1, np.nan)


def max_turn(trace: Trace) -> Float[np.ndarray, "world"]:
    """Largest change of heading between two steps that are both driven at 0.05 m/s or more [rad]."""
    velocity = trace.velocity[:, 1:, 0]
    heading = np.where(norm(velocity) >= STANDSTILL, np.arctan2(velocity[..., 1], velocity[..., 0]), np.nan)
    turn = np.abs(wrap_angle(np.diff(heading, axis=1)))
    return np.max(turn, axis=1, initial=0.0, where=~np.isnan(turn))


def minimum_gap(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest gap between vehicle and pedestrians, as the simulator's collision check measured it [m].

    The gap is the distance between the rims of two discs: negative where they overlapped. Undefined where there are
    no pedestrians.
    """
    gap = np.nanmin(trace.gap, axis=1)
    return np.where(np.isfinite(gap), gap, np.nan)


def discomfort(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps with a gap to a pedestrian below 0.2 m [1]."""
    return _sum(1.0 * (trace.gap < DISCOMFORT_GAP)) / trace.steps


def discomfort_frequency(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of all steps with a gap below 0.2 m that did not end the episode, pooled as in CrowdNav [1].

    Differs from CrowdNav because an episode that times out counts its own steps, not those of the whole time limit.
    """
    before_last = np.arange(trace.gap.shape[1]) < trace.steps[:, None] - 1
    return _sum(1.0 * ((trace.gap < DISCOMFORT_GAP) & before_last)) / trace.steps


def intimate_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps with a gap to a pedestrian within Hall's intimate distance, 0.45 m [1]."""
    return _in_zone(trace, "intimate")


def personal_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps with a gap to a pedestrian within Hall's personal distance, 1.2 m [1]."""
    return _in_zone(trace, "personal")


def social_zone(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of an episode's steps with a gap to a pedestrian within Hall's social distance, 3.6 m [1]."""
    return _in_zone(trace, "social")


def intrusion_time_ratio(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of steps in which a pedestrian that is seen will be within 0.6 m of where the vehicle is, in 5 steps [1].

    Liu et al. (2023): the distance is between centres, and the pedestrian's positions are its true ones in the next
    `INTRUSION_STEPS` steps. Differs from theirs because no position after the end of the episode is known.
    """
    return _sum(1.0 * np.isfinite(_intrusions(trace))) / trace.steps


def social_distance(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest distance between centres in each step that `intrusion_time_ratio` counts, the mean of these [m].

    Liu et al. (2023). Undefined in an episode without an intrusion.
    """
    nearest = _intrusions(trace)
    intrusions = np.isfinite(nearest)
    count = intrusions.sum(axis=1)
    return _sum(np.where(intrusions, nearest, 0.0)) / np.where(count > 0, count, np.nan)


def time_to_collision(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest time until the vehicle would touch a pedestrian if both kept their velocities of the step [s].

    Undefined in an episode in which they would never touch.
    """
    position = trace.position[:, :-1, 1:] - trace.position[:, :-1, :1]
    velocity = trace.velocity[:, 1:, 1:] - trace.velocity[:, 1:, :1]
    reach = trace.radius[:, :-1, 1:] + trace.radius[:, :-1, :1]
    a = _dot(velocity, velocity)
    b = _dot(position, velocity)
    c = _dot(position, position) - reach**2
    root = b**2 - a * c
    same = trace.person[:, :-1] == trace.person[:, 1:]
    meets = (b < 0) & (root >= 0) & same
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(meets, c / (np.sqrt(np.where(meets, root, 0.0)) - b), np.inf)
    least = np.min(np.maximum(time, 0.0), axis=(1, 2), initial=np.inf)
    return np.where(np.isfinite(least), least, np.nan)


def stopped_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time spent slower than 0.05 m/s [s]."""
    return _sum(1.0 * (norm(trace.velocity[:, 1:, 0]) < STANDSTILL)) * trace.rules.dt


def discounted_return(trace: Trace) -> Float[np.ndarray, "world"]:
    """Sum of discounted rewards from the start [1]."""
    factor = discount(trace.preferred_speed[:, :1], trace.rules.dt) ** np.arange(trace.gap.shape[1])
    return _sum(factor * episode_rewards(trace))


def deflection(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean distance of pedestrians from where they would be in the same case without the vehicle [m].

    Over pedestrians and steps, as long as the same people are there. Undefined where pedestrians do not see the
    vehicle, or there are none.
    """
    if trace.undisturbed is None:
        return np.full(len(trace), np.nan)
    moved = norm(trace.position[:, 1:, 1:] - trace.undisturbed[:, 1:])
    compared = np.isfinite(moved).sum(axis=(1, 2))
    return _sum(_sum(moved.swapaxes(1, 2))) / np.where(compared > 0, compared, np.nan)


METRICS: dict[str, Metric] = {
    metric.__name__: metric
    for metric in (
        success_rate,
        collision_rate,
        wall_collision_rate,
        timeout_rate,
        navigation_time,
        navigation_time_or_limit,
        path_length,
        spl,
        sct,
        minimum_gap,
        discomfort,
        discomfort_frequency,
        intimate_zone,
        personal_zone,
        social_zone,
        intrusion_time_ratio,
        social_distance,
        time_to_collision,
        max_velocity_change,
        max_acceleration,
        mean_acceleration,
        jerk,
        max_turn,
        stopped_time,
        discounted_return,
        deflection,
    )
}
"""The built-in metrics by name."""

OVER_ALL = frozenset({"navigation_time_or_limit", "spl", "sct", "discounted_return"})
"""Metrics that count failures. Two planners are compared in all cases, not only in those that both solve."""

POOLED = frozenset({"discomfort_frequency"})
"""Metrics that are averaged over the steps of all episodes, not over episodes."""


def _shortest_way(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length in metres of the vehicle's route from its start to where it has arrived."""
    near = trace.radius[:, 0, 0] if trace.rules.goal_tolerance is None else trace.rules.goal_tolerance
    start, none = trace.position[:, 0, 0], np.zeros(len(trace), np.int64)
    ahead = local_goals(start, trace.goal[:, 0, 0], trace.route, none)
    return np.maximum(norm(ahead - start) - near, 0.0)


def _velocity_changes(trace: Trace) -> Float[np.ndarray, "world step"]:
    return norm(np.diff(trace.velocity[:, :, 0], axis=1))


def _in_zone(trace: Trace, zone: str) -> Float[np.ndarray, "world"]:
    return _sum(1.0 * (trace.gap < HALL_ZONES[zone])) / trace.steps


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


def _sum(values: Float[np.ndarray, "*batch time"]) -> Float[np.ndarray, "*batch"]:
    # np.sum groups its terms by the shape of the array, which depends on the batch; cumsum goes from left to right.
    if values.shape[-1] == 0:
        return np.zeros(values.shape[:-1])
    return np.cumsum(np.where(np.isnan(values), 0.0, values), axis=-1)[..., -1]


def _dot(a: Float[np.ndarray, "*batch 2"], b: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch"]:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
