"""SARL-SGAN-KCE (Li et al. 2020): Social GAN's 20 futures, kinematic constraints, an explored action space.

Li, Shan, Narula, Worrall and Nebot, "Socially Aware Crowd Navigation with Multimodal Pedestrian Trajectory Prediction
for Autonomous Vehicles", IEEE ITSC 2020, arXiv:2011.11191. `studies/kce` has what each part does, as measured.

Differs from the paper in nine points, six of the planner and three of the experiments; `studies/li2020` has reasons:

1. III-B, IV-A: Social GAN has no pooling module, and was trained on ETH/UCY at steps of 0.25 s. `studies/social_gan`
   has figures with pooling.
2. IV-A: SARL's network was trained here, among 1 to 10 pedestrians within the limits below; theirs is CrowdNav's.
3. Equations 3 and 4: the value of a command is the mean over futures, which the paper leaves open. The discount is
   gamma^(dt v_pref), as in CrowdNav (Chen et al. 2019), and not gamma^(v_pref).
4. Equation 7: the cost of discomfort is (d_min - 0.2) / 2 dt, as in CrowdNav. As printed, a larger gap would cost more.
5. Equation 8: a change of velocity costs 0.006 per m/s in every step, see `ChangeCost`.
6. Equation 9: the finer commands are a grid over speed and heading; epsilon and n are ours. All 20 futures are valued
   only for the 8 commands that are best under their mean.
7. IV-A: pedestrians have the same parameters in the study's tables of the paper, as in CrowdNav, and not Gaussian ones.
8. IV-A: 500 cases and five networks, and not 100 cases, 500 in Table 1.
9. IV-B: "Max Acc" is taken for the largest change of velocity in a step, as a mean and as a maximum over cases.

Equations 5 and 6 are the paper's. At 1 m/s the limit of 6.4 m/s^2 excludes nothing: it is 1.6 m/s in a step of 0.25 s.
"""

from functools import partial

from crowdbench.planners import ChangeCost, Exploration, Limits, lookahead_planner

planner = partial(
    lookahead_planner,
    "sarl",
    # III-C: 20 futures of the crowd, under which SARL's network values each command.
    predictor="sgan",
    # Not in the paper: all futures only for the 8 commands that look best, which is faster.
    shortlist=8,
    # III-D, equations 5 and 6: commands that the vehicle cannot follow are left out, with the paper's limits.
    limits=Limits(),
    # Not in the paper: the network was trained within the same limits.
    weights="sarl_kce",
    # III-D, equations 7 and 8: changes of velocity cost something. Differs from equation 8, see `ChangeCost`.
    shaping=ChangeCost(0.006),
    # III-E, equation 9: finer commands around the best one.
    explore=Exploration(epsilon=0.1, n=2),
)
