"""One step of a batch of worlds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.compiled import njit
from crowdbench.dynamics import DISC, SPEED_TOLERANCE, hull
from crowdbench.dynamics.motion import drive
from crowdbench.errors import plugin_errors
from crowdbench.sim.checked import finite, shaped
from crowdbench.sim.episode import StepCheck, check_step
from crowdbench.sim.obstacles import slide
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.sim.routes import next_waypoints
from crowdbench.types import World


def crowd_velocities(world: World, policies: Mapping[str, PedestrianPolicy]) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocities that the pedestrians' policies ask for.

    The only place that hides an invisible vehicle from the policies: in the world that they are given, it is not
    `present`. There a visible one is the smallest disc around its body.

    Args:
        world: The worlds as they are now.
        policies: The scenario's policies by name.

    Returns:
        A velocity in m/s per pedestrian, by the pedestrian's own policy.

    Raises:
        InputError: A policy raises an exception, or does not return a finite velocity per pedestrian.
    """
    shown = with_hull(world) if world.rules.visible else _without_vehicle(world)
    asked = [_asked(shown, name, policy) for name, policy in policies.items()]
    return asked[0] if len(asked) == 1 else np.choose(world.policy[:, :, None], asked)


def _without_vehicle(world: World) -> World:
    present = world.present.copy()
    present[:, 0] = False
    return world.replace(present=present)


def with_hull(world: World) -> World:
    """Worlds in which the vehicle is the smallest disc around its body, as pedestrians see it."""
    if world.rules.body == DISC:
        return world
    position, radius = world.position.copy(), world.radius.copy()
    position[:, 0], radius[:, 0] = hull(world.rules.body, position[:, 0], world.heading, radius[:, 0])
    return world.replace(position=position, radius=radius)


def _asked(world: World, name: str, policy: PedestrianPolicy) -> Float[np.ndarray, "world pedestrian 2"]:
    with plugin_errors(f"pedestrian policy {name} raised"):
        answer = policy.velocities(world, world.parameters[name])
    return finite(shaped(answer, name, world), name, world)


def advance(world: World, command: Float[np.ndarray, "world agent 2"]) -> World:
    """Move all agents by one step: the vehicle by its dynamics, pedestrians as holonomic discs.

    The simulator limits speeds only here: an agent that is faster than its preferred speed is slowed down to it. In a
    run the `Driver` has rejected such commands of a planner before. So are the vehicle's other limits enforced.

    Pedestrians cannot pass walls: whose rim touches one goes on along it, and has the velocity that this took. The
    vehicle is not stopped, because its episode ends there.

    Args:
        world: The worlds before the step.
        command: The command of the vehicle, see `crowdbench.dynamics`, and the velocity of every pedestrian in m/s.

    Returns:
        The worlds after the step.
    """
    position, limited = np.empty(world.position.shape), np.empty(world.velocity.shape)
    heading, angular_speed = np.empty(len(world)), np.empty(len(world))
    history = np.empty(world.history.shape)
    dynamics = world.rules.dynamics
    _advance(
        dynamics.code,
        dynamics.limits,
        world.position,
        world.velocity,
        np.ascontiguousarray(command),
        world.heading,
        world.angular_speed,
        world.preferred_speed,
        world.present,
        world.history,
        world.radius,
        world.obstacles,
        world.rules.dt,
        position,
        limited,
        heading,
        angular_speed,
        history,
    )
    return world.replace(
        step=world.step + 1,
        position=position,
        velocity=limited,
        waypoint=next_waypoints(position, world.goal, world.route, world.waypoint, world.radius, world.obstacles),
        heading=heading,
        angular_speed=angular_speed,
        history=history,
    )


