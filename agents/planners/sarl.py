"""SARL (Chen et al. 2019) as published: it sees the true next step of the pedestrians, which no vehicle could."""

from functools import partial

from crowdbench.planners.sarl import sarl_planner

planner = partial(sarl_planner, predictor="oracle")
