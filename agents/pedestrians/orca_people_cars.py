"""ORCA for people among cars, with parameters that were fitted to recorded people. For worlds with cars only.

ORCA: van den Berg et al. 2011. Among people: `orca_people`. Clearance to cars: chosen on DUT (Yang et al. 2019) by
`studies/people/fit_cars.py`. Neighbour distance: the range of attention to vehicles.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from agents.pedestrians.orca_people import MARGIN, ORCAPeople
from crowdbench import World
from crowdbench.core import toward_goal
from crowdbench.sim import Agents, Avoidance, Parameters, Velocities, avoid, goals_on_way

DISCS = np.array([-1.0, 0.0, 1.0])
"""Places of the discs that represent a car, from its last to its first one."""


class ORCAPeopleCars(ORCAPeople):
    """`orca_people` among cars, each of which is three discs along its axis."""

    parameters: ClassVar[Mapping[str, float]] = {**ORCAPeople.parameters, "neighbor_distance": 10.0}
    attention: ClassVar[Mapping[str, Any]] = {"clearance": 1.1, "ignores": 0.0}

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`. A vehicle that is a disc is one agent."""
        body = world.rules.body
        if len(body) == 1:
            return super().velocities(world, parameters)
        # The vehicle in the input is the smallest disc around its body.
        reach = (body[-1] - body[0]) / 2.0
        ahead = np.stack([np.cos(world.heading), np.sin(world.heading)], axis=-1)
        position, radius = _with_discs(world.position), _with_discs(world.radius)
        position[:, : len(DISCS)] += reach * DISCS[:, None] * ahead[:, None]
        radius[:, : len(DISCS)] -= reach
        own = {name: _with_discs(parameters[name]) for name in self.parameters}
        seen = _with_discs(world.present)
        crowd = Agents(
            position,
            _with_discs(world.velocity),
            _with_discs(toward_goal(world.position, goals_on_way(world), world.preferred_speed)),
            radius + (MARGIN + own["safety_space"]),
            _with_discs(world.preferred_speed),
            seen,
            seen,
            2.0 * radius * (own["personal_space"] - 1.0),
        )
        avoidance = Avoidance(*(own[name] for name in Avoidance._fields))
        return avoid(len(DISCS), crowd, world.rules.dt, world.obstacles, avoidance)


def _with_discs(values: Float[np.ndarray, "world agent *more"]) -> Float[np.ndarray, "world other *more"]:
    """Return values of agents in which the vehicle's are repeated for each of its discs."""
    return np.repeat(values, [len(DISCS)] + [1] * (values.shape[1] - 1), axis=1)


def policy() -> ORCAPeopleCars:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.orca_people_cars]`.

    It brings a clearance to the vehicle, which `[pedestrians.attention]` can replace.

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
    return ORCAPeopleCars()
