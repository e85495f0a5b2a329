"""What the vehicle sees of a world."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from crowdbench.types import HISTORY, Observation, Pedestrians, Vehicle, World


def observe(
    world: World,
    future: Float[np.ndarray, "world pedestrian 2"] | None = None,
    record: Callable[[str, np.ndarray], None] | None = None,
) -> Observation:
    """What the vehicle sees with perfect sight: every pedestrian that is present, exactly and at once.

    Args:
        world: The worlds, as they are now.
        future: The pedestrians' next velocities in m/s, where the planner is privileged.
        record: Keeps what the planner logs.

    Returns:
        The observation, in arrays of its own: what a planner does to them does not reach the world.
    """
    present = world.present[:, 1:]
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
        ),
        pedestrians=Pedestrians(
            position=world.position[:, 1:].copy(),
            velocity=world.velocity[:, 1:].copy(),
            radius=world.radius[:, 1:].copy(),
            seen=present.copy(),
            history=world.history.copy(),
            observed=np.where(present, np.minimum(world.step + 1, HISTORY)[:, None], 0),
            age=np.where(present, 0.0, np.inf),
        ),
        obstacles=world.obstacles.copy(),
        case=world.case.copy(),
        key=world.key.copy(),
        step=world.step.copy(),
        dt=world.rules.dt,
        future=future,
        record=record,
    )
