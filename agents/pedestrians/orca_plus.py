"""ORCA (van den Berg et al. 2011) as the pedestrians of CrowdNav++ follow it: with a margin, and goals at 1 m/s.

Liu et al., "Intention Aware Robot Crowd Navigation with Attention-Based Interaction Graph", ICRA 2023, and their code.
"""

from crowdbench.sim.pedestrians import ORCAPlus


def policy() -> ORCAPlus:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.orca_plus]`.

    The velocity that leads to the goal is 1 m/s fast and slower in the last metre, whatever the preferred speed is. The
    preferred speed is the largest.

    Parameters:
        neighbor_distance: Distance within which a pedestrian notices others [m].
        max_neighbors: Number of neighbours, the nearest, that a pedestrian avoids; all by default [1].
        time_horizon: How far ahead a pedestrian avoids collisions: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: How far ahead a pedestrian avoids collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian avoids only agents that no obstacle hides; 0 as in RVO2, through walls [1].

    Returns:
        The policy.
    """
    return ORCAPlus()
