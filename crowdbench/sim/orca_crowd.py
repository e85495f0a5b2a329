"""ORCA for the pedestrians of worlds: what it is given of a world, and all of it in one kernel where worlds are few."""

from __future__ import annotations

from collections.abc import Mapping
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.compiled import njit
from crowdbench.geometry import fill_toward_goal
from crowdbench.sim.kernels import at
from crowdbench.sim.neighbors import CELLS_FROM, cells_of
from crowdbench.sim.orca import PARALLEL_AGENTS, orca_parallel, orca_serial
from crowdbench.sim.routes import goals_on_way
from crowdbench.types import World


def orca_pedestrians(
    world: World,
    margin: float,
    parameters: Mapping[str, Float[np.ndarray, "world agent"]],
    pace: Float[np.ndarray, "world agent"] | None = None,
) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocities in m/s that pedestrians take next; their preferred ones lead to their goals.

    Args:
        world: The worlds as they are now.
        margin: Safety margin in metres on every radius, besides the parameter `safety_space`.
        parameters: `neighbor_distance`, `max_neighbors`, `time_horizon`, `safety_space`, `time_horizon_obst` and
            `line_of_sight`, see `crowdbench.sim.orca.orca_velocities`.
        pace: Speeds in m/s of the velocities towards the goals; the preferred speeds if None. No velocity is faster
            than the preferred speed.
    """
    worlds, agents = world.radius.shape
    state = (
        world.position,
        goals_on_way(world),
        world.preferred_speed if pace is None else pace,
        world.radius,
        margin,
        parameters["safety_space"],
        world.present,
    )
    others = (
        world.rules.dt,
        parameters["neighbor_distance"],
        parameters["max_neighbors"],
        parameters["time_horizon"],
        world.obstacles,
        parameters["time_horizon_obst"],
        parameters["line_of_sight"],
    )
    is_small = worlds * agents < PARALLEL_AGENTS
    if is_small and agents < CELLS_FROM:
        out = np.empty((worlds, agents - 1, 2))
        _in_one(*state, world.velocity, world.preferred_speed, *others, out)
        return out
    preferred, everybody = np.empty(world.position.shape), np.empty(world.position.shape)
    size, moves = np.empty(world.radius.shape), np.empty(world.radius.shape, bool)
    _prepare(*state, preferred, size, moves)
    around = world.present, moves, cells_of(world.position, world.present)
    compute = orca_serial if is_small else orca_parallel
    compute(world.position, world.velocity, preferred, size, world.preferred_speed, *others, *around, everybody)
    return everybody[:, 1:]


@no_type_check
@njit
def _prepare(position, goal, pace, radius, margin, safety_space, present, preferred, size, moves):
    """What ORCA is given.

    Args:
        position: `[world, agent, 2]`, in metres.
        goal: `[world, agent, 2]`, in metres.
        pace: `[world, agent]`, speeds of the velocities towards the goals in m/s.
        radius: `[world, agent]`, in metres.
        margin: Safety margin on every radius in metres.
        safety_space: The same for each agent, read by `at`.
        present: `[world, agent]`.
        preferred: `[world, agent, 2]`, filled: preferred velocities in m/s.
        size: `[world, agent]`, filled: radii for avoidance in metres.
        moves: `[world, agent]`, filled: whether it is a pedestrian that is present.
    """
    fill_toward_goal(position, goal, pace, preferred)
    for w in range(len(radius)):
        for i in range(radius.shape[1]):
            size[w, i] = radius[w, i] + (margin + at(safety_space, w, i))
            moves[w, i] = i > 0 and present[w, i]


@no_type_check
@njit
def _in_one(
    position,
    goal,
    pace,
    radius,
    margin,
    safety_space,
    present,
    velocity,
    speed,
    time_step,
    neighbor_distance,
    max_neighbors,
    time_horizon,
    obstacles,
    time_horizon_obst,
    line_of_sight,
    out,
):
    """`_prepare` and `orca_serial`; `out [world, pedestrian, 2]` is filled with velocities in m/s."""
    preferred, everybody = np.empty(position.shape), np.empty(position.shape)
    size, moves = np.empty(radius.shape), np.empty(radius.shape, np.bool_)
    _prepare(position, goal, pace, radius, margin, safety_space, present, preferred, size, moves)
    reach = neighbor_distance, max_neighbors, time_horizon
    walls = obstacles, time_horizon_obst, line_of_sight
    orca_serial(position, velocity, preferred, size, speed, time_step, *reach, *walls, present, moves, None, everybody)
    for w in range(len(out)):
        for p in range(out.shape[1]):
            out[w, p, 0], out[w, p, 1] = everybody[w, p + 1, 0], everybody[w, p + 1, 1]
