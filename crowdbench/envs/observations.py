"""The environments' observations: a vector of `6 * agents` float64 numbers per observing agent.

The first six numbers are of the observing agent, the next six of each other agent, in metres and m/s. Positions are
relative to the observing agent; the axes are those of the world, not turned with the agent. The goal is the local goal
(`crowdbench.geometry.local_goals`):

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

from crowdbench.compiled import njit
from crowdbench.dynamics import hull
from crowdbench.sim.neighbors import cells_of, nearest_in_cells, nearest_of_all
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import with_hull
from crowdbench.types import Observation, World

AGENT_FEATURES = 6
"""Numbers per agent in an observation."""


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
    is not visible.
    """
    worlds, agents = world.radius.shape
    if world.rules.sensor.nearest is not None and world.rules.sensor.nearest < agents - 1:
        return _flatten_nearest(world, world.rules.sensor.nearest)
    out = np.zeros((worlds, agents, AGENT_FEATURES * agents))
    shown = with_hull(world)
    _flatten(
        shown.position,
        world.velocity,
        shown.radius,
        world.present,
        goals_on_way(world),
        world.preferred_speed,
        world.rules.visible,
        out,
    )
    if not world.rules.sensor.sees_all:
        out[:, 0] = flatten(observe(world))
    return out


def _flatten_nearest(world: World, number: int) -> Float[np.ndarray, "world agent features"]:
    """`flatten_everybody` where each agent sees the nearest others only, in their order."""
    worlds, agents = world.radius.shape
    out = np.zeros((worlds, agents, AGENT_FEATURES * (1 + number)))
    shown = with_hull(world)
    seen = world.present.copy()
    seen[:, 0] &= world.rules.visible
    own = goals_on_way(world), world.preferred_speed
    cells = cells_of(shown.position, seen)
    _fill_nearest(shown.position, world.velocity, shown.radius, world.present, seen, *own, cells, number, out)
    out[:, 0] = flatten(observe(world))
    return out


@no_type_check
@njit
def _fill_nearest(position, velocity, radius, present, seen, goal, preferred_speed, cells, number, out):
    """Write the observations of all agents that see the nearest others only.

    Args:
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, in m/s.
        radius: `[world, agent]`, in metres.
        present: `[world, agent]`, whether the agent observes.
        seen: `[world, agent]`, whether the agent can be seen by pedestrians.
        goal: `[world, agent, 2]`, in metres.
        preferred_speed: `[world, agent]`, in m/s.
        cells: `Cells`, or None.
        number: How many others each agent sees.
        out: `[world, agent, features]`, zeros, filled.
    """
    neighbor, distance, no_walls = np.empty(number, np.int64), np.empty(number), np.empty((0, 0, 2))
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            if not present[w, i]:
                continue
            x, y = position[w, i, 0], position[w, i, 1]
            _write_viewer(out[w, i], x, y, goal[w, i], velocity[w, i], radius[w, i], preferred_speed[w, i])
            if cells is None:  # noqa: SIM114  # see `orca`
                n = nearest_of_all(w, i, position, seen, np.inf, number, False, no_walls, neighbor, distance)
            elif cells.size[w, 0] < 0:
                n = nearest_of_all(w, i, position, seen, np.inf, number, False, no_walls, neighbor, distance)
            else:
                n = nearest_in_cells(w, i, position, cells, np.inf, number, False, no_walls, neighbor, distance)
            neighbor[:n].sort()
            for k in range(n):
                j = neighbor[k]
                _write_other(out[w, i], 1 + k, x, y, position[w, j], velocity[w, j], radius[w, j])


@no_type_check
@njit
def _flatten_vehicle(position, velocity, radius, goal, preferred_speed, positions, velocities, radii, seen, out):
    """Write the observations of vehicles.

    Args:
        position: `[world, 2]`, the vehicle's, in metres.
        velocity: `[world, 2]`, in m/s.
        radius: `[world]`, in metres.
        goal: `[world, 2]`, in metres.
        preferred_speed: `[world]`, in m/s.
        positions: `[world, pedestrian, 2]`, in metres.
        velocities: `[world, pedestrian, 2]`, in m/s.
        radii: `[world, pedestrian]`, in metres.
        seen: `[world, pedestrian]`.
        out: `[world, features]`, zeros, filled.
    """
    for w in range(len(out)):
        x, y = position[w, 0], position[w, 1]
        _write_viewer(out[w], x, y, goal[w], velocity[w], radius[w], preferred_speed[w])
        for p in range(radii.shape[1]):
            if seen[w, p]:
                _write_other(out[w], 1 + p, x, y, positions[w, p], velocities[w, p], radii[w, p])


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


@no_type_check
@njit
def _flatten(position, velocity, radius, present, goal, preferred_speed, visible, out):
    """Write the observations of all agents.

    Args:
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, in m/s.
        radius: `[world, agent]`, in metres.
        present: `[world, agent]`, whether the agent can be seen and observes.
        goal: `[world, agent, 2]`, in metres.
        preferred_speed: `[world, agent]`, in m/s.
        visible: Whether pedestrians see the vehicle.
        out: `[world, agent, features]`, zeros, filled.
    """
    worlds, observers, _ = out.shape
    for w in range(worlds):
        for i in range(observers):
            if not present[w, i]:
                continue
            x, y = position[w, i, 0], position[w, i, 1]
            _write_viewer(out[w, i], x, y, goal[w, i], velocity[w, i], radius[w, i], preferred_speed[w, i])
            slot = 0
            for j in range(radius.shape[1]):
                if j == i:
                    continue
                slot += 1
                if present[w, j] and (j > 0 or visible):
                    _write_other(out[w, i], slot, x, y, position[w, j], velocity[w, j], radius[w, j])
