"""What a planner believes will happen in the next step under each command: compiled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numba import njit

from crowdbench.geometry import nearest_in_step
from crowdbench.sim.episode import step_outcome
from crowdbench.value.joint_state import SIZE, write_joint_state


@dataclass(frozen=True)
class Scene:
    """The vehicle and the crowd before a step, and the crowd after it in each mode of a prediction."""

    position: Float[np.ndarray, "world 2"]
    velocity: Float[np.ndarray, "world 2"]
    goal: Float[np.ndarray, "world 2"]
    radius: Float[np.ndarray, "world"]
    preferred_speed: Float[np.ndarray, "world"]
    crowd: Float[np.ndarray, "world mode pedestrian 2"]
    next_crowd: Float[np.ndarray, "world mode pedestrian 2"]
    next_velocity: Float[np.ndarray, "world mode pedestrian 2"]
    crowd_radius: Float[np.ndarray, "world pedestrian"]
    present: Bool[np.ndarray, "world pedestrian"]
    dt: float


@dataclass(frozen=True)
class Outlook:
    """Some commands' next step: outcome and gap as the judge's sweep would see it, and the state it leads to."""

    outcome: Int[np.ndarray, "row mode"]
    gap: Float[np.ndarray, "row mode"]
    joint: Float32[np.ndarray, "row mode pedestrian 13"]


def look(scene: Scene, commands: Float[np.ndarray, "row 2"], world: Int[np.ndarray, "row"]) -> Outlook:
    """What each command, in m/s, leads to in its world.

    Everybody moves straight and evenly from where the planner sees it to where the prediction has it. It
    never knows of a time-out.
    """
    rows, (modes, pedestrians) = len(commands), scene.crowd.shape[1:3]
    outlook = Outlook(
        np.empty((rows, modes), np.int64),
        np.empty((rows, modes)),
        np.empty((rows, modes, max(pedestrians, 1), SIZE), np.float32),
    )
    _look(
        scene.position,
        scene.goal,
        scene.radius,
        scene.preferred_speed,
        scene.crowd,
        scene.next_crowd,
        scene.next_velocity,
        scene.crowd_radius,
        scene.present,
        scene.dt,
        commands,
        world,
        outlook.outcome,
        outlook.gap,
        outlook.joint,
    )
    return outlook


@no_type_check
@njit(cache=True, nogil=True)
def _look(
    position,
    goal,
    radius,
    preferred_speed,
    crowd,
    next_crowd,
    next_velocity,
    crowd_radius,
    present,
    dt,
    commands,
    world,
    outcome,
    gap,
    joint,
):
    pedestrians = crowd.shape[2]
    start = np.empty((pedestrians + 1, 2))
    motion = np.empty((pedestrians + 1, 2))
    radii = np.empty(pedestrians + 1)
    seen = np.ones(pedestrians + 1, np.bool_)
    for row in range(len(commands)):
        w = world[row]
        vx, vy = commands[row, 0], commands[row, 1]
        x, y = position[w, 0] + vx * dt, position[w, 1] + vy * dt
        dx, dy = goal[w, 0] - x, goal[w, 1] - y
        radii[0], radii[1:], seen[1:] = radius[w], crowd_radius[w], present[w]
        start[0], motion[0, 0], motion[0, 1] = position[w], vx * dt, vy * dt
        for m in range(crowd.shape[1]):
            for p in range(pedestrians):
                for k in range(2):
                    start[p + 1, k] = crowd[w, m, p, k]
                    motion[p + 1, k] = next_crowd[w, m, p, k] - crowd[w, m, p, k]
            gap[row, m], _ = nearest_in_step(0, start, motion, radii, seen)
            outcome[row, m] = step_outcome(gap[row, m], np.inf, dx, dy, radius[w], False)
            write_joint_state(
                joint[row, m],
                x,
                y,
                vx,
                vy,
                radius[w],
                goal[w],
                preferred_speed[w],
                next_crowd[w, m],
                next_velocity[w, m],
                crowd_radius[w],
                present[w],
            )
