"""Simulate commands under predicted futures, for one or several steps, with outcomes and gaps. Compiled."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Float32, Int

from crowdbench.core.dynamics import Holonomic
from crowdbench.core.dynamics.kernels import HOLONOMIC, drive_without_heading, signed_speed
from crowdbench.core.geometry import Discs, local_goals, nearest_in_step, norm
from crowdbench.core.types import Observation, Outcome, Vehicle
from crowdbench.networks.joint_state import SIZE, PedestrianStates, VehicleState, write_joint_states
from crowdbench.planners.inflation import RadiusInflation
from crowdbench.planners.scene import Scene, Sequences, fill_crowd, motion_of
from crowdbench.sim.episode import gaps_on_arc, step_outcome, stopping_gap
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.sim.routes import next_waypoints
from crowdbench.utils.compiled import njit


def propagate_vehicle(vehicle: Vehicle, command: Float[np.ndarray, "world 2"], obs: Observation) -> Vehicle:
    """Return the vehicle after a step, with its new position and its next waypoint.

    Args:
        vehicle: The vehicle before it.
        command: Its command.
        obs: The observation, of which the obstacles (for the visible waypoints) and the length of a step are used.
    """
    after = vehicle.dynamics.step(vehicle.state, command, vehicle.preferred_speed, obs.dt)
    _, _, waypoint = route_from(vehicle, after.position[:, None], obs.obstacles)
    return dataclasses.replace(vehicle, **after._asdict(), waypoint=waypoint[:, 0])


def route_from(
    vehicle: Vehicle, position: Float[np.ndarray, "world n 2"], obstacles: Float[np.ndarray, "world polygon corner 2"]
) -> tuple[Float[np.ndarray, "world n 2"], Float[np.ndarray, "world n waypoint 2"], Int[np.ndarray, "world n"]]:
    """Return goal, route and next waypoint of the vehicle of each world at several positions."""
    fields = vehicle.goal, vehicle.route, vehicle.waypoint, vehicle.radius
    goal, route, waypoint, radius = (np.repeat(values[:, None], position.shape[1], axis=1) for values in fields)
    return goal, route, next_waypoints(position, goal, route, waypoint, radius, obstacles)[0]


_NOT_LAST = np.bool_(False)
"""Argument of `step_outcome` for no time limit. With a literal, numba would compile `step_outcome` twice."""


class StepResult(NamedTuple):
    """Results of a step under some commands. A row is one command in one world.

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
    """Simulate a step with each of some commands, under the assumption that the prediction is right.

    The vehicle moves by its dynamics. The pedestrians move straight and at constant speed from their observed to their
    predicted positions. Collisions, with pedestrians and obstacles, and arrival at the goal follow the simulator's
    rules. A command after which the vehicle could not stop in front of a wall counts as a collision with it. The joint
    state has the local goal in place of the goal.

    Args:
        scene: The vehicles and the pedestrians.
        commands: Commands of the vehicle's dynamics.
        world: The world of each command.
    """
    rows, (modes, _, pedestrians) = len(commands), scene.crowd.position.shape[1:4]
    joint = np.empty((rows, modes, max(pedestrians, 1), SIZE), np.float32)
    result = StepResult(np.empty((rows, modes), np.int64), np.empty((rows, modes)), np.empty((rows, 2)), joint)
    world = np.ascontiguousarray(world)  # for another layout the kernel would be compiled once more
    wall_gap, on_wheels = np.full(rows, np.inf), scene.arrays.code != HOLONOMIC
    if on_wheels or scene.obstacles.shape[1]:
        _fill_gaps(scene.arrays, scene.crowd, scene.obstacles, scene.dt, commands, world, wall_gap, result.gap)
    _try_commands(scene.arrays, scene.crowd, scene.dt, commands, world, wall_gap, result)
    return result


@no_type_check
@njit(nogil=True)
def _try_commands(vehicle, crowd, dt, commands, world, wall_gap, result):
    """Fill the result, see `try_commands`; gaps of vehicles on wheels and to walls are already filled in."""
    code, limits, position = vehicle.code, vehicle.limits, crowd.position
    agents = 1 + position.shape[3]
    start, motion = np.empty((agents, 2)), np.empty((agents, 2))
    radii, present = np.empty(agents), np.ones(agents, np.bool_)
    discs = Discs(start, motion, radii, present)
    for row in range(len(commands)):
        w = world[row]
        before, radius, speed = motion_of(vehicle.motion, w), vehicle.radius[w], vehicle.preferred_speed[w]
        after = drive_without_heading(code, limits, before, (commands[row, 0], commands[row, 1]), speed, dt)
        x, y, vx, vy = after.x, after.y, after.vx, after.vy
        result.velocity[row, 0], result.velocity[row, 1] = vx, vy
        tolerance, dx, dy = vehicle.goal_tolerance[w], vehicle.goal[w, 0] - x, vehicle.goal[w, 1] - y
        ego = VehicleState(x, y, vx, vy, radius, vehicle.local_goal[w], speed)
        radii[0] = radius
        for p in range(agents - 1):  # loops compile in a fraction of the time of slices
            radii[1 + p], present[1 + p] = crowd.radius[w, p], crowd.present[w, p]
        start[0, 0], start[0, 1], motion[0, 0], motion[0, 1] = before.x, before.y, vx * dt, vy * dt
        for m in range(position.shape[1]):
            fill_crowd(position, w, m, 0, start, motion)
            if code == HOLONOMIC:
                result.gap[row, m], _ = nearest_in_step(0, discs)
            result.outcome[row, m] = step_outcome(result.gap[row, m], wall_gap[row], dx, dy, tolerance, _NOT_LAST)
            others = PedestrianStates(position[w, m, 1], crowd.velocity[w, m], crowd.radius[w], crowd.present[w])
            write_joint_states(result.joint[row, m], ego, others)


