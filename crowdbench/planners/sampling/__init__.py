"""Sequences of commands over the horizon: many are tried under all futures, refined, and the best one is taken."""

from crowdbench.planners.sampling.planner import CrossEntropy, SequencePlanner

__all__ = ["CrossEntropy", "SequencePlanner"]
