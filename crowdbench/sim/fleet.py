"""Several vehicles in a world.

A world has a row for each vehicle, one after the other. In its row, a vehicle is agent 0, the other vehicles follow in
their order, then the pedestrians. So all functions of one vehicle hold for each of several. The policies of pedestrians
and the post-step rule are evaluated in the first row of a world, and hold for all of its rows.

The episode of a vehicle has ended if its steps have reached `World.max_steps`. A vehicle that has arrived is no longer
present; any other one stands as an obstacle until the episodes of all vehicles have ended.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.dynamics import Holonomic
from crowdbench.core.geometry import least_distance
from crowdbench.core.types import Outcome, World
from crowdbench.core.types.world import map_nested, widen

Rows = Bool[np.ndarray, "world"]

CHORDS = 8
"""Number of chords that replace the arc of a vehicle on wheels when vehicles are checked for collisions."""

_OF_AGENTS = "position", "velocity", "origin", "goal", "route", "waypoint", "radius", "preferred_speed", "present"
_OF_PEDESTRIANS = "person", "since", "group", "policy"


def ego_order(agents: int) -> Int[np.ndarray, "observer agent"]:
    """Return for each agent the agents as it observes them: itself, and the others in their order."""
    order = np.arange(agents)
    return np.where(order[None] == 0, order[:, None], order - (order[None] <= order[:, None]))


def first_rows(world: World) -> World:
    """Return the first row of each world."""
    return world.take(np.arange(0, len(world), world.rules.vehicles))


def is_running(world: World) -> Rows:
    """Return the rows of vehicles whose episode has not ended."""
    return np.asarray(world.step < world.max_steps)


def in_whole_worlds(rows: Rows, vehicles: int) -> Rows:
    """Return all rows of the worlds that have some of the given rows."""
    return rows.reshape(-1, vehicles).any(axis=1).repeat(vehicles)


def spread_decisions(
    world: World, velocity: Float[np.ndarray, "first pedestrian 2"], first: World
) -> tuple[Float[np.ndarray, "world pedestrian 2"], World]:
    """Return the decisions of pedestrians in all rows of worlds; other vehicles keep their velocity.

    Args:
        world: The worlds.
        velocity: The decisions in their first rows, in m/s.
        first: The first rows, with the memories after the decisions.
    """
    vehicles = world.rules.vehicles
    velocity = velocity.repeat(vehicles, axis=0)
    velocity[:, : vehicles - 1] = world.velocity[:, 1:vehicles]
    memory = {
        name: map_nested(lambda array: array.repeat(vehicles, axis=0), part) for name, part in first.memory.items()
    }
    return velocity, world.replace(memory=memory)


def without_other_vehicles(world: World) -> World:
    """Return worlds in which each vehicle is alone with the pedestrians."""
    present = world.present.copy()
    present[:, 1 : world.rules.vehicles] = False
    return world.replace(present=present)


def join_vehicles(world: World, after: tuple[np.ndarray, ...]) -> Rows:
    """Join the rows of each world after a step, in place, and return the rows whose vehicle touches another one.

    Vehicles whose episode has ended do not move.

    Args:
        world: The worlds before the step.
        after: The fields of `crowdbench.sim.simulator.After`.
    """
    vehicles, ended = world.rules.vehicles, ~is_running(world)
    _, position, velocity, heading, angular_speed, history = after
    position[ended, 0], heading[ended] = world.position[ended, 0], world.heading[ended]
    velocity[ended, 0], angular_speed[ended] = 0.0, 0.0
    for array in (position, velocity):
        own = array[:, 0].reshape(-1, vehicles, 2)
        array[:, 1:vehicles] = own[:, ego_order(vehicles)[:, 1:]].reshape(-1, vehicles - 1, 2)
    history[:, -1, : vehicles - 1] = position[:, 1:vehicles]
    return _touches(world, after)


def _touches(world: World, after: tuple[np.ndarray, ...]) -> Rows:
    """Return the vehicles that touch another one in a step."""
    _, position, velocity, heading, angular_speed, _ = after
    vehicles, path = world.rules.vehicles, np.stack([world.position[:, 0], position[:, 0]], axis=1)
    if not isinstance(world.rules.dynamics, Holonomic):
        time = world.rules.dt * np.arange(CHORDS + 1) / CHORDS
        half = 0.5 * angular_speed[:, None] * time
        speed = velocity[:, 0, 0] * np.cos(heading) + velocity[:, 0, 1] * np.sin(heading)
        length, toward = speed[:, None] * time * np.sinc(half / np.pi), world.heading[:, None] + half
        path = path[:, :1] + length[..., None] * np.stack([np.cos(toward), np.sin(toward)], axis=2)
    path = path.reshape(-1, vehicles, path.shape[1], 2)
    between = path[:, :, None] - path[:, None]
    distance = least_distance(between[..., :-1, :], np.diff(between, axis=3)).min(axis=3)
    radius, present = (array[:, 0].reshape(-1, vehicles) for array in (world.radius, world.present))
    touch = (distance < radius[:, :, None] + radius[:, None]) & present[:, None] & ~np.eye(vehicles, dtype=bool)
    return np.asarray(touch.any(axis=2).ravel())


def end_episodes(world: World, outcome: Int[np.ndarray, "world"]) -> World:
    """Return worlds after a step, without vehicles that have arrived, in which episodes with an outcome have ended."""
    vehicles, ended = world.rules.vehicles, outcome != Outcome.RUNNING
    arrived = (outcome == Outcome.SUCCESS).reshape(-1, vehicles)
    present = world.present.copy()
    present[:, :vehicles] &= ~arrived[:, ego_order(vehicles)].reshape(-1, vehicles)
    max_steps = np.where(ended, np.minimum(world.max_steps, world.step), world.max_steps)
    return world.replace(present=present, max_steps=max_steps)


def hold_vehicles(first: World) -> World:
    """Return the first rows of worlds with other vehicles that stand, so that the post-step rule leaves them alone."""
    speed = first.preferred_speed.copy()
    speed[:, 1 : first.rules.vehicles] = 0.0
    return first.replace(preferred_speed=speed)


def with_pedestrians_of(world: World, first: World) -> World:
    """Return worlds with the vehicles of all their rows, and the pedestrians of their first rows."""
    vehicles = world.rules.vehicles
    people = first.take(np.arange(len(first)).repeat(vehicles))
    fields = {"history": np.concatenate([world.history[:, :, : vehicles - 1], people.history[:, :, vehicles - 1 :]], 2)}
    for names, number in ((_OF_AGENTS, vehicles), (_OF_PEDESTRIANS, vehicles - 1)):
        for name in names:
            mine, theirs = getattr(world, name)[:, :number], getattr(people, name)[:, number:]
            fields[name] = np.concatenate([widen(mine, (*mine.shape[:2], *theirs.shape[2:])), theirs], axis=1)
    return world.replace(**fields, parameters=people.parameters)
