"""Stands somewhere on the way; groups stand in a circle, as people do who talk."""

from crowdbench.sim.pedestrians import Standing


def policy() -> Standing:
    """Make the policy, which has no parameters.

    Returns:
        The policy.
    """
    return Standing()
