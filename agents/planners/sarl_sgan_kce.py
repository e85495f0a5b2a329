"""SARL-SGAN-KCE (Li et al.): 20 futures of Social GAN, kinematic constraints and an explored action space."""

from crowdbench import load_network, load_predictor
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.lookahead.aggregate import find_aggregate
from crowdbench.planners.lookahead.kce import Exploration, Limits
from crowdbench.planners.sarl import shaping


def planner(
    weights: str = "sarl",
    predictor: str = "sgan",
    device: str = "cpu",
    modes: int = 20,
    aggregate: str = "mean",
    shortlist: int | None = 8,
    cost: float = 0.006,
    threshold: float | None = None,
    epsilon: float = 0.1,
    n: int = 2,
    max_velocity_change: float = 1.16,
) -> ValuePlanner:
    """See `crowdbench.planners.sarl.sarl_planner`; the sections and equations are those of Li et al."""
    return ValuePlanner(
        # III-B.1, equation 1: several futures of the crowd.
        predictor=load_predictor(predictor, {"modes": modes})[1],
        # III-B.2, equations 3 and 4: SARL's value of the state that a command leads to ...
        value=load_network("sarl", weights, device),
        # ... under all futures at once (crowd, equation 2), or each by itself.
        aggregate=find_aggregate(aggregate),
        # III-C, equations 5 and 6: commands that the vehicle cannot follow are left out.
        limits=Limits(max_velocity_change=max_velocity_change),
        # III-C, equations 7 and 8: changes of velocity cost something; to the letter if there is a threshold.
        shaping=shaping(cost, threshold),
        # III-D, equation 9: finer commands around the best.
        explore=Exploration(epsilon, n),
        # Not in the paper: for speed, all futures only for the commands that look best.
        shortlist=shortlist,
    )
