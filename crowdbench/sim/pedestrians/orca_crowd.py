"""ORCA for the pedestrians of worlds: its inputs from a world, and a single kernel for few worlds."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import ClassVar, no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import fill_toward_goal, toward_goal
from crowdbench.core.types import World
from crowdbench.sim.kernels import at
from crowdbench.sim.pedestrians.orca import Agents, Avoidance, avoid, avoid_block
from crowdbench.sim.pedestrians.policy import Parameters, PedestrianPolicy, Velocities
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.compiled import njit

ORCA_MARGIN = 0.01
"""Safety margin in metres that CrowdNav adds to each radius for ORCA."""

TIME_HORIZON_OBST = 1.0
"""Time horizon of ORCA for obstacles in seconds. With 5 s, as in the examples of RVO2, agents keep so far away from
walls that they pass goals beside them: in a room with blocks, the planner `orca` takes 13.0 s with 5 s, and 9.1 s with
1 s."""


_avoidance_fields = operator.itemgetter(*Avoidance._fields)


def avoidance_of(parameters: Parameters) -> Avoidance:
    """Return the parameters of pedestrians that ORCA's kernels take."""
    return Avoidance(*_avoidance_fields(parameters))


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

        With `line_of_sight` = 1 pedestrians avoid only agents that no obstacle hides; with 0 they avoid others through
        walls too, as in RVO2.
        """
        return orca_pedestrians(world, parameters, world.preferred_speed)


def orca_pedestrians(world: World, parameters: Parameters, pace: Float[np.ndarray, "world agent"]) -> Velocities:
    """Return the velocities in m/s that pedestrians take next; their preferred ones lead to their goals.

    Args:
        world: The worlds as they are now.
        parameters: `safety_space`, and the parameters of `crowdbench.sim.pedestrians.orca.orca_velocities`.
        pace: Speeds in m/s of the velocities towards the goals. No velocity is faster than the preferred speed.
    """
    margin = parameters["safety_space"]
    avoidance = avoidance_of(parameters)
    goal, dt = goals_on_way(world), world.rules.dt
    preferred = toward_goal(world.position, goal, pace)
    size, moves = world.radius + (ORCA_MARGIN + margin), world.present
    crowd = Agents(world.position, world.velocity, preferred, size, world.preferred_speed, world.present, moves)
    return avoid(1, crowd, dt, world.obstacles, avoidance)


@no_type_check
@njit
def _prepare(goal, pace, safety_space, position, radius, preferred, size):
    """Fill the inputs of ORCA.

    Args:
        goal: `[world, agent, 2]`, in metres.
        pace: `[world, agent]`, speeds of the velocities towards the goals in m/s.
        safety_space: `[world, agent]`, in metres.
        position: `[world, agent, 2]`, in metres.
        radius: `[world, agent]`, in metres.
        preferred: `[world, agent, 2]`, filled: preferred velocities in m/s.
        size: `[world, agent]`, filled: radii for avoidance in metres.
    """
    for w in range(len(radius)):
        fill_toward_goal(position[w], goal[w], pace[w], preferred[w])
        for i in range(radius.shape[1]):
            size[w, i] = radius[w, i] + (ORCA_MARGIN + at(safety_space, w, i))


@no_type_check
@njit
def orca_in_one(goal, pace, safety_space, position, velocity, radius, speed, present, dt, reach, limit, horizon, out):
    """Compute the pedestrians' velocities by ORCA, in one small world without walls.

    Args:
        goal (ndarray): `[world, agent, 2]`, in metres.
        pace (ndarray): `[world, agent]`, speeds of the velocities towards the goals in m/s.
        safety_space (ndarray): `[world, agent]`, in metres.
        position (ndarray): `[world, agent, 2]`, in metres.
        velocity (ndarray): `[world, agent, 2]`, in m/s.
        radius (ndarray): `[world, agent]`, in metres.
        speed (ndarray): `[world, agent]`, preferred speeds in m/s.
        present (ndarray): `[world, agent]`, mask of the agents that move and are avoided.
        dt (float): Length of a step in seconds.
        reach (ndarray): `Avoidance.neighbor_distance`.
        limit (ndarray): `Avoidance.max_neighbors`.
        horizon (ndarray): `Avoidance.time_horizon`.
        out (ndarray): `[world, pedestrian, 2]`, filled: velocities in m/s.
    """
    preferred, size = np.empty(position.shape), np.empty(radius.shape)
    _prepare(goal, pace, safety_space, position, radius, preferred, size)
    crowd = position, velocity, preferred, size, speed, present, present, np.zeros((1, 1))
    limits = reach, limit, horizon
    nobody, zero, first = np.empty(0, np.int64), np.int64(0), np.int64(1)  # for literals it would be compiled twice
    avoid_block(zero, radius.size, first, crowd, dt, limits, (np.empty((0, 4)), nobody), (nobody, nobody), out)
