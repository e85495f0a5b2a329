"""ORCA, optimal reciprocal collision avoidance (van den Berg et al. 2011), with CrowdNav's parameters for pedestrians.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-Body Collision Avoidance", Robotics Research, Springer 2011.
"""

from crowdbench.sim.pedestrians import ORCA


def policy() -> ORCA:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.orca]`.

    Parameters:
        neighbor_distance: Distance within which a pedestrian notices others [m].
        max_neighbors: Number of neighbours, the nearest, that a pedestrian avoids [1].
        time_horizon: How far ahead a pedestrian avoids collisions: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: How far ahead a pedestrian avoids collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian avoids only agents that no obstacle hides; 0 as in RVO2, through walls [1].

    Returns:
        The policy.
    """
    return ORCA()
