"""Model predictive path integral control under the 20 futures of Social GAN.

Williams et al., "Information theoretic MPC for model-based reinforcement learning", ICRA 2017. Gupta et al., "Social
GAN: socially acceptable trajectories with generative adversarial networks", CVPR 2018.
"""

from crowdbench import MPPIPlanner, load_predictor
from crowdbench.planners import MPPISearch, MPPIWeights


def planner(
    modes: int = 20,
    worst: float = 1.0,
    search: MPPISearch = MPPIPlanner.search,
    weights: MPPIWeights = MPPIPlanner.weights,
    horizon: int = 18,
) -> MPPIPlanner:
    """Make the planner.

    Args:
        modes: Number of futures to predict [1].
        worst: The share of the futures, the worst for a sequence, of which the mean counts (CVaR); 1 for all [1].
        search: How sequences are sampled.
        weights: Costs of sequences.
        horizon: Number of steps of a sequence [1].

    Returns:
        The planner.
    """
    return MPPIPlanner(load_predictor("sgan", {"modes": modes}), search, weights, horizon, worst)
