"""ORCA with a margin of 0.2 m, the best of 0 to 1 m on 1,000 validation cases of circle_crossing_5.

It is kept from people, not from walls. ORCA expects pedestrians to do half of the avoiding, and pedestrians that do not
see the vehicle do not. The choice can be repeated:
`crowdbench run --planner orca --option safety_space=0.2 --cases val:1000`.
"""

from crowdbench.planners import ORCAPlanner


def planner() -> ORCAPlanner:
    """Make the planner. It has no options: `orca` takes any margin."""
    return ORCAPlanner(safety_space=0.2)
