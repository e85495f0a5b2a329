"""The metrics: functions of a trace that give one value per episode, NaN where a metric is undefined.

The first line of each docstring is what `crowdbench list metrics` shows; its unit stands in brackets.
A metric with booleans is a rate. To add a metric, write its function in the module of its subject, and name it in
`SUBJECTS`.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection

import numpy as np
from jaxtyping import Bool, Float, Shaped

from crowdbench.core.types import Trace
from crowdbench.metrics.contacts import (
    at_fault_rate,
    at_fault_seen_rate,
    hit_alone_rate,
    hit_both_rate,
    impact_speed,
    struck_behind_rate,
    struck_otherwise_rate,
    struck_standing_rate,
    vehicle_share,
)
from crowdbench.metrics.distances import (
    clearing_distance,
    discomfort,
    discomfort_frequency,
    group_intrusion,
    intimate_zone,
    intrusion_time_ratio,
    minimum_gap,
    personal_space_compliance,
    personal_zone,
    social_distance,
    social_zone,
    time_to_collision,
)
from crowdbench.metrics.freezing import frozen_time
from crowdbench.metrics.motion import (
    cumulative_heading_change,
    jerk,
    max_acceleration,
    max_turn,
    max_velocity_change,
    mean_acceleration,
    path_length,
    sct,
    spl,
    stopped_time,
    success_heading_change,
    success_path_length,
    success_stopped_time,
)
from crowdbench.metrics.outcomes import (
    collision_rate,
    discounted_return,
    failures_to_progress,
    navigation_time,
    navigation_time_or_limit,
    person_collision_rate,
    success_rate,
    timeout_rate,
    wall_collision_rate,
)
from crowdbench.metrics.social import deflection, imposed_delay, imposed_detour, social_work

Metric = Callable[[Trace], Bool[np.ndarray, "world"] | Float[np.ndarray, "world"]]

SUBJECTS: dict[str, tuple[Metric, ...]] = {
    "end": (success_rate, collision_rate, person_collision_rate, wall_collision_rate, timeout_rate),
    "time": (navigation_time, navigation_time_or_limit),
    "path": (path_length, success_path_length, spl, sct),
    "gap": (minimum_gap, clearing_distance, discomfort, discomfort_frequency, personal_space_compliance),
    "zone": (intimate_zone, personal_zone, social_zone),
    "intrusion": (intrusion_time_ratio, social_distance, group_intrusion, social_work, time_to_collision),
    "acceleration": (max_velocity_change, max_acceleration, mean_acceleration, jerk),
    "heading": (max_turn, cumulative_heading_change, success_heading_change),
    "standstill": (stopped_time, success_stopped_time, frozen_time, failures_to_progress),
    "contact": (impact_speed, vehicle_share),
    "fault": (at_fault_rate, at_fault_seen_rate, hit_alone_rate, hit_both_rate),
    "struck": (struck_standing_rate, struck_behind_rate, struck_otherwise_rate),
    "reward": (discounted_return,),
    "cost to pedestrians": (deflection, imposed_delay, imposed_detour),
}
"""The built-in metrics by what they measure, in the order of tables and of columns."""

METRICS: dict[str, Metric] = {metric.__name__: metric for metrics in SUBJECTS.values() for metric in metrics}
"""The built-in metrics by name."""


def _names(*metrics: Metric) -> frozenset[str]:
    return frozenset(metric.__name__ for metric in metrics)


OVER_ALL = _names(
    navigation_time_or_limit,
    spl,
    sct,
    discounted_return,
    frozen_time,
    failures_to_progress,
    impact_speed,
    vehicle_share,
)
"""Metrics that count failures. Two planners are compared in all cases, not only in those that both solve."""

MORE_IS_BETTER = _names(success_rate, spl, sct, discounted_return) | _names(
    minimum_gap, clearing_distance, personal_space_compliance, social_distance, time_to_collision
)
"""Metrics whose smallest value is the worst; of the others it is the largest."""

UNDISTURBED = _names(deflection, imposed_delay, imposed_detour)
"""Metrics that compare with the same case without the vehicle: the crowd is simulated a second time for them."""

POOLED = _names(discomfort_frequency)
"""Metrics that are averaged over the steps of all episodes, not over episodes."""


def is_rate(values: Shaped[np.ndarray, "case"]) -> bool:
    """Whether a metric with these values is a rate: the share of the episodes for which it is true."""
    return values.dtype == bool


def unit_of(metric: Metric) -> str:
    """The unit of a metric, in brackets at the end of its docstring's first line; empty where it has none."""
    first = str(metric.__doc__ or "").partition("\n")[0]
    unit = first.rpartition("[")[2].rstrip("].") if "[" in first else ""
    return "" if unit == "1" else unit


ABBREVIATIONS = ("sct", "spl")
"""Metrics that papers call by their initials."""


def heading(name: str, is_rate: bool) -> str:
    """What the column of a metric is called, with its unit, which is % for a rate."""
    unit = "%" if is_rate else unit_of(METRICS[name]) if name in METRICS else ""
    words = name.upper() if name in ABBREVIATIONS else name.removesuffix("_rate").replace("_", " ")
    return f"{words}, {unit}" if unit else words


def no_metric(name: str, known: Collection[str]) -> str:
    """What is said of a run that lacks a metric: which of its metrics may be meant, and all of them."""
    like = difflib.get_close_matches(name, known, 2)
    meant = f" (did you mean {' or '.join(like)}?)" if like else ""
    return f"has no metric {name}{meant}; it has {', '.join(known)}"
