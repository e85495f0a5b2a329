"""ORCA, optimal reciprocal collision avoidance (van den Berg et al. 2011), with the parameters of CrowdNav's robot.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-Body Collision Avoidance", Robotics Research, Springer 2011.
"""

from crowdbench.planners import ORCAPlanner


def planner(safety_space: float = 0.0) -> ORCAPlanner:
    """Make the planner.

    Args:
        safety_space: Margin that is added to every radius [m].

    Returns:
        The planner.
    """
    return ORCAPlanner(float(safety_space))
