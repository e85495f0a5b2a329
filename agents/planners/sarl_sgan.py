"""SARL-SGAN (Li et al. 2020): the pedestrians' 20 futures as Social GAN predicts them (Gupta et al. 2018).

Li et al., "Socially Aware Crowd Navigation with Multimodal Pedestrian Trajectory Prediction for Autonomous Vehicles",
IEEE ITSC 2020, arXiv:2011.11191. Gupta et al., "Social GAN: Socially Acceptable Trajectories with Generative
Adversarial Networks", CVPR 2018, arXiv:1803.10892.
"""

from functools import partial

from crowdbench.planners import sarl_planner

planner = partial(sarl_planner, predictor="sgan", shortlist=8)
