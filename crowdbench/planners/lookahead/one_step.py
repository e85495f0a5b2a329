"""One step into a predicted future: how each command would end it, and the state that it would lead to."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench.compiled import njit
from crowdbench.dynamics import DISC, FREE, Body, Dynamics, State
from crowdbench.dynamics.motion import HOLONOMIC, drive, move_freely
from crowdbench.geometry import nearest_in_step
from crowdbench.predict import Prediction
from crowdbench.sim.episode import step_outcome
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.sim.routes import next_waypoints
from crowdbench.sim.swept import gaps_on_arc, stopping_gap
from crowdbench.types import Observation, Vehicle
from crowdbench.value.joint_state import SIZE, write_joint_state


@dataclass(frozen=True)
class Scene:
    """The vehicle and the pedestrians before a step, and the pedestrians after it in each mode of a prediction.

    Attributes:
        position: The vehicle's centre in metres.
        velocity: Its velocity in m/s.
        heading: Direction in which it faces, in radians.
        angular_speed: Its turn rate in the last step, in rad/s.
        goal: Where it is going, in metres.
        local_goal: Where it heads for on its route, in metres, see `crowdbench.geometry.local_goals`.
        radius: Its radius in metres.
        preferred_speed: Its preferred and largest speed in m/s.
        crowd: The pedestrians' centres before the step, in metres.
        next_crowd: Their predicted centres after the step, in metres.
        next_velocity: Their predicted velocities after the step, in m/s.
        crowd_radius: Their radii in metres.
        present: Which pedestrians there are. The others change nothing.
        obstacles: Polygons in metres, NaN after the last corner.
        dt: Length of the step in seconds.
        dynamics: How the vehicle moves.
        goal_tolerance: Distance in metres to its goal below which it has arrived; None stands for its radius.
        body: The discs that it consists of.
    """

    position: Float[np.ndarray, "world 2"]
    velocity: Float[np.ndarray, "world 2"]
    heading: Float[np.ndarray, "world"]
    angular_speed: Float[np.ndarray, "world"]
    goal: Float[np.ndarray, "world 2"]
    local_goal: Float[np.ndarray, "world 2"]
    radius: Float[np.ndarray, "world"]
    preferred_speed: Float[np.ndarray, "world"]
    crowd: Float[np.ndarray, "world mode pedestrian 2"]
    next_crowd: Float[np.ndarray, "world mode pedestrian 2"]
    next_velocity: Float[np.ndarray, "world mode pedestrian 2"]
    crowd_radius: Float[np.ndarray, "world pedestrian"]
    present: Bool[np.ndarray, "world pedestrian"]
    obstacles: Float[np.ndarray, "world polygon corner 2"]
    dt: float
    dynamics: Dynamics = FREE
    goal_tolerance: float | None = None
    body: Body = DISC

    @property
    def state(self) -> State:
        """The vehicle's motion, as its dynamics takes it."""
        return State(self.position, self.velocity, self.heading, self.angular_speed)

    def velocities(self, commands: Float[np.ndarray, "world action 2"]) -> Float[np.ndarray, "world action 2"]:
        """The velocities in m/s that the vehicle has after a step under each of some commands."""
        return self.dynamics.velocities(self.state, commands, self.preferred_speed, self.dt)


def scene_of(obs: Observation, prediction: Prediction, step: int, vehicle: Vehicle) -> Scene:
    """The scene of one step of a prediction.

    Args:
        obs: What the planner sees now.
        prediction: The pedestrians' next steps.
        step: Which of them, 0 for the next one.
        vehicle: The vehicle as it is before that step.

    Returns:
        The scene.
    """
    after = prediction.position[:, :, step]
    before = prediction.position[:, :, step - 1] if step else obs.pedestrians.position[:, None]
    return Scene(
        position=vehicle.position,
        velocity=vehicle.velocity,
        heading=vehicle.heading,
        angular_speed=vehicle.angular_speed,
        goal=vehicle.goal,
        local_goal=vehicle.local_goal,
        radius=vehicle.radius,
        preferred_speed=vehicle.preferred_speed,
        # Always in the same memory layout, since numba compiles a function again for each layout.
        crowd=np.broadcast_to(before, after.shape).copy(),
        next_crowd=np.ascontiguousarray(after),
        next_velocity=np.ascontiguousarray(prediction.velocity[:, :, step]),
        crowd_radius=obs.pedestrians.radius,
        present=obs.pedestrians.seen,
        obstacles=obs.obstacles,
        dt=obs.dt,
        dynamics=vehicle.dynamics,
        goal_tolerance=vehicle.goal_tolerance,
        body=vehicle.body,
    )


