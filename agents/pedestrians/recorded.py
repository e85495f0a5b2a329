"""Recorded pedestrians, which do not react; for scenarios with recorded tracks, `[tracks]`."""

from crowdbench.sim import Recorded


def policy() -> Recorded:
    """Make the policy. It has no parameters.

    Returns:
        The policy.
    """
    return Recorded()
