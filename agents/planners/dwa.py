"""The dynamic window approach among pedestrians who move on at constant velocity.

Fox et al., "The dynamic window approach to collision avoidance", IEEE Robotics & Automation Magazine 4(1), 1997.
"""

from crowdbench.planners.dwa import OBJECTIVE, DWAPlanner, Objective
from crowdbench.predict.load import load_predictor


def planner(predictor: str = "constant_velocity", objective: Objective = OBJECTIVE, horizon: int = 14) -> DWAPlanner:
    """Make the planner.

    Args:
        predictor: What predicts the pedestrians: a name (`crowdbench list predictors`) or a file.
        objective: What makes a command good.
        horizon: Number of steps for which a command is kept [1].

    Returns:
        The planner.
    """
    return DWAPlanner(load_predictor(predictor)[1], objective, horizon)
