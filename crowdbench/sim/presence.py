"""People who come and go at the times at which they were recorded."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.dynamics import disc_centres
from crowdbench.core.geometry import norm
from crowdbench.core.types import World


def track_at(world: World, step: Int[np.ndarray, "world"]) -> Float[np.ndarray, "world pedestrian 2"]:
    """Return where recorded people were.

    Args:
        world: The worlds.
        step: At which step of each.

    Returns:
        Positions in metres; NaN for those who were not there, and after the last step.
    """
    last = world.track.shape[1] - 1
    position = world.track[np.arange(len(world)), np.minimum(step, last)]
    position[step > last] = np.nan
    return position


def come_and_go(world: World, running: Bool[np.ndarray, "world"]) -> World:
    """Return worlds in which those are present who were recorded at this step.

    A new pedestrian stands at its recorded position, without a history. Nobody comes in where the vehicle is: they
    come as soon as they were recorded elsewhere. A pedestrian that leaves is not present any more.

    Args:
        world: Worlds of recorded people after a step, in which those are present who were so before the step.
        running: Which of them are still running; the others stay as they are.

    Returns:
        The worlds with presence, position, velocity and history of those who come and go.
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
