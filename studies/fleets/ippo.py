"""The planner of IPPO in fleets: crowdbench run --planner studies/fleets/ippo.py --scenario fleet_4."""

from crowdbench import Planner, load_planner


def planner() -> Planner:
    """Return the planner of the first network."""
    return load_planner("ppo_attention", {"weights": "ippo"})
