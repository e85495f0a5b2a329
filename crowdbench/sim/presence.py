"""Pedestrians that appear and disappear at their recorded times."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.dynamics import disc_centres
from crowdbench.core.geometry import norm
from crowdbench.core.types import World


def track_at(world: World, step: Int[np.ndarray, "world"]) -> Float[np.ndarray, "world pedestrian 2"]:
    """Return the positions of recorded pedestrians.

    Args:
        step: The step of each world.

    Returns:
        Positions in metres; NaN for absent pedestrians, and after the last step.
    """
    last = world.track.shape[1] - 1
    position = world.track[np.arange(len(world)), np.minimum(step, last)]
    position[step > last] = np.nan
    return position


def come_and_go(world: World, running: Bool[np.ndarray, "world"]) -> World:
    """Return worlds in which the pedestrians recorded at this step are present.

    A new pedestrian appears at its recorded position, without a history. If it would overlap the vehicle, it appears at
    its first recorded position without overlap. A pedestrian that leaves is no longer present.

    Args:
        world: Worlds of recorded pedestrians after a step, with the presence before the step.
        running: Mask of the running worlds; the others do not change.

    Returns:
        The worlds with the new presence, positions, velocities and histories.
    """
    now = track_at(world, world.step)
    before = world.present[:, 1:]
    here = np.where(running[:, None], ~np.isnan(now[..., 0]), before)
    comes = here & ~before
    if not comes.any() and (here == before).all():
        return world
    comes &= ~_on_vehicle(world, now)
    present = np.concatenate([world.present[:, :1], (here & before) | comes], axis=1)
    if not comes.any():
        return world.replace(present=present)
    position, velocity, history = world.position.copy(), world.velocity.copy(), world.history.copy()
    later = track_at(world, world.step + 1)
    position[:, 1:][comes] = now[comes]
    velocity[:, 1:][comes] = np.nan_to_num(later - now)[comes] / world.rules.dt
    history.swapaxes(1, 2)[comes] = now[comes][:, None]
    since = np.where(comes, world.step[:, None], world.since)
    return world.replace(present=present, position=position, velocity=velocity, history=history, since=since)


def _on_vehicle(world: World, point: Float[np.ndarray, "world pedestrian 2"]) -> Bool[np.ndarray, "world pedestrian"]:
    """Return whether pedestrians at these points in metres would overlap the vehicle."""
    discs = disc_centres(world.rules.body, world.position[:, 0], world.heading)
    distance = norm(point[:, :, None] - discs[:, None]).min(axis=2)
    return np.asarray(distance < world.radius[:, :1] + world.radius[:, 1:])
