"""SARL-SGAN (Li et al. 2020): the pedestrians' 20 futures as Social GAN predicts them (Gupta et al. 2018).

Li et al., "Socially Aware Crowd Navigation with Multimodal Pedestrian Trajectory Prediction for Autonomous Vehicles",
IEEE ITSC 2020, arXiv:2011.11191. Gupta et al., "Social GAN: Socially Acceptable Trajectories with Generative
Adversarial Networks", CVPR 2018, arXiv:1803.10892.
"""

from functools import partial

from crowdbench.planners import lookahead_planner

planner = partial(lookahead_planner, "sarl", predictor="sgan", weights="sarl", shortlist=8)
