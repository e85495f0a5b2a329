"""Straight to the next waypoint at preferred speed, never slowing: the floor that every planner should beat."""

from crowdbench.planners.reactive import Straight


def planner() -> Straight:
    """Make the planner."""
    return Straight()
