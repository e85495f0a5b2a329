"""One step of a batch of worlds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.compiled import njit
from crowdbench.dynamics import SPEED_TOLERANCE
from crowdbench.errors import plugin_errors
from crowdbench.geometry import heading_of, turn
from crowdbench.sim.checked import finite, shaped
from crowdbench.sim.episode import StepCheck, check_step
from crowdbench.sim.obstacles import slide
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.sim.routes import next_waypoints
from crowdbench.types import World


def crowd_velocities(world: World, policies: Mapping[str, PedestrianPolicy]) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocities that the pedestrians' policies ask for.

    The only place that hides an invisible vehicle from the policies: in the world that they are given, it is not
    `present`.

    Args:
        world: The worlds as they are now.
        policies: The scenario's policies by name.

    Returns:
        A velocity in m/s per pedestrian, by the pedestrian's own policy.

    Raises:
        InputError: A policy raises an exception, or does not return a finite velocity per pedestrian.
    """
    shown = world if world.rules.visible else _without_vehicle(world)
    asked = [_asked(shown, name, policy) for name, policy in policies.items()]
    return asked[0] if len(asked) == 1 else np.choose(world.policy[:, :, None], asked)


def _without_vehicle(world: World) -> World:
    present = world.present.copy()
    present[:, 0] = False
    return world.replace(present=present)


def _asked(world: World, name: str, policy: PedestrianPolicy) -> Float[np.ndarray, "world pedestrian 2"]:
    with plugin_errors(f"pedestrian policy {name} raised"):
        answer = policy.velocities(world, world.parameters[name])
    return finite(shaped(answer, name, world), name, world)


def advance(world: World, velocity: Float[np.ndarray, "world agent 2"]) -> World:
    """Move all agents by one step, as holonomic discs.

    The simulator limits speeds only here: an agent that is faster than its preferred speed is slowed down to it. In a
    run the `Driver` has rejected such commands of a planner before.

    Pedestrians cannot pass walls: whose rim touches one goes on along it, and has the velocity that this took. The
    vehicle is not stopped, because its episode ends there.

    Args:
        world: The worlds before the step.
        velocity: The velocity of every agent during the step, in m/s.

    Returns:
        The worlds after the step.
    """
    position, limited = np.empty(world.position.shape), np.empty(world.velocity.shape)
    heading, angular_speed = np.empty(len(world)), np.empty(len(world))
    history = np.empty(world.history.shape)
    _advance(
        world.position,
        np.ascontiguousarray(velocity),
        world.heading,
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
    """The velocities in m/s that pedestrians take in the next step, where their policies ask for `crowd`."""
    return advance(world, np.pad(crowd, ((0, 0), (1, 0), (0, 0)))).velocity[:, 1:]


def step(
    world: World, command: Float[np.ndarray, "world 2"], crowd: Float[np.ndarray, "world pedestrian 2"]
) -> tuple[World, StepCheck]:
    """One step of the simulation, for rollouts and for environments: motion, then the check of how it ended.

    Args:
        world: The worlds before the step.
        command: The vehicle's velocity in m/s; `advance` limits it.
        crowd: The pedestrians' velocities in m/s; `advance` limits them.

    Returns:
        The worlds one step later, and what the check of the step found.
    """
    after = advance(world, np.concatenate([command[:, None], crowd], axis=1))
    return after, check_step(world, after)


@no_type_check
@njit
def _advance(
    position,
    velocity,
    heading,
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
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, wanted velocities in m/s.
        heading: `[world]`, the vehicle's heading in radians.
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
        for a in range(agents):
            x, y = velocity[w, a, 0], velocity[w, a, 1]
            if not present[w, a]:
                x, y = 0.0, 0.0
            speed = math.sqrt(x * x + y * y)
            if speed > max_speed[w, a] * (1.0 + SPEED_TOLERANCE):
                x, y = x * (max_speed[w, a] / speed), y * (max_speed[w, a] / speed)
            limited[w, a, 0], limited[w, a, 1] = x, y
            new_position[w, a, 0] = position[w, a, 0] + x * dt
            new_position[w, a, 1] = position[w, a, 1] + y * dt
            if a > 0 and obstacles.shape[1] > 0:
                px, py = position[w, a, 0], position[w, a, 1]
                touched, qx, qy = slide(px, py, x * dt, y * dt, radius[w, a], obstacles[w])
                if touched:
                    new_position[w, a, 0], new_position[w, a, 1] = qx, qy
                    limited[w, a, 0], limited[w, a, 1] = (qx - px) / dt, (qy - py) / dt
            if a > 0:
                new_history[w, length - 1, a - 1, 0] = new_position[w, a, 0]
                new_history[w, length - 1, a - 1, 1] = new_position[w, a, 1]
            else:
                new_heading[w] = heading_of(x, y, heading[w])
                angular_speed[w] = turn(heading[w], new_heading[w]) / dt
