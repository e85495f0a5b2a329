"""Whether a plug-in keeps the contract of its kind, check by check."""

from __future__ import annotations

from crowdbench.check.layout import check_layout
from crowdbench.check.metric import check_metric
from crowdbench.check.planner import check_planner
from crowdbench.check.policy import check_policy
from crowdbench.check.predictor import check_predictor
from crowdbench.check.result import CheckResult
from crowdbench.check.reward import check_reward
from crowdbench.check.scenario import check_scenario

__all__ = [
    "CheckResult",
    "check_layout",
    "check_metric",
    "check_planner",
    "check_policy",
    "check_predictor",
    "check_reward",
    "check_scenario",
]
