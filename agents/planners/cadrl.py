"""CADRL (Chen et al. 2017), trained among several pedestrians, which it predicts at constant velocity.

Chen, Liu, Everett and How, "Decentralized Non-communicating Multiagent Collision Avoidance with Deep Reinforcement
Learning", ICRA 2017, arXiv:1609.07845.
"""

from crowdbench import load_network, load_predictor
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.lookahead.kce import Limits


def planner(
    weights: str = "cadrl",
    predictor: str = "constant_velocity",
    device: str = "cpu",
    limits: Limits | None = None,
) -> ValuePlanner:
    """Compose the planner.

    Args:
        weights: The trained value network: a name (`crowdbench list weights`) or a file.
        predictor: What predicts the pedestrians: a name (`crowdbench list predictors`) or a file.
        device: Where the value network runs: `cpu` or `cuda`.
        limits: Commands that the vehicle can follow; false for all.

    Returns:
        The planner.
    """
    return ValuePlanner(load_predictor(predictor)[1], load_network("cadrl", weights, device), limits=limits)
