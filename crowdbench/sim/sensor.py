"""The vehicle's sensor: makes observations of worlds."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.compiled import njit
from crowdbench.types import HISTORY, Observation, Pedestrians, Vehicle, World


def observe(
    world: World,
    row: Int[np.ndarray, "world"] | None = None,
    future: Float[np.ndarray, "world pedestrian 2"] | None = None,
    logs: dict[str, np.ndarray] | None = None,
) -> Observation:
    """Observe with a perfect sensor: every pedestrian that is present, without error or delay.

    Args:
        world: The worlds as they are now.
        row: Number of each world in the batch as it started; counted from 0 if None.
        future: The pedestrians' next velocities in m/s, for privileged planners only.
        logs: Receives what the planner logs.

    Returns:
        The observation. Its arrays are copies, so that a planner cannot change the world.
    """
    seen = world.present[:, 1:].copy()
    observed, age = np.empty(seen.shape, np.int64), np.empty(seen.shape)
    _see(seen, world.step, observed, age)
    return Observation(
        vehicle=Vehicle(
            position=world.position[:, 0].copy(),
            velocity=world.velocity[:, 0].copy(),
            heading=world.heading.copy(),
            angular_speed=world.angular_speed.copy(),
            goal=world.goal[:, 0].copy(),
            route=world.route[:, 0].copy(),
            waypoint=world.waypoint[:, 0].copy(),
            radius=world.radius[:, 0].copy(),
            preferred_speed=world.preferred_speed[:, 0].copy(),
            dynamics=world.rules.dynamics,
            goal_tolerance=world.rules.goal_tolerance,
            body=world.rules.body,
        ),
        pedestrians=Pedestrians(
            position=world.position[:, 1:].copy(),
            velocity=world.velocity[:, 1:].copy(),
            radius=world.radius[:, 1:].copy(),
            seen=seen,
            history=world.history.copy(),
            observed=observed,
            age=age,
        ),
        obstacles=world.obstacles.copy(),
        row=np.arange(len(world)) if row is None else row.copy(),
        noise_key=world.noise_key.copy(),
        step=world.step.copy(),
        dt=world.rules.dt,
        future=future,
        logs=logs,
    )


@no_type_check
@njit
def _see(seen, step, observed, age):
    """How many positions of each pedestrian were observed, and how long ago it was seen.

    Compiled, because in one world NumPy would take half as long for this as for the rest of an observation.

    Args:
        seen: `[world, pedestrian]`, whether the pedestrian is seen now.
        step: `[world]`, steps done so far.
        observed: `[world, pedestrian]`, filled: positions that were really observed, at most `HISTORY`.
        age: `[world, pedestrian]`, filled: 0 s where the pedestrian is seen, infinite where it never was.
    """
    for w in range(len(step)):
        positions = min(step[w] + 1, HISTORY)
        for p in range(seen.shape[1]):
            observed[w, p] = positions if seen[w, p] else 0
            age[w, p] = 0.0 if seen[w, p] else math.inf
