"""SARL-SGAN-KCE (Li et al. 2020): Social GAN's 20 futures, kinematic constraints, an explored action space.

Li, Shan, Narula, Worrall and Nebot, "Socially Aware Crowd Navigation with Multimodal Pedestrian Trajectory Prediction
for Autonomous Vehicles", IEEE ITSC 2020, arXiv:2011.11191. `studies/kce` has what each part does, as measured.
"""

from functools import partial

from crowdbench.planners.kce import ChangeCost, Exploration, Limits
from crowdbench.planners.sarl import sarl_planner

planner = partial(
    sarl_planner,
    # III-B: 20 futures of the crowd, under which SARL's network values each command.
    predictor="sgan",
    # Not in the paper: all futures only for the 8 commands that look best, which is faster.
    shortlist=8,
    # III-C, equations 5 and 6: commands that the vehicle cannot follow are left out, with the paper's limits.
    limits=Limits(),
    # Not in the paper: the network was trained within the same limits.
    weights="sarl_kce",
    # III-C, equations 7 and 8: changes of velocity cost something. Differs from equation 8, see `ChangeCost`.
    shaping=ChangeCost(0.006),
    # III-D, equation 9: finer commands around the best one.
    explore=Exploration(epsilon=0.1, n=2),
)
