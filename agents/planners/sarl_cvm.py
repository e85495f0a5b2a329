"""SARL-CVM (Li et al.): pedestrians go on with their last velocity."""

from functools import partial

from crowdbench.planners.sarl import sarl_planner

planner = partial(sarl_planner, predictor="constant_velocity")
