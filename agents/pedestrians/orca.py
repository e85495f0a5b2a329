"""ORCA, optimal reciprocal collision avoidance (van den Berg et al. 2011), with CrowdNav's parameters for pedestrians.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-Body Collision Avoidance", Robotics Research, Springer 2011.
"""

from crowdbench import ORCA


def policy() -> ORCA:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.orca]`.

    Parameters:
        neighbor_distance: Distance within which a pedestrian avoids others [m].
        max_neighbors: Number of nearest neighbours that a pedestrian avoids [1].
        time_horizon: Time horizon for collisions with other agents: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: Time horizon for collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian ignores agents behind obstacles; 0 if it avoids them, as in RVO2 [1].

    Returns:
        The policy.
    """
    return ORCA()
