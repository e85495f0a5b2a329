"""Shared parts of the force models of pedestrians: motion of all agents in sub-steps under forces. Compiled.

A pedestrian accelerates towards its desired velocity within a relaxation time, and by the force of a model. The speed
limit is the preferred speed, and over the last metre the desired speed decreases with the distance to the goal, as
everywhere in crowdbench.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.arrays import AgentFlags, AgentInts, AgentNumbers, AgentPoints, Walls
from crowdbench.core.types import World
from crowdbench.sim.kernels import in_blocks
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.compiled import njit

SUB_STEP = 0.05
"""Longest step of the integration in seconds, unless a model needs shorter ones."""

BLOCK_PAIRS = 500
"""Smallest number of pairs of agents for a thread: the transfer to it takes about 50 microseconds."""

TINY = 1e-9
"""Replacement of 0 in parameters by which a formula divides."""


class Walkers(NamedTuple):
    """The agents of worlds, and the obstacles around them, as kernels take them.

    Attributes:
        position: Centres in metres.
        velocity: Velocities before the step in m/s.
        goal: In metres.
        radius: In metres.
        preferred_speed: Preferred and largest speeds in m/s, above 0.
        seen: True if the agent acts on others.
        moves: True if the agent's velocity is computed; the others keep theirs in this step.
        obstacles: Polygons in metres, NaN after the last corner; two corners are a wall.
    """

    position: AgentPoints
    velocity: AgentPoints
    goal: AgentPoints
    radius: AgentNumbers
    preferred_speed: AgentNumbers
    seen: AgentFlags
    moves: AgentFlags
    obstacles: Walls


def walkers_of(world: World) -> Walkers:
    """Return the agents of worlds; present pedestrians move."""
    moves = world.present.copy()
    moves[:, 0] = False
    speed = np.maximum(world.preferred_speed, TINY)
    agents = world.position, world.velocity, goals_on_way(world), world.radius, speed, world.present, moves
    return Walkers(*agents, world.obstacles)


def fill_traits(
    defaults: Mapping[str, float], given: Mapping[str, float | np.ndarray], shape: tuple[int, ...]
) -> Float[np.ndarray, "world agent parameter"]:
    """Return the parameters of each agent in one array, in the order of the defaults.

    Args:
        defaults: The parameters of a model.
        given: A number, or an array `[world, agent]`, of those that are not the defaults.
        shape: Numbers of worlds and agents.
    """
    traits = np.empty((*shape, len(defaults)))
    for k, name in enumerate(defaults):
        traits[..., k] = given[name] if name in given else defaults[name]
    return traits


def compile_model(force: Any) -> Callable[..., None]:
    """Compile a model.

    Args:
        force: A kernel that returns x and y of an acceleration in m/s^2, and the share of it that acts. It takes the
            index of an agent; positions in metres and velocities in m/s of the agents of its world; its desired
            velocity, x and y, and the ratio of its length to the preferred speed; radii in metres; the seen agents; the
            traits of all; the obstacles; the index of the world, and the noise and the groups of all worlds.

    Returns:
        The kernel, which `integrate` calls.
    """

    @no_type_check
    def loop(begin, end, walkers, traits, noise, group, time_step, sub_steps, out):
        positions, velocities, goals, radii, speeds, seen, moves, obstacles = walkers
        agents, h = radii.shape[1], time_step / sub_steps
        for w in range(begin, end):
            x, v, new = positions[w].copy(), velocities[w].copy(), velocities[w].copy()
            goal, radius, counts, trait = goals[w], radii[w], seen[w], traits[w]
            # A copy: threads would wait for each other to count the references to slices of the same array.
            walls = obstacles[w].copy()
            for _ in range(sub_steps):
                for i in range(agents):
                    if not moves[w, i]:
                        continue
                    limit, tau = speeds[w, i], max(trait[i, 0], TINY)
                    # As `geometry.toward_goal`, and the ratio of its length to the preferred speed.
                    gx, gy = goal[i, 0] - x[i, 0], goal[i, 1] - x[i, 1]
                    distance = math.sqrt(gx * gx + gy * gy)
                    scale = limit / max(distance, limit)
                    desired = scale * gx, scale * gy, scale * distance / limit
                    fx, fy, share = force(i, x, v, desired, radius, counts, trait, walls, w, noise, group)
                    # The exact solution for constant forces. Explicit Euler steps of 0.05 s would act like a
                    # relaxation time 5 % shorter.
                    gain = 1.0 - math.exp(-h / tau)
                    vx = v[i, 0] + gain * (desired[0] + tau * share * fx - v[i, 0])
                    vy = v[i, 1] + gain * (desired[1] + tau * share * fy - v[i, 1])
                    slower = limit / max(math.sqrt(vx * vx + vy * vy), limit)
                    new[i, 0], new[i, 1] = slower * vx, slower * vy
                for i in range(agents):
                    v[i, 0], v[i, 1] = new[i, 0], new[i, 1]
                    x[i, 0], x[i, 1] = x[i, 0] + h * v[i, 0], x[i, 1] + h * v[i, 1]
            for i in range(agents):
                if moves[w, i]:
                    out[w, i, 0], out[w, i, 1] = v[i, 0], v[i, 1]

    function = getattr(force, "py_func", force)  # NUMBA_DISABLE_JIT leaves functions as they are
    loop.__module__, loop.__name__ = function.__module__, f"{function.__name__}_loop"
    loop.__qualname__ = loop.__name__
    return njit(loop, error_model="numpy", nogil=True)


def integrate(
    model: Callable[..., None],
    walkers: Walkers,
    traits: Float[np.ndarray, "world agent parameter"],
    time_step: float,
    noise: AgentPoints | None = None,
    group: AgentInts | None = None,
    longest: float | None = None,
) -> AgentPoints:
    """Return the velocity that each agent has at the end of the step.

    It is not the mean velocity of the step, because the next step starts from it: thus a single agent accelerates with
    exactly the relaxation time. Within the step all agents move simultaneously, in equal sub-steps.

    Args:
        model: The return value of `compile_model`.
        traits: The parameters of each agent, the relaxation time in seconds first.
        time_step: Length of the step in seconds.
        group: The index of each agent's group, negative without a group; None if there are no groups.
        longest: Longest sub-step in seconds; `SUB_STEP` if None.

    Returns:
        Velocities in m/s; 0 for agents that do not move.
    """
    worlds, agents = walkers.radius.shape
    out, sub_steps = np.zeros((worlds, agents, 2)), max(1, math.ceil(time_step / (longest or SUB_STEP) - 1e-9))
    arrays = walkers, traits, noise, group, time_step, sub_steps, out
    in_blocks(lambda begin, end: model(begin, end, *arrays), worlds, BLOCK_PAIRS // (agents * agents) + 1, worlds)
    return out
