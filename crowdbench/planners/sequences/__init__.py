"""Sequences of commands: whole ways into the predicted future are tried, refined, and the best one is taken."""

from crowdbench.planners.sequences.planner import SequencePlanner

__all__ = ["SequencePlanner"]
