"""People who walk as they were recorded, and react to nobody; in scenarios with recorded tracks, `[tracks]`."""

from crowdbench.sim.pedestrians import Recorded


def policy() -> Recorded:
    """Make the policy. It has no parameters.

    Returns:
        The policy.
    """
    return Recorded()
