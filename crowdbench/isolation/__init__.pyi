from .isolated_planner import IsolatedPlanner as IsolatedPlanner
