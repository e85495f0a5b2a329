"""SARL-Lin (Li et al. 2020): pedestrians go straight on along a line fitted to their last 8 positions.

Li et al., "Socially Aware Crowd Navigation with Multimodal Pedestrian Trajectory Prediction for Autonomous Vehicles",
IEEE ITSC 2020, arXiv:2011.11191.
"""

from functools import partial

from crowdbench.planners import lookahead_planner

planner = partial(lookahead_planner, "sarl", predictor="linear", weights="sarl")
