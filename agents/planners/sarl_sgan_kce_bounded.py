"""Beyond Li et al. (2020): SARL-SGAN-KCE with a bound on the change of velocity, for which its network was trained.

`studies/kce/README.md` has the bounds that were compared on validation cases.
"""

from functools import partial

from crowdbench.planners import ChangeCost, Exploration, Limits, lookahead_planner

planner = partial(
    lookahead_planner,
    "sarl",
    # As in `sarl_sgan_kce`, where the paper's sections are named.
    predictor="sgan",
    shortlist=8,
    shaping=ChangeCost(0.006),
    explore=Exploration(epsilon=0.1, n=2),
    # Not in the paper: a bound beside the paper's limits, and a network that was trained within both.
    limits=Limits(max_velocity_change=0.8),
    weights="sarl_bounded",
)
