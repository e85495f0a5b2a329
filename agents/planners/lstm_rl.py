"""LSTM-RL (Everett et al. 2018), as in CrowdNav; pedestrians are predicted at constant velocity.

Everett, Chen and How, "Motion Planning Among Dynamic, Decision-Making Agents with Deep Reinforcement Learning", IROS
2018, arXiv:1805.01956.
"""

from functools import partial

from crowdbench.planners import lookahead_planner

planner = partial(lookahead_planner, "lstm_rl", predictor="constant_velocity", weights="lstm_rl")
