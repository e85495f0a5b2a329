"""ORCA with parameters and a population that were fitted to recorded people, see studies/people.

ORCA: van den Berg et al. 2011. Data: ETH/UCY (Pellegrini et al. 2009, Lerner et al. 2007).
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench import ORCA, PedestrianPolicy, World
from crowdbench.core import norm, toward_goal
from crowdbench.sim import Agents, Avoidance, Parameters, Velocities, avoid, goals_on_way

MARGIN = 0.01
"""Safety margin in metres, as for the policy `orca`."""

VARIED = ("time_horizon", "neighbor_distance", "personal_space")
"""The fitted parameters, which differ between people."""


class ORCAPeople(PedestrianPolicy):
    """ORCA for people: they differ in the distances that they keep, and their intentions vary."""

    parameters: ClassVar[Mapping[str, float]] = {
        **ORCA.parameters,
        "time_horizon": 2.2,
        "neighbor_distance": 4.4,
        "personal_space": 1.1,
    }
    population: ClassVar[Mapping[str, Any]] = {
        "noise": 0.147,
        "noise_time": 0.98,
        "inertia": 2.5,
        "shrinkage": 0.014,
        "spread": {"preferred_speed": 0.134, "inertia": 0.98, **dict.fromkeys(VARIED, 0.373)},
    }

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        return avoid_people(world, toward_goal(world.position, goals_on_way(world), world.preferred_speed), parameters)


def avoid_people(world: World, preferred: Float[np.ndarray, "world agent 2"], parameters: Parameters) -> Velocities:
    """Return the velocities that pedestrians take by ORCA with personal space, which the vehicle does not count in.

    Args:
        world: The worlds as they are now.
        preferred: Velocities in m/s that they would take if they were alone.
        parameters: See `policy`.

    Returns:
        Velocities in m/s, not faster than the preferred speed or the preferred velocity.
    """
    crowd = Agents(
        world.position,
        world.velocity,
        preferred,
        world.radius + (MARGIN + parameters["safety_space"]),
        np.maximum(world.preferred_speed, norm(preferred)),
        world.present,
        world.present,
        2.0 * world.radius * (parameters["personal_space"] - 1.0),
    )
    avoidance = Avoidance(*(parameters[name] for name in Avoidance._fields))
    return avoid(1, crowd, world.rules.dt, world.obstacles, avoidance)


def policy() -> ORCAPeople:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.orca_people]`.

    Parameters:
        neighbor_distance: Distance within which a pedestrian avoids others [m].
        max_neighbors: Number of nearest neighbours that a pedestrian avoids [1].
        time_horizon: Time horizon for collisions with other agents: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: Time horizon for collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian ignores agents behind obstacles; 0 if it avoids them, as in RVO2 [1].
        personal_space: Distance between the centres of two pedestrians that a pedestrian keeps, in diameters of its
            body [1].

    Returns:
        The policy.
    """
    return ORCAPeople()
