"""SARL (Chen et al. 2019) as published: it is shown the pedestrians' true next step, which no vehicle can see.

Chen, Liu, Kreiss and Alahi, "Crowd-Robot Interaction: Crowd-aware Robot Navigation with Attention-based Deep
Reinforcement Learning", ICRA 2019, arXiv:1809.08835.
"""

from functools import partial

from crowdbench.planners import lookahead_planner

planner = partial(lookahead_planner, "sarl", predictor="oracle", weights="sarl")
