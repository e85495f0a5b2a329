"""Whether a plug-in keeps the contract of its kind, point by point."""

from __future__ import annotations

from crowdbench.evaluate.check.layout import check_layout
from crowdbench.evaluate.check.metric import check_metric
from crowdbench.evaluate.check.planner import check_planner
from crowdbench.evaluate.check.point import Point
from crowdbench.evaluate.check.policy import check_policy
from crowdbench.evaluate.check.predictor import check_predictor

__all__ = ["Point", "check_layout", "check_metric", "check_planner", "check_policy", "check_predictor"]
