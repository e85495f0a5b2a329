"""SARL-Lin (Li et al.): pedestrians go on along the line fitted to their last 8 positions."""

from functools import partial

from crowdbench.planners.sarl import sarl_planner

planner = partial(sarl_planner, predictor="linear")
