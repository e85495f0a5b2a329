"""SARL-CVM (Li et al.): pedestrians go on with their last velocity."""

from crowdbench.catalog import load_network, load_predictor
from crowdbench.lookahead import ValuePlanner


def planner(weights: str = "sarl", predictor: str = "constant_velocity", device: str = "cpu") -> ValuePlanner:
    """`weights` and `predictor` are names (`crowdbench list`) or files; `device` is cpu or cuda."""
    return ValuePlanner(load_predictor(predictor)[1], load_network("sarl", weights, device))
