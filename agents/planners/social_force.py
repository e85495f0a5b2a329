"""The social force model (Helbing and Molnár 1995) driving the vehicle, with the pedestrians' parameters."""

from crowdbench.planners.reactive import SocialForcePlanner


def planner(safety_space: float = 0.0) -> SocialForcePlanner:
    """`safety_space`, in metres, is added to every radius."""
    return SocialForcePlanner(float(safety_space))
