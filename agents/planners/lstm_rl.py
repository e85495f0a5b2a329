"""LSTM-RL (Everett et al. 2018); pedestrians are foreseen at constant velocity."""

from crowdbench import load_network, load_predictor
from crowdbench.planners.lookahead import ValuePlanner


def planner(weights: str = "lstm_rl", predictor: str = "constant_velocity", device: str = "cpu") -> ValuePlanner:
    """`weights` and `predictor` are names (`crowdbench list`) or files; `device` is cpu or cuda."""
    return ValuePlanner(load_predictor(predictor)[1], load_network("lstm_rl", weights, device))