def taken_velocities(
    world: World, crowd: Float[np.ndarray, "world pedestrian 2"]
) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocities that pedestrians take in the next step.

    Args:
        world: The worlds before the step.
        crowd: The velocities in m/s that their policies ask for.

    Returns:
        In m/s.
    """
    return advance(world, np.pad(crowd, ((0, 0), (1, 0), (0, 0)))).velocity[:, 1:]


def step(
    world: World, command: Float[np.ndarray, "world 2"], crowd: Float[np.ndarray, "world pedestrian 2"]
) -> tuple[World, StepCheck]:
    """One step of the simulation, for rollouts and for environments: motion, then the check of how it ended.

    Args:
        world: The worlds before the step.
        command: The vehicle's command; `advance` limits it.
        crowd: The pedestrians' velocities in m/s; `advance` limits them.

    Returns:
        The worlds one step later, and what the check of the step found.
    """
    after = advance(world, np.concatenate([command[:, None], crowd], axis=1))
    return after, check_step(world, after)


@no_type_check
@njit
def _advance(
    code,
    limits,
    position,
    velocity,
    command,
    heading,
    turn_rate,
    max_speed,
    present,
    history,
    radius,
    obstacles,
    dt,
    new_position,
    limited,
    new_heading,
    angular_speed,
    new_history,
):
    """Move agents, limit their speeds, and update heading and history.

    Args:
        code: The code of the vehicle's dynamics.
        limits: Its limits.
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, velocities before the step in m/s.
        command: `[world, agent, 2]`, the vehicle's command, and the wanted velocities of pedestrians in m/s.
        heading: `[world]`, the vehicle's heading in radians.
        turn_rate: `[world]`, its angular speed before the step in rad/s.
        max_speed: `[world, agent]`, in m/s.
        present: `[world, agent]`; agents that are not present do not move.
        history: `[world, time, pedestrian, 2]`, in metres, oldest first.
        radius: `[world, agent]`, in metres.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        dt: Length of the step in seconds.
        new_position: Filled, like `position`.
        limited: Filled, like `velocity`: the velocities that were taken.
        new_heading: Filled, like `heading`.
        angular_speed: `[world]`, filled: the vehicle's angular speed in rad/s.
        new_history: Filled, like `history`.
    """
    worlds, agents = max_speed.shape
    length = history.shape[1]
    for w in range(worlds):
        for t in range(length - 1):
            for p in range(agents - 1):
                new_history[w, t, p, 0] = history[w, t + 1, p, 0]
                new_history[w, t, p, 1] = history[w, t + 1, p, 1]
        x, y, vx, vy = position[w, 0, 0], position[w, 0, 1], velocity[w, 0, 0], velocity[w, 0, 1]
        first, second = command[w, 0, 0], command[w, 0, 1]
        if not present[w, 0]:
            first, second = 0.0, 0.0
        x, y, vx, vy, new_heading[w], angular_speed[w] = drive(
            code, limits, x, y, vx, vy, heading[w], turn_rate[w], first, second, max_speed[w, 0], dt
        )
        new_position[w, 0, 0], new_position[w, 0, 1] = x, y
        limited[w, 0, 0], limited[w, 0, 1] = vx, vy
        for a in range(1, agents):
            x, y, vx, vy = position[w, a, 0], position[w, a, 1], command[w, a, 0], command[w, a, 1]
            if not present[w, a]:
                vx, vy = 0.0, 0.0
            speed = math.sqrt(vx * vx + vy * vy)
            if speed > max_speed[w, a] * (1.0 + SPEED_TOLERANCE):
                vx, vy = vx * (max_speed[w, a] / speed), vy * (max_speed[w, a] / speed)
            if obstacles.shape[1] > 0:
                x, y, vx, vy = _along_walls(x, y, vx, vy, radius[w, a], obstacles[w], dt)
            else:
                x, y = x + vx * dt, y + vy * dt
            new_position[w, a, 0], new_position[w, a, 1] = x, y
            limited[w, a, 0], limited[w, a, 1] = vx, vy
            new_history[w, length - 1, a - 1, 0], new_history[w, length - 1, a - 1, 1] = x, y


@no_type_check
@njit(inline="always")
def _along_walls(x, y, vx, vy, radius, obstacles, dt):
    """Move a pedestrian that cannot pass walls.

    Args:
        x, y: Its centre in metres.
        vx, vy: Its velocity in m/s.
        radius: In metres.
        obstacles: `[polygon, corner, 2]`, in metres.
        dt: Length of the step in seconds.

    Returns:
        Its centre after the step, x and y, and the velocity that it took, x and y.
    """
    touched, new_x, new_y = slide(x, y, vx * dt, vy * dt, radius, obstacles)
    if touched:
        return new_x, new_y, (new_x - x) / dt, (new_y - y) / dt
    return x + vx * dt, y + vy * dt, vx, vy
