"""SARL-CVM (Li et al. 2020): pedestrians keep their last velocity (Schöller et al. 2020).

Li et al., "Socially Aware Crowd Navigation with Multimodal Pedestrian Trajectory Prediction for Autonomous Vehicles",
IEEE ITSC 2020, arXiv:2011.11191. Schöller et al., "What the Constant Velocity Model Can Teach Us About Pedestrian
Motion Prediction", IEEE RA-L 2020, arXiv:1903.07933.
"""

from functools import partial

from crowdbench.planners import lookahead_planner

planner = partial(lookahead_planner, "sarl", predictor="constant_velocity", weights="sarl")
