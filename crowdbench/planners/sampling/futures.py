"""Sequences of commands under predicted futures: how each would end, and how close it would come to the pedestrians."""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics.motion import HOLONOMIC, drive_without_heading
from crowdbench.core.geometry import Discs, nearest_in_step
from crowdbench.core.types import Outcome
from crowdbench.planners.scene import Scene, fill_crowd, motion_of
from crowdbench.sim.episode import step_outcome
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.sim.swept import gaps_on_arc
from crowdbench.utils.compiled import njit


class SequenceResult(NamedTuple):
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
    scene: Scene, commands: Float[np.ndarray, "world sequence time 2"], margin: Float[np.ndarray, "time"]
) -> SequenceResult:
    """Find out how sequences of commands would go, by the simulator's rule for collisions and the goal.

    Args:
        scene: The vehicle and the pedestrians.
        commands: Commands of the vehicle's dynamics.
        margin: By how much gaps are made smaller in each step, in metres.
    """
    worlds, sequences, steps = commands.shape[:3]
    shape = worlds, sequences, scene.crowd.position.shape[1]
    result = SequenceResult(np.empty(shape, np.int64), np.empty(shape, np.int64), np.full((*shape, steps), np.inf))
    _try_sequences(scene.arrays, scene.crowd, scene.obstacles, scene.dt, commands, margin, result)
    return result


@no_type_check
@njit(nogil=True)
def _try_sequences(vehicle, crowd, obstacles, dt, commands, margin, result):
    """See `try_sequences`; fills the result."""
    code, limits, body, position, radius = vehicle.code, vehicle.limits, vehicle.body, crowd.position, vehicle.radius
    agents, horizon, running = 1 + position.shape[3], commands.shape[2], Outcome.RUNNING.value
    start, motion = np.empty((agents, 2)), np.empty((agents, 2))
    radii, present = np.empty(agents), np.ones(agents, np.bool_)
    discs = Discs(start, motion, radii, present)
    # The vehicle's `Motion` before the first step and after each one.
    way, to_walls = np.empty((horizon + 1, 6)), np.full(horizon, np.inf)
    for w in range(len(commands)):
        radii[0], radii[1:], present[1:], way[0] = radius[w], crowd.radius[w], crowd.present[w], vehicle.motion[w]
        for s in range(commands.shape[1]):
            for t in range(horizon):
                before, command = motion_of(way, t), (commands[w, s, t, 0], commands[w, s, t, 1])
                after = drive_without_heading(code, limits, before, command, vehicle.preferred_speed[w], dt)
                way[t + 1, 0], way[t + 1, 1], way[t + 1, 2], way[t + 1, 3], way[t + 1, 4], way[t + 1, 5] = after
                if obstacles.shape[1] > 0:
                    dx, dy = after.vx * dt, after.vy * dt
                    to_walls[t] = wall_gap_in_step(before.x, before.y, dx, dy, radius[w], obstacles[w])
            for m in range(position.shape[1]):
                ended = running
                t = 0
                while t < horizon and ended == running:
                    vx, vy, wall_gap = way[t + 1, 2], way[t + 1, 3], to_walls[t]
                    start[0, 0], start[0, 1], motion[0, 0], motion[0, 1] = way[t, 0], way[t, 1], vx * dt, vy * dt
                    fill_crowd(position, w, m, t, start, motion)
                    if code == HOLONOMIC:
                        gap, _ = nearest_in_step(0, discs)
                    else:
                        arc = way[t, 4], math.hypot(vx, vy), way[t + 1, 5], dt
                        gap, wall_gap = gaps_on_arc(body, *arc, discs, obstacles[w])
                    gap -= margin[t]
                    dx, dy = vehicle.goal[w, 0] - way[t + 1, 0], vehicle.goal[w, 1] - way[t + 1, 1]
                    ended = step_outcome(gap, wall_gap, dx, dy, vehicle.goal_tolerance[w], False)
                    result.gap[w, s, m, t] = gap
                    t += 1
                result.outcome[w, s, m], result.steps[w, s, m] = ended, t
