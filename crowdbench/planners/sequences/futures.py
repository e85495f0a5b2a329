"""Sequences of commands under predicted futures: how each would end, and how close it would come to the pedestrians."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.compiled import njit
from crowdbench.dynamics import DISC, FREE, Body, Dynamics, State
from crowdbench.dynamics.motion import HOLONOMIC, drive, move_freely
from crowdbench.geometry import nearest_in_step
from crowdbench.sim.episode import step_outcome
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.sim.swept import gaps_on_arc
from crowdbench.types import Outcome


@dataclass(frozen=True)
class Futures:
    """The vehicle now, and the pedestrians now and in each predicted future.

    Attributes:
        state: The vehicle's motion.
        goal: Where it is going, in metres.
        radius: Its radius in metres.
        preferred_speed: Its preferred and largest speed in m/s.
        crowd: The pedestrians' centres in metres. Time 0 is now, and time t is after t steps.
        crowd_velocity: Their mean velocity over the futures after the last step, in m/s.
        crowd_radius: Their radii in metres.
        present: Which pedestrians there are. The others change nothing.
        route: The vehicle's waypoints in metres, NaN after the last one.
        waypoint: Index of its next waypoint.
        obstacles: Polygons in metres, NaN after the last corner.
        dt: Length of a step in seconds.
        dynamics: How the vehicle moves.
        goal_tolerance: Distance in metres to its goal below which it has arrived; None stands for its radius.
        body: The discs that it consists of.
    """

    state: State
    goal: Float[np.ndarray, "world 2"]
    radius: Float[np.ndarray, "world"]
    preferred_speed: Float[np.ndarray, "world"]
    crowd: Float[np.ndarray, "world mode time pedestrian 2"]
    crowd_velocity: Float[np.ndarray, "world pedestrian 2"]
    crowd_radius: Float[np.ndarray, "world pedestrian"]
    present: Bool[np.ndarray, "world pedestrian"]
    route: Float[np.ndarray, "world waypoint 2"]
    waypoint: Int[np.ndarray, "world"]
    obstacles: Float[np.ndarray, "world polygon corner 2"]
    dt: float
    dynamics: Dynamics = FREE
    goal_tolerance: float | None = None
    body: Body = DISC


@dataclass(frozen=True)
class SequenceResult:
    """How sequences would go in each future.

    Attributes:
        outcome: How it has ended after the last step, an `Outcome`; never a time-out.
        steps: Number of steps until it ends, or all of them.
        gap: Smallest distance in metres to a pedestrian's rim during each step, less the margin of the step; infinite
            after the end.
    """

    outcome: Int[np.ndarray, "world sequence mode"]
    steps: Int[np.ndarray, "world sequence mode"]
    gap: Float[np.ndarray, "world sequence mode time"]


def try_sequences(
    futures: Futures, commands: Float[np.ndarray, "world sequence time 2"], margin: Float[np.ndarray, "time"]
) -> SequenceResult:
    """Find out how sequences of commands would go, by the simulator's rule for collisions and the goal.

    Args:
        futures: The vehicle and the pedestrians.
        commands: Commands of the vehicle's dynamics.
        margin: By how much gaps are made smaller in each step, in metres.

    Returns:
        The result of each sequence in each future.
    """
    worlds, sequences, steps = commands.shape[:3]
    shape = worlds, sequences, futures.crowd.shape[1]
    result = SequenceResult(np.empty(shape, np.int64), np.empty(shape, np.int64), np.full((*shape, steps), np.inf))
    _try_sequences(
        futures.dynamics.code,
        futures.dynamics.limits,
        np.array(futures.body),
        futures.goal_tolerance or 0.0,
        *futures.state,
        futures.goal,
        futures.radius,
        futures.preferred_speed,
        futures.crowd,
        futures.crowd_radius,
        futures.present,
        futures.obstacles,
        futures.dt,
        commands,
        margin,
        result.outcome,
        result.steps,
        result.gap,
    )
    return result


@no_type_check
@njit(nogil=True)
def _try_sequences(
    code,
    limits,
    body,
    tolerance,
    position,
    velocity,
    heading,
    angular_speed,
    goal,
    radius,
    max_speed,
    crowd,
    crowd_radius,
    present,
    obstacles,
    dt,
    commands,
    margin,
    outcome,
    steps,
    gap,
):
    pedestrians, horizon = crowd.shape[3], commands.shape[2]
    start = np.empty((pedestrians + 1, 2))
    motion = np.empty((pedestrians + 1, 2))
    radii = np.empty(pedestrians + 1)
    seen = np.ones(pedestrians + 1, np.bool_)
    # x, y, vx, vy, and on wheels heading and angular speed, before the first step and after each one.
    way, to_walls = np.empty((horizon + 1, 6)), np.full(horizon, np.inf)
    running = Outcome.RUNNING.value
    for w in range(len(commands)):
        radii[0], radii[1:], seen[1:] = radius[w], crowd_radius[w], present[w]
        near = tolerance if tolerance > 0.0 else radius[w]
        way[0, :2], way[0, 2:4], way[0, 4], way[0, 5] = position[w], velocity[w], heading[w], angular_speed[w]
        for s in range(commands.shape[1]):
            for t in range(horizon):
                x, y, vx, vy = way[t, 0], way[t, 1], way[t, 2], way[t, 3]
                first, second, limit = commands[w, s, t, 0], commands[w, s, t, 1], max_speed[w]
                if code == HOLONOMIC:
                    x, y, vx, vy = move_freely(limits[0] * dt, x, y, vx, vy, first, second, limit, dt)
                else:
                    x, y, vx, vy, way[t + 1, 4], way[t + 1, 5] = drive(
                        code, limits, x, y, vx, vy, way[t, 4], way[t, 5], first, second, limit, dt
                    )
                way[t + 1, 0], way[t + 1, 1], way[t + 1, 2], way[t + 1, 3] = x, y, vx, vy
                if obstacles.shape[1] > 0:
                    to_walls[t] = wall_gap_in_step(way[t, 0], way[t, 1], vx * dt, vy * dt, radius[w], obstacles[w])
            for m in range(crowd.shape[1]):
                ended = running
                t = 0
                while t < horizon and ended == running:
                    vx, vy, wall_gap = way[t + 1, 2], way[t + 1, 3], to_walls[t]
                    start[0, 0], start[0, 1], motion[0, 0], motion[0, 1] = way[t, 0], way[t, 1], vx * dt, vy * dt
                    for p in range(pedestrians):
                        for k in range(2):
                            start[p + 1, k] = crowd[w, m, t, p, k]
                            motion[p + 1, k] = crowd[w, m, t + 1, p, k] - crowd[w, m, t, p, k]
                    if code == HOLONOMIC:
                        nearest, _ = nearest_in_step(0, start, motion, radii, seen)
                    else:
                        own = way[t, 4], math.hypot(vx, vy), way[t + 1, 5], dt
                        nearest, wall_gap = gaps_on_arc(body, *own, start, motion, radii, seen, obstacles[w])
                    gap[w, s, m, t] = nearest - margin[t]
                    dx, dy = goal[w, 0] - way[t + 1, 0], goal[w, 1] - way[t + 1, 1]
                    ended = step_outcome(gap[w, s, m, t], wall_gap, dx, dy, near, False)
                    t += 1
                outcome[w, s, m], steps[w, s, m] = ended, t
