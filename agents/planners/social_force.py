"""The social force model (Helbing and Molnár 1995) drives the vehicle, with the paper's parameters for pedestrians.

Helbing and Molnár, "Social force model for pedestrian dynamics", Physical Review E 51, 1995.
"""

from crowdbench.planners.reactive import SocialForcePlanner


def planner(safety_space: float = 0.0) -> SocialForcePlanner:
    """Make the planner.

    Args:
        safety_space: Margin that is added to every radius [m].

    Returns:
        The planner.
    """
    return SocialForcePlanner(float(safety_space))
