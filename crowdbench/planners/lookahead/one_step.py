"""One step into a predicted future: how each command would end it, and the state that it would lead to."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Float32, Int

from crowdbench.core.dynamics.motion import HOLONOMIC, drive_without_heading
from crowdbench.core.geometry import Discs, nearest_in_step
from crowdbench.core.types import Observation, Vehicle
from crowdbench.networks.joint_state import SIZE, PedestrianStates, VehicleState, write_joint_states
from crowdbench.planners.scene import Scene, fill_crowd, motion_of
from crowdbench.sim.episode import step_outcome
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.sim.routes import next_waypoints
from crowdbench.sim.swept import gaps_on_arc, stopping_gap
from crowdbench.utils.compiled import njit


def propagate_vehicle(vehicle: Vehicle, command: Float[np.ndarray, "world 2"], obs: Observation) -> Vehicle:
    """The vehicle after a step: at its new position, heading for the waypoint that is next there.

    Args:
        vehicle: The vehicle before it.
        command: Its command.
        obs: What the planner sees: the obstacles, which decide what waypoints are in sight, and the length of a step.
    """
    after = vehicle.dynamics.step(vehicle.state, command, vehicle.preferred_speed, obs.dt)
    waypoint = next_waypoints(
        after.position[:, None],
        vehicle.goal[:, None],
        vehicle.route[:, None],
        vehicle.waypoint[:, None],
        vehicle.radius[:, None],
        obs.obstacles,
    )[:, 0]
    return dataclasses.replace(vehicle, **after._asdict(), waypoint=waypoint)


class StepResult(NamedTuple):
    """How a step would go under some commands. A row is one command in one world.

    Attributes:
        outcome: An `Outcome`, never a time-out.
        gap: Smallest distance in metres to a pedestrian's rim during the step.
        velocity: The vehicle's velocity after the step, in m/s.
        joint: The joint states after the step, see `crowdbench.networks.joint_state`.
    """

    outcome: Int[np.ndarray, "row mode"]
    gap: Float[np.ndarray, "row mode"]
    velocity: Float[np.ndarray, "row 2"]
    joint: Float32[np.ndarray, "row mode pedestrian 13"]


def try_commands(scene: Scene, commands: Float[np.ndarray, "row 2"], world: Int[np.ndarray, "row"]) -> StepResult:
    """Find out how a step would go under some commands, if the prediction is right.

    The vehicle moves by its dynamics. The pedestrians move straight and at constant speed from where the planner sees
    them to where they are predicted. The rule for collisions, with pedestrians and obstacles, and for the goal is the
    simulator's. A command after which the vehicle could not stop in front of a wall counts as a collision with it. The
    joint state has the local goal in place of the goal.

    Args:
        scene: The vehicles and the pedestrians.
        commands: Commands of the vehicle's dynamics.
        world: The world of each command.
    """
    rows, (modes, _, pedestrians) = len(commands), scene.crowd.position.shape[1:4]
    result = StepResult(
        np.empty((rows, modes), np.int64),
        np.empty((rows, modes)),
        np.empty((rows, 2)),
        np.empty((rows, modes, max(pedestrians, 1), SIZE), np.float32),
    )
    _try_commands(scene.arrays, scene.crowd, scene.obstacles, scene.dt, commands, world, result)
    return result


@no_type_check
@njit(nogil=True)
def _try_commands(vehicle, crowd, obstacles, dt, commands, world, result):
    """See `try_commands`; fills the result."""
    code, limits, body, position = vehicle.code, vehicle.limits, vehicle.body, crowd.position
    agents = 1 + position.shape[3]
    start, motion = np.empty((agents, 2)), np.empty((agents, 2))
    radii, present = np.empty(agents), np.ones(agents, np.bool_)
    discs = Discs(start, motion, radii, present)
    for row in range(len(commands)):
        w = world[row]
        before, radius, speed = motion_of(vehicle.motion, w), vehicle.radius[w], vehicle.preferred_speed[w]
        after = drive_without_heading(code, limits, before, (commands[row, 0], commands[row, 1]), speed, dt)
        x, y, vx, vy, facing, turn_rate = after
        result.velocity[row, 0], result.velocity[row, 1] = vx, vy
        wall_gap = stopping = math.inf
        if obstacles.shape[1] > 0:
            wall_gap = wall_gap_in_step(before.x, before.y, vx * dt, vy * dt, radius, obstacles[w])
            stopping = stopping_gap(body, limits[0], x, y, vx, vy, facing, radius, obstacles[w])
        tolerance, dx, dy = vehicle.goal_tolerance[w], vehicle.goal[w, 0] - x, vehicle.goal[w, 1] - y
        own = VehicleState(x, y, vx, vy, radius, vehicle.local_goal[w], speed)
        radii[0], radii[1:], present[1:] = radius, crowd.radius[w], crowd.present[w]
        start[0, 0], start[0, 1], motion[0, 0], motion[0, 1] = before.x, before.y, vx * dt, vy * dt
        for m in range(position.shape[1]):
            fill_crowd(position, w, m, 0, start, motion)
            if code == HOLONOMIC:
                gap, _ = nearest_in_step(0, discs)
            else:
                arc = before.heading, math.hypot(vx, vy), turn_rate, dt
                gap, wall_gap = gaps_on_arc(body, *arc, discs, obstacles[w])
            result.gap[row, m] = gap
            result.outcome[row, m] = step_outcome(gap, min(wall_gap, stopping), dx, dy, tolerance, False)
            others = PedestrianStates(position[w, m, 1], crowd.velocity[w, m], crowd.radius[w], crowd.present[w])
            write_joint_states(result.joint[row, m], own, others)
