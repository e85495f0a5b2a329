"""The social force model of pedestrians (Helbing and Molnár 1995), with their parameters."""

from crowdbench.sim.pedestrians import SocialForce


def policy() -> SocialForce:
    """Parameters are set in the scenario, in `[pedestrians.social_force]`."""
    return SocialForce()
