"""The planner of MAPPO in fleets: crowdbench run --planner studies/fleets/mappo.py --scenario fleet_4."""

from crowdbench import Planner, load_planner


def planner() -> Planner:
    """Return the planner of the first network."""
    return load_planner("ppo_attention", {"weights": "mappo"})
