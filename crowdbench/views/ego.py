"""The environments' observations: a vector of `6 * agents` float64 numbers per observing agent.

The first six numbers describe the observing agent. Six more follow for each other agent, in metres and m/s. Positions
are relative to the observing agent; the axes are the world's axes, not turned with the agent. The goal is the local
goal (`crowdbench.core.geometry.local_goals`):

    observing agent: goal x, goal y, velocity x, velocity y, radius, preferred speed
    other agent:     position x, position y, velocity x, velocity y, radius, 1.0

All six numbers of an agent that is not seen are 0.0. The vehicle observes the pedestrians in their order; a pedestrian
observes the vehicle first, then the other pedestrians in their order. In crowds of more than a hundred each agent
observes the nearest others only (`Sensor.nearest`).
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Observation, World
from crowdbench.sim.fleet import ego_order
from crowdbench.sim.neighbors import cells_of, nearest_in_cells, nearest_of_all
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import with_bounding_disc
from crowdbench.utils.compiled import njit

AGENT_FEATURES = 6
"""Numbers per agent in an observation."""

_OF_AGENTS = ("position", "velocity", "origin", "goal", "route", "waypoint", "radius", "preferred_speed")


def flatten(obs: Observation) -> Float[np.ndarray, "world features"]:
    """Return a planner's observation as the vector that the environments return for the vehicle."""
    position, velocity, radius, seen = obs.everybody()
    goal, speed = obs.vehicle.local_goal[:, None], obs.vehicle.preferred_speed[:, None]
    out = np.zeros((len(obs), 1, AGENT_FEATURES * radius.shape[1]))
    flatten_agents(position, velocity, radius, goal, speed, seen, seen, out)
    return out[:, 0]


def flatten_vehicle(world: World) -> Float[np.ndarray, "world features"]:
    """Return `flatten(observe(world))`, without copies of arrays if the vehicle sees all agents."""
    worlds, agents = world.radius.shape
    sensor = world.rules.sensor
    if sensor.nearest or not sensor.sees_all:
        return flatten(observe(world))
    out = np.zeros((worlds, 1, AGENT_FEATURES * agents))
    flatten_agents(*states_of(world), out)
    return out[:, 0]


def flatten_everybody(world: World) -> Float[np.ndarray, "world agent features"]:
    """Return the observation of each agent; zeros for agents that are not present.

    Row 0 is `flatten(observe(world))`: only the vehicle's sensor can be limited. Pedestrians do not see an invisible
    vehicle. If each agent observes only the nearest others, they are sorted by index.
    """
    worlds, agents = world.radius.shape
    states, sensor = states_of(world), world.rules.sensor
    number = min(sensor.nearest or agents, agents - 1)
    out = np.zeros((worlds, agents, AGENT_FEATURES * (1 + sensor.columns(agents - 1))))
    if number < agents - 1:
        _flatten_nearest(*states, cells_of(states[0], states[-1]), number, out)
    else:
        flatten_agents(*states, out)
    if number < agents - 1 or not sensor.sees_all:
        out[:, 0] = flatten(observe(world))
    return out


def states_of(world: World) -> tuple[np.ndarray, ...]:
    """Return the input arrays of `flatten_agents`, with the smallest disc around the vehicle's body as the vehicle."""
    bounded, seen = with_bounding_disc(world), world.present
    if not world.rules.visible:
        seen = seen.copy()
        seen[:, : world.rules.vehicles] = False
    goals_and_speed = goals_on_way(world), world.preferred_speed
    return bounded.position, world.velocity, bounded.radius, *goals_and_speed, world.present, seen


