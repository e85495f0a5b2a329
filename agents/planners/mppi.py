"""Model predictive path integral control among pedestrians at constant velocity.

Williams et al., "Information theoretic MPC for model-based reinforcement learning", ICRA 2017.
"""

from crowdbench import MPPIPlanner, load_predictor
from crowdbench.planners import MPPISearch, MPPIWeights


def planner(
    predictor: str = "constant_velocity",
    search: MPPISearch = MPPIPlanner.search,
    weights: MPPIWeights = MPPIPlanner.weights,
    horizon: int = 18,
    worst: float = 1.0,
) -> MPPIPlanner:
    """Make the planner.

    Args:
        predictor: Predictor of the pedestrians: a name (`crowdbench list predictors`) or a file.
        search: How sequences are sampled.
        weights: Costs of sequences.
        horizon: Number of steps of a sequence [1].
        worst: The share of the futures, the worst for a sequence, of which the mean counts (CVaR); 1 for all [1].

    Returns:
        The planner.
    """
    return MPPIPlanner(load_predictor(predictor), search, weights, horizon, worst)
