"""Optimal reciprocal collision avoidance, as CrowdNav's ORCA robot."""

from crowdbench.planners.reactive import ORCAPlanner


def planner(safety_space: float = 0.0) -> ORCAPlanner:
    """`safety_space`, in metres, is added to every radius."""
    return ORCAPlanner(float(safety_space))
