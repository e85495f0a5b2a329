"""SARL-SGAN (Li et al.): pedestrians have the 20 futures that Social GAN gives them."""

from functools import partial

from crowdbench.planners.sarl import sarl_planner

planner = partial(sarl_planner, predictor="sgan", modes=20, shortlist=8)
