"""The global state of a world for centralized training: numbers of all agents, along the axes of the world.

Ten numbers follow each other for each agent, the vehicle first, then the pedestrians in their order, recorded ones too:

    position x, y in m · velocity x, y in m/s · radius in m · goal x, y in m · preferred speed in m/s · heading in rad ·
    1 if the agent is present

All numbers of an absent agent are 0. A pedestrian's heading is the direction of its velocity.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import wrap_angle
from crowdbench.core.types import World
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.fleet import ego_order
from crowdbench.views.view import largest_radius, largest_speed, position_bound

Numbers = Float[np.ndarray, "features"]


def state_bounds(scenario: Scenario) -> tuple[Numbers, Numbers]:
    """Return the lowest and the highest state of a world of a scenario."""
    place, speed, radius = position_bound(scenario), largest_speed(scenario), largest_radius(scenario)
    high = np.array([place, place, speed, speed, radius, place, place, speed, math.pi, 1.0])
    low = np.where(np.isin(np.arange(len(high)), (4, 7, 9)), 0.0, -high)
    return np.tile(low, scenario.max_agents), np.tile(high, scenario.max_agents)


def global_state(world: World) -> Float[np.ndarray, "world features"]:
    """Return the state of each world."""
    velocity = world.velocity
    heading = np.arctan2(velocity[..., 1], velocity[..., 0])
    vehicles = world.rules.vehicles
    faces = wrap_angle(world.heading).reshape(-1, vehicles)
    heading[:, :vehicles] = faces[:, ego_order(vehicles)].reshape(-1, vehicles)
    numbers = world.radius, world.goal, world.preferred_speed, heading, world.present
    columns = [np.reshape(part, (*world.radius.shape, -1)) for part in (world.position, velocity, *numbers)]
    state = np.where(world.present[..., None], np.concatenate(columns, axis=2), 0.0)
    return state.reshape(len(world), -1)