@no_type_check
@njit(nogil=True)
def _fill_gaps(vehicle, crowd, obstacles, dt, commands, world, wall_gap, gap):
    """Fill the gaps to walls `[command]`, and gaps of vehicles on wheels to pedestrians `[command, mode]`.

    A separate kernel, which is compiled only if there are walls or wheels. A command after which the vehicle could not
    stop in front of a wall has a negative gap to it.
    """
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
        stopping = stopping_gap(body, limits[0], x, y, vx, vy, facing, radius, obstacles[w])
        if code == HOLONOMIC:
            to_walls = wall_gap_in_step(before.x, before.y, vx * dt, vy * dt, radius, obstacles[w])
        else:
            to_walls, radii[0] = math.inf, radius
            for p in range(agents - 1):
                radii[1 + p], present[1 + p] = crowd.radius[w, p], crowd.present[w, p]
            start[0, 0], start[0, 1] = before.x, before.y
            arc = before.heading, signed_speed(vx, vy, facing), turn_rate, dt
            for m in range(position.shape[1]):
                fill_crowd(position, w, m, 0, start, motion)
                gap[row, m], to_walls = gaps_on_arc(body, *arc, discs, obstacles[w])
        wall_gap[row] = min(to_walls, stopping)


class SequenceResult(NamedTuple):
    """Results of sequences in each future.

    Attributes:
        outcome: The `Outcome` after the last step, never a time-out.
        steps: Number of steps until it ends, or all of them.
        gap: Smallest distance in metres to a pedestrian's rim in each step, minus margin and halo; infinite after the
            end.
        motion: The vehicle's `Motion` before the first step and after each one, also after the end; the heading of a
            holonomic vehicle is not updated.
    """

    outcome: Int[np.ndarray, "world sequence mode"]
    steps: Int[np.ndarray, "world sequence mode"]
    gap: Float[np.ndarray, "world sequence mode time"]
    motion: Float[np.ndarray, "world sequence state 6"]


def try_sequences(
    scene: Scene, commands: Sequences, margin: RadiusInflation | float = 0.0, halo: RadiusInflation | float = 0.0
) -> SequenceResult:
    """Simulate sequences of commands, with the simulator's rules for collisions and the goal.

    Args:
        scene: The vehicle and the pedestrians.
        commands: Commands of the vehicle's dynamics.
        margin: Enlargement of the radius of each pedestrian in each step, in metres; a number, or an array.
        halo: Further enlargement, in metres, that reduces gaps only: entering a halo is no collision.
    """
    worlds, sequences, steps = commands.shape[:3]
    shape = worlds, sequences, scene.crowd.position.shape[1]
    result = SequenceResult(
        np.empty(shape, np.int64),
        np.empty(shape, np.int64),
        np.full((*shape, steps), np.inf),
        np.empty((worlds, sequences, steps + 1, 6)),
    )
    each = worlds, steps, scene.crowd.radius.shape[1]
    radius = scene.crowd.radius[:, None] + np.broadcast_to(margin, each)
    outer = radius + halo
    has_halo = bool(np.any(outer != radius))
    radii = np.ascontiguousarray(radius), np.ascontiguousarray(outer), has_halo
    _try_sequences(scene.arrays, scene.crowd, scene.obstacles, scene.dt, commands, radii, result)
    return result


def limit_commands(commands: Sequences, vehicle: Vehicle) -> Sequences:
    """Return the commands, reduced to the limits of the dynamics."""
    if not isinstance(vehicle.dynamics, Holonomic):
        low, high = (bound[:, None, None] for bound in vehicle.dynamics.space(vehicle.preferred_speed))
        return np.clip(commands, low, high)
    limit = vehicle.preferred_speed[:, None, None]
    return commands * (limit / np.maximum(norm(commands), limit))[..., None]


def time_left(scene: Scene, result: SequenceResult) -> Float[np.ndarray, "world sequence"]:
    """Return the seconds from the end of each sequence to the goal, along the route at the preferred speed."""
    position = np.ascontiguousarray(result.motion[:, :, -1, :2])
    return norm(local_goals_at(scene, position) - position) / scene.vehicle.preferred_speed[:, None]


