"""SARL (Chen et al. 2019) as published: it sees the true next step of the pedestrians, which no vehicle could."""

from crowdbench.catalog import load_network, load_predictor
from crowdbench.lookahead import ValuePlanner


def planner(weights: str = "sarl", predictor: str = "oracle", device: str = "cpu") -> ValuePlanner:
    """`weights` and `predictor` are names (`crowdbench list`) or files; `device` is cpu or cuda."""
    return ValuePlanner(load_predictor(predictor)[1], load_network("sarl", weights, device))
