"""LSTM-RL (Everett et al. 2018), as in CrowdNav; pedestrians are predicted at constant velocity.

Everett, Chen and How, "Motion Planning Among Dynamic, Decision-Making Agents with Deep Reinforcement Learning", IROS
2018, arXiv:1805.01956.
"""

from crowdbench import load_network, load_predictor
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.lookahead.kce import Limits


def planner(
    weights: str = "lstm_rl",
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
    return ValuePlanner(load_predictor(predictor)[1], load_network("lstm_rl", weights, device), limits=limits)