def ego_views(world: World) -> World:
    """Return a world for each agent of each world, in which that agent is agent 0 and the others follow in their order.

    Functions for the vehicle can thus be applied to pedestrians. An invisible vehicle is absent from a pedestrian's
    world. Every agent observes all others exactly and without delay, because only the vehicle has a sensor. Headings,
    histories, persons, groups, policies, parameters and memories are not reordered: they belong to the vehicle and the
    pedestrians in the original order.
    """
    agents = world.radius.shape[1]
    row = np.repeat(np.arange(len(world)), agents)[:, None]
    agent = np.tile(ego_order(agents), (len(world), 1))
    worlds = world.take(row[:, 0])
    present = world.present[row, agent]
    vehicles = world.rules.vehicles
    present[:, 1 : vehicles + 1] &= (agent[:, :1] < vehicles) | world.rules.visible
    ordered = {name: getattr(world, name)[row, agent] for name in _OF_AGENTS}
    return worlds.replace(present=present, rules=world.rules.with_perfect_sensor, sight={}, **ordered)


def with_own_motion(views: World, world: World, past: Float[np.ndarray, "1 time 2"] | None = None) -> World:
    """Return the ego views of one world with what else an agent observes: its motion, and the others' histories.

    A pedestrian is a disc that moves in any direction. Its heading is the direction of its velocity.

    Args:
        views: `ego_views` of the world.
        world: The world.
        past: The last positions of the vehicle in metres, as `World.history`; None to leave out the histories.
    """
    velocity, rules = views.velocity[:, 0], world.rules.of_pedestrian
    heading = np.arctan2(velocity[:, 1], velocity[:, 0])
    views = views.replace(rules=rules, heading=heading, angular_speed=np.zeros(len(views)))
    if past is None:
        return views
    everybody = np.concatenate([past[:, :, None], world.history], axis=2)[0]
    return views.replace(history=everybody[:, ego_order(world.radius.shape[1])[:, 1:]].swapaxes(0, 1))


@no_type_check
@njit
def flatten_agents(position, velocity, radius, goal, preferred_speed, present, seen, out):
    """Write observations into an array `[world, agent, features]` of zeros.

    Args:
        position (ndarray): `[world, agent, 2]`, in metres.
        velocity (ndarray): `[world, agent, 2]`, in m/s.
        radius (ndarray): `[world, agent]`, in metres.
        goal (ndarray): `[world, observer, 2]`, in metres; the first agents are the observers.
        preferred_speed (ndarray): `[world, observer]`, in m/s.
        present (ndarray): `[world, agent]`, True for observing agents.
        seen (ndarray): `[world, agent]`, True for agents that pedestrians see.
        out (ndarray): The array to fill.
    """
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            if not present[w, i]:
                continue
            row, here = out[w, i], position[w, i]
            _write(row, 0, here, goal[w, i], velocity[w, i], radius[w, i], preferred_speed[w, i])
            for j in range(position.shape[1]):
                if j != i and seen[w, j]:
                    slot = j + 1 if j < i else j
                    _write(row, slot, here, position[w, j], velocity[w, j], radius[w, j], 1.0)


@no_type_check
@njit
def _flatten_nearest(position, velocity, radius, goal, preferred_speed, present, seen, cells, number, out):
    """Write observations as `flatten_agents`, but of the `number` nearest other agents; `cells`: `Cells` of seen
    agents, or None."""
    neighbor, distance = np.empty(number, np.int64), np.empty(number)
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            if not present[w, i]:
                continue
            row, here = out[w, i], position[w, i]
            _write(row, 0, here, goal[w, i], velocity[w, i], radius[w, i], preferred_speed[w, i])
            if cells is None:
                n = nearest_of_all(w, i, position, seen, np.inf, number, neighbor, distance)
            else:
                n = nearest_in_cells(w, i, position, cells, np.inf, number, None, neighbor, distance)
            neighbor[:n].sort()
            for k in range(n):
                j = neighbor[k]
                _write(row, 1 + k, here, position[w, j], velocity[w, j], radius[w, j], 1.0)


@no_type_check
@njit
def _write(row, slot, here, point, velocity, radius, last):
    """Write the six numbers of one agent into a slot of the observation of the agent at position `here`."""
    k = AGENT_FEATURES * slot
    row[k], row[k + 1] = point[0] - here[0], point[1] - here[1]
    row[k + 2], row[k + 3] = velocity[0], velocity[1]
    row[k + 4], row[k + 5] = radius, last
