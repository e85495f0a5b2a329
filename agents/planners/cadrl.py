"""CADRL (Chen et al. 2017), trained among several pedestrians, which it predicts at constant velocity.

Chen, Liu, Everett and How, "Decentralized Non-communicating Multiagent Collision Avoidance with Deep Reinforcement
Learning", ICRA 2017, arXiv:1609.07845.
"""

from functools import partial

from crowdbench.planners import lookahead_planner

planner = partial(lookahead_planner, "cadrl", predictor="constant_velocity", weights="cadrl")
