"""ORCA for the pedestrians of worlds: what it is given of a world, and all of it in one kernel where worlds are few."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import fill_toward_goal
from crowdbench.core.types import World
from crowdbench.sim.kernels import at
from crowdbench.sim.neighbors import CELLS_FROM, cells_of
from crowdbench.sim.pedestrians.base import PedestrianPolicy
from crowdbench.sim.pedestrians.orca import PARALLEL_AGENTS, orca_parallel, orca_serial
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.compiled import njit

ORCA_MARGIN = 0.01
"""Safety margin in metres that CrowdNav adds to each radius for ORCA."""

TIME_HORIZON_OBST = 1.0
"""How far ahead ORCA avoids obstacles, in seconds. With 5 s, as in the examples of RVO2, agents keep so far away from
walls that they go past goals beside them: the planner `orca` takes 13.0 s in `room` then, and 9.1 s with 1 s."""


class ORCA(PedestrianPolicy):
    """Optimal reciprocal collision avoidance (van den Berg et al. 2011), with CrowdNav's parameters."""

    parameters: ClassVar[Mapping[str, float]] = {
        "neighbor_distance": 10.0,
        "max_neighbors": 10,
        "time_horizon": 5.0,
        "safety_space": 0.0,
        "time_horizon_obst": TIME_HORIZON_OBST,
        "line_of_sight": 0,
    }

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`. `safety_space`, in metres, is added to each radius for avoidance.

        With `line_of_sight` = 1 pedestrians avoid only those whom no obstacle hides; with 0 they avoid others through
        walls too, as in RVO2.
        """
        return orca_pedestrians(world, ORCA_MARGIN, parameters)


class ORCAPlus(PedestrianPolicy):
    """ORCA as the pedestrians of CrowdNav++ follow it (Liu et al. 2023): with a margin, towards the goal at 1 m/s."""

    parameters: ClassVar[Mapping[str, float]] = {
        **ORCA.parameters,
        "max_neighbors": 1000,
        "safety_space": 0.15,
    }

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`. The velocity towards the goal is 1 m/s fast, whatever the preferred speed is."""
        return orca_pedestrians(world, ORCA_MARGIN, parameters, pace=np.ones_like(world.preferred_speed))


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
            `line_of_sight`, see `crowdbench.sim.pedestrians.orca.orca_velocities`.
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
