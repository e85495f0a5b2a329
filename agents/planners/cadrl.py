"""CADRL (Chen et al. 2017), trained among several pedestrians; they are foreseen at constant velocity."""

from crowdbench import load_network, load_predictor
from crowdbench.planners.lookahead import ValuePlanner


def planner(weights: str = "cadrl", predictor: str = "constant_velocity", device: str = "cpu") -> ValuePlanner:
    """`weights` and `predictor` are names (`crowdbench list`) or files; `device` is cpu or cuda."""
    return ValuePlanner(load_predictor(predictor)[1], load_network("cadrl", weights, device))
