"""ORCA for the pedestrians of worlds: what it is given of a world, and all of it in one kernel where worlds are few."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import ClassVar, no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import fill_toward_goal
from crowdbench.core.types import World
from crowdbench.sim.kernels import at
from crowdbench.sim.neighbors import CELLS_FROM, cells_of
from crowdbench.sim.pedestrians.base import Parameters, PedestrianPolicy, Velocities
from crowdbench.sim.pedestrians.orca import PARALLEL_AGENTS, orca_parallel, orca_serial
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.compiled import njit

ORCA_MARGIN = 0.01
"""Safety margin in metres that CrowdNav adds to each radius for ORCA."""

TIME_HORIZON_OBST = 1.0
"""How far ahead ORCA avoids obstacles, in seconds. With 5 s, as in the examples of RVO2, agents keep so far away from
walls that they go past goals beside them: in a room with blocks the planner `orca` takes 13.0 s
then, and 9.1 s with 1 s."""


ORDER = operator.itemgetter("neighbor_distance", "max_neighbors", "time_horizon", "time_horizon_obst", "line_of_sight")
"""What ORCA's kernels take of the parameters, in their order."""


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

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`. `safety_space`, in metres, is added to each radius for avoidance.

        With `line_of_sight` = 1 pedestrians avoid only those whom no obstacle hides; with 0 they avoid others through
        walls too, as in RVO2.
        """
        return orca_pedestrians(world, parameters, world.preferred_speed)


class ORCAPlus(PedestrianPolicy):
    """ORCA as the pedestrians of CrowdNav++ follow it (Liu et al. 2023): with a margin, towards the goal at 1 m/s."""

    parameters: ClassVar[Mapping[str, float]] = {**ORCA.parameters, "max_neighbors": 1000, "safety_space": 0.15}

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`. The velocity towards the goal is 1 m/s fast, whatever the preferred speed is."""
        return orca_pedestrians(world, parameters, np.ones_like(world.preferred_speed))


def orca_pedestrians(world: World, parameters: Parameters, pace: Float[np.ndarray, "world agent"]) -> Velocities:
    """The velocities in m/s that pedestrians take next; their preferred ones lead to their goals.

    Args:
        world: The worlds as they are now.
        parameters: `safety_space`, and those of `crowdbench.sim.pedestrians.orca.orca_velocities`.
        pace: Speeds in m/s of the velocities towards the goals. No velocity is faster than the preferred speed.
    """
    radius, place, velocity = world.radius, world.position, world.velocity
    speed, present, dt, obstacles = world.preferred_speed, world.present, world.rules.dt, world.obstacles
    goal, margin, limits = goals_on_way(world), parameters["safety_space"], ORDER(parameters)
    worlds, agents = radius.shape
    is_small = worlds * agents < PARALLEL_AGENTS
    if is_small and agents < CELLS_FROM:
        out = np.empty((worlds, agents - 1, 2))
        orca_in_one(goal, pace, margin, out, place, velocity, radius, speed, present, dt, obstacles, *limits)
        return out
    preferred, everybody = np.empty(place.shape), np.empty(place.shape)
    size, moves = np.empty(radius.shape), np.empty(radius.shape, bool)
    _prepare(goal, pace, margin, place, radius, present, preferred, size, moves)
    cells, compute = cells_of(place, present), orca_serial if is_small else orca_parallel
    compute(cells, everybody, place, velocity, preferred, size, speed, present, moves, dt, obstacles, *limits)
    return everybody[:, 1:]


@no_type_check
@njit
def _prepare(goal, pace, safety_space, position, radius, present, preferred, size, moves):
    """What ORCA is given.

    Args:
        goal: `[world, agent, 2]`, in metres.
        pace: `[world, agent]`, speeds of the velocities towards the goals in m/s.
        safety_space: `[world, agent]`, in metres.
        position: `[world, agent, 2]`, in metres.
        radius: `[world, agent]`, in metres.
        present: `[world, agent]`.
        preferred: `[world, agent, 2]`, filled: preferred velocities in m/s.
        size: `[world, agent]`, filled: radii for avoidance in metres.
        moves: `[world, agent]`, filled: whether it is a pedestrian that is present.
    """
    fill_toward_goal(position, goal, pace, preferred)
    for w in range(len(radius)):
        for i in range(radius.shape[1]):
            size[w, i] = radius[w, i] + (ORCA_MARGIN + at(safety_space, w, i))
            moves[w, i] = i > 0 and present[w, i]


@no_type_check
@njit
def orca_in_one(goal, pace, safety_space, out, position, velocity, radius, speed, present, *avoidance):
    """What pedestrians do by ORCA, in few and small worlds.

    Args:
        goal (ndarray): `[world, agent, 2]`, in metres.
        pace (ndarray): `[world, agent]`, speeds of the velocities towards the goals in m/s.
        safety_space (ndarray): `[world, agent]`, in metres.
        out (ndarray): `[world, pedestrian, 2]`, filled: velocities in m/s.
        position (ndarray): `[world, agent, 2]`, in metres.
        velocity (ndarray): `[world, agent, 2]`, in m/s.
        radius (ndarray): `[world, agent]`, in metres.
        speed (ndarray): `[world, agent]`, preferred speeds in m/s.
        present (ndarray): `[world, agent]`, who moves or is avoided.
        avoidance (tuple): The last arguments of `orca_serial`, from `dt` on.
    """
    preferred, everybody = np.empty(position.shape), np.empty(position.shape)
    size, moves = np.empty(radius.shape), np.empty(radius.shape, np.bool_)
    _prepare(goal, pace, safety_space, position, radius, present, preferred, size, moves)
    orca_serial(None, everybody, position, velocity, preferred, size, speed, present, moves, *avoidance)
    for w in range(len(out)):
        for p in range(out.shape[1]):
            out[w, p, 0], out[w, p, 1] = everybody[w, p + 1, 0], everybody[w, p + 1, 1]
