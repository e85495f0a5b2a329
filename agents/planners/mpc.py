"""Model predictive control among pedestrians who move on at constant velocity, solved by IPOPT.

Andersson et al., "CasADi: a software framework for nonlinear optimization and optimal control", Mathematical
Programming Computation 11, 2019. Wächter and Biegler, "On the implementation of an interior-point filter line-search
algorithm for large-scale nonlinear programming", Mathematical Programming 106, 2006.
"""

from crowdbench.planners.mpc import MPCPlanner
from crowdbench.planners.mpc_program import TERMS, Terms
from crowdbench.predict.load import load_predictor


def planner(
    predictor: str = "constant_velocity", terms: Terms = TERMS, horizon: int = 14, iterations: int = 80
) -> MPCPlanner:
    """Make the planner. It needs CasADi: pip install 'crowdbench[mpc]'.

    Args:
        predictor: What predicts the pedestrians: a name (`crowdbench list predictors`) or a file.
        terms: What a program weighs.
        horizon: Number of steps [1].
        iterations: Of IPOPT, at most [1].

    Returns:
        The planner.
    """
    return MPCPlanner(load_predictor(predictor)[1], terms, horizon, iterations)
