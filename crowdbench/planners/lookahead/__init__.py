"""One-step lookahead: every command is tried against the predicted crowd, and the best one is taken."""

from crowdbench.planners.lookahead.planner import ValuePlanner

__all__ = ["ValuePlanner"]
