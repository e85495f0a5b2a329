"""Metrics of the vehicle's path."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.metrics.outcomes import success_rate
from crowdbench.evaluate.metrics.sums import total
from crowdbench.geometry import local_goals, norm
from crowdbench.types import Trace


def path_length(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length of the vehicle's path [m]."""
    return total(norm(np.diff(trace.position[:, :, 0], axis=1)))


def success_path_length(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length of the vehicle's path, over successes: who collides early has a short path [m]."""
    return np.where(success_rate(trace), path_length(trace), np.nan)


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


def _shortest_way(trace: Trace) -> Float[np.ndarray, "world"]:
    """Length in metres of the vehicle's route from its start to where it has arrived."""
    near = trace.radius[:, 0, 0] if trace.rules.goal_tolerance is None else trace.rules.goal_tolerance
    start, none = trace.position[:, 0, 0], np.zeros(len(trace), np.int64)
    ahead = local_goals(start, trace.goal[:, 0, 0], trace.route, none)
    return np.maximum(norm(ahead - start) - near, 0.0)
