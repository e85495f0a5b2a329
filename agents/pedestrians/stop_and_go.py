"""ORCA with pauses: people who stop and go, such as those who look at their phones."""

from crowdbench.sim.pedestrians import ORCA, StopAndGo


def policy() -> StopAndGo:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.stop_and_go]`.

    Parameters:
        period: Time from one pause to the next [s].
        pause: Share of the period for which a pedestrian stands [1].
        neighbor_distance: Distance within which a pedestrian notices others [m].
        max_neighbors: Number of neighbours, the nearest, that a pedestrian avoids [1].
        time_horizon: How far ahead a pedestrian avoids collisions: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: How far ahead a pedestrian avoids collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian avoids only agents that no obstacle hides; 0 as in RVO2, through walls [1].

    Returns:
        The policy.
    """
    return StopAndGo(ORCA())
