"""The metrics: functions of a trace that give one value per episode, NaN where a metric is undefined.

`crowdbench list metrics` prints the first line of each docstring, which contains the unit in brackets. A metric with
boolean values is a rate. To add a metric, write its function in the module of its subject, describe it by `describe`,
and name it in `SUBJECTS`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Shaped

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
)
from crowdbench.metrics.encounters import (
    near_misses,
    near_misses_per_hour,
    paths_apart,
    post_encroachment_time,
    speed_near_pedestrians,
    time_to_collision,
)
from crowdbench.metrics.info import UNDISTURBED as UNDISTURBED
from crowdbench.metrics.info import Metric as Metric
from crowdbench.metrics.info import MetricInfo as MetricInfo
from crowdbench.metrics.info import describe as describe
from crowdbench.metrics.info import read_unit
from crowdbench.metrics.motion import (
    cumulative_heading_change,
    frozen_time,
    jerk,
    max_acceleration,
    max_turn,
    max_velocity_change,
    mean_acceleration,
    path_irregularity,
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
    t_empty,
    timeout_rate,
    wall_collision_rate,
)
from crowdbench.metrics.score import score, t_close, worst_score
from crowdbench.metrics.social import deflection, imposed_delay, imposed_delay_positive, imposed_detour, social_work
from crowdbench.utils.errors import did_you_mean

SUBJECTS: dict[str, tuple[Metric, ...]] = {
    "end": (success_rate, collision_rate, person_collision_rate, wall_collision_rate, timeout_rate),
    "time": (navigation_time, navigation_time_or_limit),
    "score": (score, t_empty, t_close),
    "path": (path_length, success_path_length, path_irregularity, spl, sct),
    "gap": (minimum_gap, clearing_distance, discomfort, discomfort_frequency, personal_space_compliance),
    "zone": (intimate_zone, personal_zone, social_zone),
    "intrusion": (intrusion_time_ratio, social_distance, group_intrusion, social_work),
    "encounter": (time_to_collision, near_misses, near_misses_per_hour),
    "passing": (post_encroachment_time, paths_apart, speed_near_pedestrians),
    "acceleration": (max_velocity_change, max_acceleration, mean_acceleration, jerk),
    "heading": (max_turn, cumulative_heading_change, success_heading_change),
    "standstill": (stopped_time, success_stopped_time, frozen_time, failures_to_progress),
    "contact": (impact_speed, vehicle_share),
    "fault": (at_fault_rate, at_fault_seen_rate, hit_alone_rate, hit_both_rate),
    "struck": (struck_standing_rate, struck_behind_rate, struck_otherwise_rate),
    "reward": (discounted_return,),
    "cost to pedestrians": (deflection, imposed_delay, imposed_delay_positive, imposed_detour),
}
"""The built-in metrics by subject, in the order of tables and of columns."""

METRICS: dict[str, Metric] = {metric.__name__: metric for metrics in SUBJECTS.values() for metric in metrics}
"""The built-in metrics by name."""

OF_FLEETS: dict[str, Metric] = {"worst_score": worst_score}
"""Further built-in metrics of scenarios with several vehicles."""


MAIN = (
    "score",
    "success_rate",
    "collision_rate",
    "at_fault_rate",
    "timeout_rate",
    "navigation_time",
    "jerk",
    "minimum_gap",
)
"""The metrics of a table if none are requested."""


def is_rate(values: Shaped[np.ndarray, "case"]) -> bool:
    """Return whether a metric with these values is a rate: the share of the episodes for which it is true."""
    return values.dtype == bool


def info_of(name: str, is_rate: bool = False, metric: Metric | None = None) -> MetricInfo:
    """Return the description of a metric.

    A user's metric without a description has its name as title and the unit of its docstring. It may read all fields of
    a trace.

    Args:
        is_rate: True if its values are booleans, which makes it a share.
        metric: The metric, if available; built-in metrics are looked up by name.
    """
    function = metric or METRICS.get(name) or OF_FLEETS.get(name)
    info = getattr(function, "info", None)
    if info is None:
        title = name.removesuffix("_rate").replace("_", " ")
        info = MetricInfo(title, read_unit(function), needs=frozenset({UNDISTURBED}))
    return replace(info, share=True) if is_rate else info


def need_undisturbed(metrics: Mapping[str, Metric]) -> bool:
    """Return whether any of these metrics needs `Trace.undisturbed`."""
    return any(UNDISTURBED in info_of(name, metric=metric).needs for name, metric in metrics.items())


def no_metric(name: str, known: Collection[str]) -> str:
    """Return the error message of a run without a metric, with similar names and the names of all its metrics."""
    return f"has no metric {name}{did_you_mean(name, known)}; it has {', '.join(known)}"
