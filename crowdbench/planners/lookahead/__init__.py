"""One-step lookahead: every command is tried on the predicted crowd, and the best is taken."""

from crowdbench.planners.lookahead.planner import ValuePlanner

__all__ = ["ValuePlanner"]
