"""Optimal reciprocal collision avoidance (van den Berg et al. 2011), as CrowdNav's pedestrians."""

from crowdbench.sim.pedestrians import ORCA


def policy() -> ORCA:
    """Parameters are set in the scenario, in `[pedestrians.orca]`."""
    return ORCA()
