"""ORCA with parameters and a population that were fitted to recorded people, see studies/people.

ORCA: van den Berg et al. 2011. Data: ETH/UCY (Pellegrini et al. 2009, Lerner et al. 2007), `studies/people/fits/orca`.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

from crowdbench import ORCA

OWN = ("time_horizon", "neighbor_distance", "safety_space")
"""The fitted parameters, which differ between people."""


class ORCAPeople(ORCA):
    """ORCA for people: near avoidance, at different distances, of intentions that vary."""

    parameters: ClassVar[Mapping[str, float]] = {
        **ORCA.parameters,
        "time_horizon": 2.0,
        "neighbor_distance": 3.5,
        "safety_space": 0.03,
    }
    population: ClassVar[Mapping[str, Any]] = {
        "noise": 0.4,
        "noise_time": 0.6,
        "inertia": 2.5,
        "shrinkage": 0.2,
        "spread": {"preferred_speed": 0.03, **dict.fromkeys(OWN, 0.5)},
    }


def policy() -> ORCAPeople:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.orca_people]`.

    Parameters:
        neighbor_distance: Distance within which a pedestrian avoids others [m].
        max_neighbors: Number of nearest neighbours that a pedestrian avoids [1].
        time_horizon: Time horizon for collisions with other agents: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: Time horizon for collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian ignores agents behind obstacles; 0 if it avoids them, as in RVO2 [1].

    Returns:
        The policy.
    """
    return ORCAPeople()