def local_goals_at(scene: Scene, position: Float[np.ndarray, "world n 2"]) -> Float[np.ndarray, "world n 2"]:
    """Return the local goal, in metres, that the vehicle of each world would have at several positions."""
    return local_goals(position, *route_from(scene.vehicle, position, scene.obstacles))


@no_type_check
@njit(nogil=True)
def _try_sequences(vehicle, crowd, obstacles, dt, commands, people, result):
    """See `try_sequences`. Fills the result.

    `people` has the radii `[world, time, pedestrian]` without and with halos, and whether they differ.
    """
    code, limits, body, position, radius = vehicle.code, vehicle.limits, vehicle.body, crowd.position, vehicle.radius
    agents, horizon, running = 1 + position.shape[3], commands.shape[2], Outcome.RUNNING.value
    start, motion = np.empty((agents, 2)), np.empty((agents, 2))
    radii, present = np.empty(agents), np.ones(agents, np.bool_)
    discs, (people_radius, halo_radius, has_halo) = Discs(start, motion, radii, present), people
    # Start and displacement of each disc of the body in each step.
    chord, to_walls = np.empty((horizon, len(body), 4)), np.full(horizon, np.inf)
    for w in range(len(commands)):
        radii[0], present[1:] = radius[w], crowd.present[w]
        for s in range(commands.shape[1]):
            path = result.motion[w, s]
            path[0] = vehicle.motion[w]
            for t in range(horizon):
                before, command = motion_of(path, t), (commands[w, s, t, 0], commands[w, s, t, 1])
                after = drive_without_heading(code, limits, before, command, vehicle.preferred_speed[w], dt)
                path[t + 1, 0], path[t + 1, 1], path[t + 1, 2], path[t + 1, 3], path[t + 1, 4], path[t + 1, 5] = after
                _fill_chords(code, body, before, after, dt, chord[t])
                if obstacles.shape[1] > 0:
                    reach = radius[w] + _chord_error(code, body, after, dt)
                    to_walls[t] = np.inf
                    for x, y, dx, dy in chord[t]:
                        to_walls[t] = min(to_walls[t], wall_gap_in_step(x, y, dx, dy, reach, obstacles[w]))
            for m in range(position.shape[1]):
                ended = running
                t = 0
                while t < horizon and ended == running:
                    fill_crowd(position, w, m, t, start, motion)
                    gap = _gap_in_step(chord[t], people_radius[w, t], discs)
                    result.gap[w, s, m, t] = _gap_in_step(chord[t], halo_radius[w, t], discs) if has_halo else gap
                    dx, dy = vehicle.goal[w, 0] - path[t + 1, 0], vehicle.goal[w, 1] - path[t + 1, 1]
                    # A contact is a prediction, a wall is certain: if a step has both, the wall counts.
                    contact = gap if to_walls[t] >= 0.0 else np.inf
                    ended = step_outcome(contact, to_walls[t], dx, dy, vehicle.goal_tolerance[w], _NOT_LAST)
                    t += 1
                result.outcome[w, s, m], result.steps[w, s, m] = ended, t


@no_type_check
@njit(nogil=True)
def _gap_in_step(chords, people_radius, discs):
    """Return the smallest gap in a step between the discs of a body and pedestrians of the given radii."""
    gap = np.inf
    for p in range(len(people_radius)):
        discs.radius[1 + p] = people_radius[p]
    for x, y, dx, dy in chords:
        discs.position[0, 0], discs.position[0, 1], discs.motion[0, 0], discs.motion[0, 1] = x, y, dx, dy
        gap = min(gap, nearest_in_step(0, discs)[0])
    return gap


@no_type_check
@njit(nogil=True, inline="always")
def _fill_chords(code, body, before, after, dt, chord):
    """Fill in the start and the displacement of each disc of a body in a step: x, y, dx and dy in metres.

    An arc is approximated by its chord. In 0.25 s at 1 m/s and 1.5 rad/s, the error is at most 1 cm. Walls, whose
    positions are certain, must be farther away than this error.
    """
    if code == HOLONOMIC:
        chord[0, 0], chord[0, 1], chord[0, 2], chord[0, 3] = before.x, before.y, after.vx * dt, after.vy * dt
        return
    cos, sin = math.cos(before.heading), math.sin(before.heading)
    cos_after, sin_after = math.cos(after.heading), math.sin(after.heading)
    for k in range(len(body)):
        chord[k, 0], chord[k, 1] = before.x + body[k] * cos, before.y + body[k] * sin
        chord[k, 2] = after.x + body[k] * cos_after - chord[k, 0]
        chord[k, 3] = after.y + body[k] * sin_after - chord[k, 1]


@no_type_check
@njit(nogil=True, inline="always")
def _chord_error(code, body, after, dt):
    """Return the largest distance in metres between a chord and its arc: see `core.dynamics.kernels.chords`."""
    if code == HOLONOMIC:
        return 0.0
    speed, along = math.hypot(after.vx, after.vy), max(abs(body[0]), abs(body[-1])) * after.turn_rate
    return 0.125 * dt * dt * abs(after.turn_rate) * math.hypot(speed, along)
