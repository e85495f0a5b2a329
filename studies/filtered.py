"""A planner behind a Kalman filter, for studies of scenarios with noise and without a tracker."""

from crowdbench import load_planner
from crowdbench.planners import FilteredPlanner


def planner(name: str, weights: str | None = None) -> FilteredPlanner:
    """Make the planner.

    Args:
        name: The planner behind the filter.
        weights: Its trained network; None for its default.

    Returns:
        The planner.
    """
    return FilteredPlanner(load_planner(name, {} if weights is None else {"weights": weights}))
