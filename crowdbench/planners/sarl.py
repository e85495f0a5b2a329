"""Planners with a one-step lookahead and a trained network: CADRL, LSTM-RL, SARL, and the parts of SARL-SGAN-KCE.

SARL is Chen, Liu, Kreiss and Alahi, "Crowd-Robot Interaction: Crowd-aware Robot Navigation with Attention-based Deep
Reinforcement Learning", ICRA 2019, arXiv:1809.08835. The rest is Li, Shan, Narula, Worrall and Nebot, "Socially Aware
Crowd Navigation with Multimodal Pedestrian Trajectory Prediction for Autonomous Vehicles", IEEE ITSC 2020,
arXiv:2011.11191, whose sections and equations are named below.
"""

from __future__ import annotations

from crowdbench.networks.value import load_network
from crowdbench.planners.kce import ChangeCost, Exploration, Limits, PrintedShaping
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict.predictors import load_predictor


def lookahead_planner(
    network: str,
    predictor: str,
    weights: str,
    device: str = "cpu",
    modes: int | None = None,
    shortlist: int | None = None,
    limits: Limits | None = None,
    shaping: ChangeCost | PrintedShaping | None = None,
    explore: Exploration | None = None,
) -> ValuePlanner:
    """Compose a planner with a one-step lookahead around a value network.

    Args:
        network: The name of the network.
        predictor: Predictor of the pedestrians: a name (`crowdbench list predictors`) or a file.
        weights: The trained value network: a name (`crowdbench list weights`) or a file.
        device: Where the value network runs: `cpu` or `cuda`.
        modes: Number of futures to predict; false for the predictor's default number [1].
        shortlist: Number of commands to value under all futures, the best under their mean; false for all [1].
        limits: Commands that the vehicle can follow; false for all.
        shaping: Reward of a change of velocity; false for none.
        explore: Finer commands to try around the best one; false for none.

    Returns:
        The planner.

    Raises:
        InputError: An option is impossible.
    """
    return ValuePlanner(
        # III-C.1, equations 1 and 2: several futures of the crowd.
        predictor=load_predictor(predictor, {} if modes is None else {"modes": modes}),
        # III-C.2, equations 3 and 4: the value V_s of the state that a command leads to, the mean over all futures.
        value=load_network(network, weights, device),
        # III-D, equations 5 and 6: commands that the vehicle cannot follow are left out.
        limits=limits,
        # III-D, equations 7 and 8: changes of velocity change the reward.
        shaping=shaping,
        # III-E, equation 9: finer commands around the best one.
        explore=explore,
        # Not in the paper: only the best commands are evaluated under all futures, which is faster.
        shortlist=shortlist,
    )