def moved(vehicle: Vehicle, command: Float[np.ndarray, "world 2"], obs: Observation) -> Vehicle:
    """The vehicle after a step.

    Args:
        vehicle: The vehicle before it.
        command: Its command.
        obs: What the planner sees: the obstacles, which decide what waypoints are in sight, and the length of a step.

    Returns:
        The vehicle at its new position, heading for the waypoint that is next there.
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


@dataclass(frozen=True)
class StepResult:
    """How a step would go under some commands. A row is one command in one world.

    Attributes:
        outcome: An `Outcome`, never a time-out.
        gap: Smallest distance in metres to a pedestrian's rim during the step.
        velocity: The vehicle's velocity after the step, in m/s.
        joint: The joint states after the step, see `crowdbench.value.joint_state`.
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

    Returns:
        The result of each command in each mode.
    """
    rows, (modes, pedestrians) = len(commands), scene.crowd.shape[1:3]
    result = StepResult(
        np.empty((rows, modes), np.int64),
        np.empty((rows, modes)),
        np.empty((rows, 2)),
        np.empty((rows, modes, max(pedestrians, 1), SIZE), np.float32),
    )
    _try_commands(
        scene.dynamics.code,
        scene.dynamics.limits,
        np.array(scene.body),
        scene.goal_tolerance or 0.0,
        scene.heading,
        scene.angular_speed,
        scene.velocity,
        scene.position,
        scene.goal,
        scene.local_goal,
        scene.radius,
        scene.preferred_speed,
        scene.crowd,
        scene.next_crowd,
        scene.next_velocity,
        scene.crowd_radius,
        scene.present,
        scene.obstacles,
        scene.dt,
        commands,
        world,
        result.outcome,
        result.gap,
        result.velocity,
        result.joint,
    )
    return result


@no_type_check
@njit(nogil=True)
def _try_commands(
    code,
    limits,
    body,
    tolerance,
    heading,
    angular_speed,
    velocity,
    position,
    goal,
    local_goal,
    radius,
    preferred_speed,
    crowd,
    next_crowd,
    next_velocity,
    crowd_radius,
    present,
    obstacles,
    dt,
    commands,
    world,
    outcome,
    gap,
    new_velocity,
    joint,
):
    """See `try_commands`; fills the last four."""
    pedestrians = crowd.shape[2]
    start, motion = np.empty((pedestrians + 1, 2)), np.empty((pedestrians + 1, 2))
    radii = np.empty(pedestrians + 1)
    seen = np.ones(pedestrians + 1, np.bool_)
    for row in range(len(commands)):
        w = world[row]
        x, y, vx, vy = position[w, 0], position[w, 1], velocity[w, 0], velocity[w, 1]
        first, second, limit, turn_rate = commands[row, 0], commands[row, 1], preferred_speed[w], 0.0
        facing = heading[w]
        if code == HOLONOMIC:
            x, y, vx, vy = move_freely(limits[0] * dt, x, y, vx, vy, first, second, limit, dt)
        else:
            x, y, vx, vy, facing, turn_rate = drive(
                code, limits, x, y, vx, vy, heading[w], angular_speed[w], first, second, limit, dt
            )
        new_velocity[row, 0], new_velocity[row, 1] = vx, vy
        wall_gap = stopping = math.inf
        if obstacles.shape[1] > 0:
            wall_gap = wall_gap_in_step(position[w, 0], position[w, 1], vx * dt, vy * dt, radius[w], obstacles[w])
            stopping = stopping_gap(body, limits[0], x, y, vx, vy, facing, radius[w], obstacles[w])
        near = tolerance if tolerance > 0.0 else radius[w]
        dx, dy = goal[w, 0] - x, goal[w, 1] - y
        radii[0], radii[1:], seen[1:] = radius[w], crowd_radius[w], present[w]
        start[0], motion[0, 0], motion[0, 1] = position[w], vx * dt, vy * dt
        for m in range(crowd.shape[1]):
            _fill_crowd(crowd[w, m], next_crowd[w, m], start, motion)
            if code == HOLONOMIC:
                gap[row, m], _ = nearest_in_step(0, start, motion, radii, seen)
            else:
                arc = heading[w], math.hypot(vx, vy), turn_rate, dt
                gap[row, m], wall_gap = gaps_on_arc(body, *arc, start, motion, radii, seen, obstacles[w])
            outcome[row, m] = step_outcome(gap[row, m], min(wall_gap, stopping), dx, dy, near, False)
            own = x, y, vx, vy, radius[w], local_goal[w], preferred_speed[w]
            others = next_crowd[w, m], next_velocity[w, m], crowd_radius[w], present[w]
            write_joint_state(joint[row, m], *own, *others)


@no_type_check
@njit(nogil=True, inline="always")
def _fill_crowd(before, after, start, motion):
    """Fill all rows but the first with where pedestrians start and how far they move, in metres."""
    for p in range(len(before)):
        for k in range(2):
            start[p + 1, k] = before[p, k]
            motion[p + 1, k] = after[p, k] - before[p, k]
