"""Metrics of the outcomes and durations of episodes."""

from __future__ import annotations

import math
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.geometry import norm
from crowdbench.core.reward import discount, episode_rewards
from crowdbench.core.types import Outcome, Trace
from crowdbench.metrics.info import describe, total
from crowdbench.sim.least_time import least_steps
from crowdbench.sim.routes import goals_in_trace

PROGRESS_DISTANCE = 0.5
"""Metres that a vehicle must come nearer to its goal within `PROGRESS_TIME`, or it fails to progress."""

PROGRESS_TIME = 5.0
"""In seconds."""

COUNTED = {
    "success_rate": (Outcome.SUCCESS,),
    "collision_rate": (Outcome.COLLISION, Outcome.WALL_COLLISION),
    "person_collision_rate": (Outcome.COLLISION,),
    "wall_collision_rate": (Outcome.WALL_COLLISION,),
    "timeout_rate": (Outcome.TIMEOUT,),
}
"""The outcomes that each of these rates counts."""

_LEAST: WeakKeyDictionary[Trace, Float[np.ndarray, "world"]] = WeakKeyDictionary()


@describe("success", "more", share=True)
def success_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes in which the vehicle reached its goal [1]."""
    return np.isin(trace.outcome, COUNTED["success_rate"])


@describe("collisions", "less", share=True)
def collision_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended in a collision, with a pedestrian or an obstacle [1]."""
    return np.isin(trace.outcome, COUNTED["collision_rate"])


@describe("collisions with pedestrians", "less", share=True)
def person_collision_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended in a collision with a pedestrian [1]."""
    return np.isin(trace.outcome, COUNTED["person_collision_rate"])


@describe("collisions with obstacles", "less", share=True)
def wall_collision_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended in a collision with an obstacle [1]."""
    return np.isin(trace.outcome, COUNTED["wall_collision_rate"])


@describe("timeouts", "less", share=True)
def timeout_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ran out of time [1]."""
    return np.isin(trace.outcome, COUNTED["timeout_rate"])


@describe("time", "less")
def navigation_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time from start to goal, over successes [s]."""
    return np.where(success_rate(trace), trace.steps * trace.rules.dt, np.nan)


@describe("time in the empty world")
def t_empty(trace: Trace) -> Float[np.ndarray, "world"]:
    """Lower bound of the time from start to goal without pedestrians, within the vehicle's limits [s].

    It is the time of the shortest path of the vehicle's body around obstacles, in whole steps, up to the goal's
    tolerance, see `crowdbench.sim.least_time`. On open ground, a straight drive takes as long.
    """
    if trace not in _LEAST:
        _LEAST[trace] = trace.rules.dt * least_steps(
            trace.rules,
            trace.position[:, 0, 0],
            trace.goal[:, 0, 0],
            velocity=trace.velocity[:, 0, 0],
            heading=trace.heading[:, 0],
            radius=trace.radius[:, 0, 0],
            max_speed=trace.preferred_speed[:, 0],
            obstacles=trace.obstacles,
        )
    return _LEAST[trace]


@describe("time with failures at the limit", "less", over_all=True)
def navigation_time_or_limit(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time from start to goal, a failure counting as the time limit [s]."""
    rules = trace.rules
    limit = np.full(len(trace), rules.time_limit)
    if rules.time_limit_factor is not None:
        limit = np.minimum(limit, rules.time_limit_factor * t_empty(trace))
    return np.where(success_rate(trace), trace.steps * rules.dt, limit)


@describe("failures to progress", "less", over_all=True, source="Francis et al. (2023)")
def failures_to_progress(trace: Trace) -> Float[np.ndarray, "world"]:
    """Number of times that the vehicle did not come 0.5 m nearer to its goal within 5 s [1].

    Francis et al. (2023), without values for the two thresholds. Distances are along the vehicle's route. The 5 s
    restart when the vehicle is 0.5 m nearer than at their start, and after each failure.
    """
    remaining = norm(goals_in_trace(trace) - trace.position[:, :, 0])
    patience = math.ceil(PROGRESS_TIME / trace.rules.dt - 1e-9)
    began, since, failures = remaining[:, 0].copy(), np.zeros(len(trace)), np.zeros(len(trace))
    for t in range(1, int(trace.steps.max()) + 1):
        nearer = began - remaining[:, t] >= PROGRESS_DISTANCE
        failed = ~nearer & (t - since >= patience) & (t <= trace.steps)
        failures += failed
        again = nearer | failed
        began[again], since[again] = remaining[again, t], t
    return failures


@describe("discounted return", "more", over_all=True)
def discounted_return(trace: Trace) -> Float[np.ndarray, "world"]:
    """Sum of discounted rewards from the start [1]."""
    factor = discount(trace.preferred_speed[:, :1], trace.rules.dt) ** np.arange(trace.gap.shape[1])
    return total(factor * episode_rewards(trace))
