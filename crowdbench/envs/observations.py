"""The environments' observations: a vector of `6 * agents` float64 numbers per observing agent.

The first six numbers are of the observing agent, the next six of each other agent, in metres and m/s. Positions are
relative to the observing agent; the axes are those of the world, not turned with the agent. The goal is the local goal
(`crowdbench.core.geometry.local_goals`):

    observing agent: goal x, goal y, velocity x, velocity y, radius, preferred speed
    other agent:     position x, position y, velocity x, velocity y, radius, 1.0

All six numbers of an agent that is not seen are 0.0. The vehicle observes the pedestrians in their order; a pedestrian
observes the vehicle first, then the other pedestrians in their order. In crowds of more than a hundred each agent
observes the nearest others only (`Sensor.nearest`).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.dynamics import hull
from crowdbench.core.types import PERFECT, Observation, World
from crowdbench.sim.neighbors import cells_of, nearest_in_cells, nearest_of_all
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import with_bounding_disc
from crowdbench.utils.compiled import njit

AGENT_FEATURES = 6
"""Numbers per agent in an observation."""

_OF_AGENTS = ("position", "velocity", "origin", "goal", "route", "waypoint", "radius", "preferred_speed")


class _Agents(NamedTuple):
    """What observations are made of. Positions and goals are in metres, velocities in m/s, as in a `World`."""

    position: Float[np.ndarray, "world agent 2"]
    velocity: Float[np.ndarray, "world agent 2"]
    radius: Float[np.ndarray, "world agent"]
    goal: Float[np.ndarray, "world agent 2"]
    preferred_speed: Float[np.ndarray, "world agent"]
    present: Bool[np.ndarray, "world agent"]  # who observes
    seen: Bool[np.ndarray, "world agent"]  # whom pedestrians see


def flatten(obs: Observation) -> Float[np.ndarray, "world features"]:
    """What a planner sees, as the vector that the environments return for the vehicle."""
    vehicle, crowd = obs.vehicle, obs.pedestrians
    centre, radius = hull(vehicle.body, vehicle.position, vehicle.heading, vehicle.radius)
    out = np.zeros((len(obs), AGENT_FEATURES * (1 + crowd.radius.shape[1])))
    own = centre, vehicle.velocity, radius, vehicle.local_goal, vehicle.preferred_speed
    _flatten_vehicle(*own, crowd.position, crowd.velocity, crowd.radius, crowd.seen, out)
    return out


def flatten_everybody(world: World) -> Float[np.ndarray, "world agent features"]:
    """The observation of each agent; zeros for agents that are not present.

    Row 0 is `flatten(observe(world))`: only the vehicle's sight can be limited. Pedestrians do not see a vehicle that
    is not visible. Where each agent sees the nearest others only, these are in their order.
    """
    worlds, agents = world.radius.shape
    shown, sensor = with_bounding_disc(world), world.rules.sensor
    seen = world.present
    if not world.rules.visible:
        seen = seen.copy()
        seen[:, 0] = False
    own = goals_on_way(world), world.preferred_speed
    everybody = shown.position, world.velocity, shown.radius, *own, world.present, seen
    number = min(sensor.nearest or agents, agents - 1)
    out = np.zeros((worlds, agents, AGENT_FEATURES * (1 + number)))
    if number < agents - 1:
        _flatten_nearest(*everybody, cells_of(shown.position, seen), number, out)
    else:
        _flatten(*everybody, out)
    if number < agents - 1 or not sensor.sees_all:
        out[:, 0] = flatten(observe(world))
    return out


def ego_views(world: World) -> World:
    """A world for each agent of one world, in which that agent is agent 0 and the others follow in their order.

    So what is written for the vehicle serves pedestrians too. A pedestrian's world lacks a vehicle that is not visible.
    Everybody sees everybody exactly and at once: a sensor is the vehicle's alone. Headings, histories, persons, groups,
    policies, parameters and memories are those of the world as it was: they are of the vehicle and of the pedestrians
    in their own order.
    """
    agents = world.radius.shape[1]
    order = np.arange(agents)
    agent = np.where(order[None] == 0, order[:, None], order - (order[None] <= order[:, None]))
    worlds = world.take(np.zeros(agents, np.int64))
    present = world.present[0][agent]
    present[1:, 1] &= world.rules.visible
    rules = world.rules if world.rules.sensor == PERFECT else dataclasses.replace(world.rules, sensor=PERFECT)
    ordered = {name: getattr(world, name)[0][agent] for name in _OF_AGENTS}
    return worlds.replace(present=present, rules=rules, sight={}, **ordered)


@no_type_check
@njit
def _flatten_vehicle(position, velocity, radius, goal, preferred_speed, positions, velocities, radii, seen, out):
    """Write the observations of vehicles `[world, features]`: their own arrays first, then those of pedestrians."""
    for w in range(len(out)):
        x, y = position[w, 0], position[w, 1]
        _write_viewer(out[w], x, y, goal[w], velocity[w], radius[w], preferred_speed[w])
        for p in range(radii.shape[1]):
            if seen[w, p]:
                _write_other(out[w], 1 + p, x, y, positions[w, p], velocities[w, p], radii[w, p])


@no_type_check
@njit
def _flatten(position, velocity, radius, goal, preferred_speed, present, seen, out):
    """Write the observations `[world, agent, features]` of all `_Agents`, which are zeros before."""
    # Put together here, because numba takes longer to look at a tuple of arrays than at the arrays.
    agents = _Agents(position, velocity, radius, goal, preferred_speed, present, seen)
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            if not agents.present[w, i]:
                continue
            x, y = _write_agent(out[w, i], agents, w, i)
            slot = 0
            for j in range(out.shape[1]):
                if j == i:
                    continue
                slot += 1
                if agents.seen[w, j]:
                    _write_other(
                        out[w, i], slot, x, y, agents.position[w, j], agents.velocity[w, j], agents.radius[w, j]
                    )


@no_type_check
@njit
def _flatten_nearest(position, velocity, radius, goal, preferred_speed, present, seen, cells, number, out):
    """As `_flatten`, where each agent sees so many others, the nearest; `cells` are `Cells` of those seen, or None."""
    agents = _Agents(position, velocity, radius, goal, preferred_speed, present, seen)
    neighbor, distance, no_walls = np.empty(number, np.int64), np.empty(number), np.empty((0, 0, 2))
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            if not agents.present[w, i]:
                continue
            x, y = _write_agent(out[w, i], agents, w, i)
            if cells is None:  # noqa: SIM114  # see `orca`
                n = nearest_of_all(w, i, position, seen, np.inf, number, False, no_walls, neighbor, distance)
            elif cells.size[w, 0] < 0:
                n = nearest_of_all(w, i, position, seen, np.inf, number, False, no_walls, neighbor, distance)
            else:
                n = nearest_in_cells(w, i, position, cells, np.inf, number, False, no_walls, neighbor, distance)
            neighbor[:n].sort()
            for k in range(n):
                j = neighbor[k]
                _write_other(out[w, i], 1 + k, x, y, position[w, j], agents.velocity[w, j], agents.radius[w, j])


@no_type_check
@njit
def _write_agent(row, agents, w, i):
    """Write the first numbers of the observation of agent i in world w, and return where it is."""
    x, y = agents.position[w, i, 0], agents.position[w, i, 1]
    _write_viewer(
        row, x, y, agents.goal[w, i], agents.velocity[w, i], agents.radius[w, i], agents.preferred_speed[w, i]
    )
    return x, y


@no_type_check
@njit
def _write_viewer(row, x, y, goal, velocity, radius, preferred_speed):
    """Write the first numbers of an observation, those of the agent at (x, y) that observes."""
    row[0], row[1] = goal[0] - x, goal[1] - y
    row[2], row[3] = velocity[0], velocity[1]
    row[4], row[5] = radius, preferred_speed


@no_type_check
@njit
def _write_other(row, slot, x, y, position, velocity, radius):
    """Write the numbers of another agent into a slot of the observation of the agent at (x, y)."""
    k = AGENT_FEATURES * slot
    row[k], row[k + 1] = position[0] - x, position[1] - y
    row[k + 2], row[k + 3] = velocity[0], velocity[1]
    row[k + 4], row[k + 5] = radius, 1.0
