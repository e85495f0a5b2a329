"""Walks straight to the goal and gives way to nobody."""

from crowdbench.sim.pedestrians import Straight


def policy() -> Straight:
    """Make the policy, which has no parameters.

    Returns:
        The policy.
    """
    return Straight()
