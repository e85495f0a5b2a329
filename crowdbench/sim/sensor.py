"""The vehicle's sensor: makes observations of worlds. `sight` stores the measurements of limited sight.

If there are more pedestrians than `Sensor.nearest`, an observation contains only the nearest ones.
"""

from __future__ import annotations

import dataclasses
import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.types import HISTORY, Observation, Pedestrians, Vehicle, World
from crowdbench.sim.lidar import scan
from crowdbench.sim.neighbors import insert_sorted
from crowdbench.utils.compiled import njit

_OF_AGENTS = "position", "velocity", "goal", "route", "waypoint", "radius", "preferred_speed"
"""The fields of a vehicle that are columns of the arrays of a world."""

_OVER_TIME = ("history", "filled")
"""Arrays with an axis `time` before the axis `pedestrian`."""


def observe(
    world: World,
    row: Int[np.ndarray, "world"] | None = None,
    future: Float[np.ndarray, "world pedestrian 2"] | None = None,
    logs: dict[str, np.ndarray] | None = None,
) -> Observation:
    """Observe worlds by the sensor of their scenario.

    Args:
        world: The worlds as they are now.
        row: Number of each world in the batch as it started; counted from 0 if None.
        future: The pedestrians' next velocities in m/s, for privileged planners only.
        logs: Receives the values that the planner logs.

    Returns:
        The observation. Its arrays are copies, so that a planner cannot change the world.
    """
    rules, sensor = world.rules, world.rules.sensor
    everything = Observation(
        vehicle=Vehicle(
            **{name: getattr(world, name)[:, 0].copy() for name in _OF_AGENTS},
            heading=world.heading.copy(),
            angular_speed=world.angular_speed.copy(),
            dynamics=rules.dynamics,
            actuation=rules.actuation,
            goal_tolerance=rules.goal_tolerance,
            body=rules.body,
        ),
        pedestrians=_everybody(world) if sensor.sees_all else _tracked(world),
        obstacles=world.obstacles.copy(),
        row=np.arange(len(world)) if row is None else row.copy(),
        noise_key=world.noise_key.copy(),
        step=world.step.copy(),
        dt=rules.dt,
        sensor=sensor,
        future=None if sensor.detector is not None else future,  # of pedestrians, which are not the tracks
        logs=logs,
        lidar=None if sensor.lidar is None else scan(world, sensor.lidar)[:, 0],
    )
    if rules.vehicles > 1 and sensor.detector is None:
        marks = np.zeros_like(everything.pedestrians.seen)
        marks[:, : rules.vehicles - 1] = True
        marked = dataclasses.replace(everything.pedestrians, is_vehicle=marks)
        everything = dataclasses.replace(everything, pedestrians=marked)
    return with_nearest(everything, sensor.nearest)


def with_nearest(obs: Observation, number: int | None) -> Observation:
    """Return an observation of the nearest pedestrians only.

    Args:
        number: Largest number of pedestrians in the new observation; all if None.

    Returns:
        The observation of the pedestrians whose centres are nearest to the vehicle's position; at the same distance,
        the first one is kept. Their order does not change. Unseen pedestrians only fill the rows of a world in which
        fewer are seen.
    """
    crowd = obs.pedestrians
    if number is None or number >= crowd.seen.shape[1]:
        return obs
    index = np.empty((len(obs), number), np.int64)
    _find_nearest(obs.vehicle.position, crowd.position, crowd.seen, index)
    parts = {name: _take(part, index, name in _OVER_TIME) for name, part in vars(crowd).items() if part is not None}
    future = None if obs.future is None else _take(obs.future, index, False)
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, **parts), future=future)


def _take(array: np.ndarray, index: Int[np.ndarray, "world nearest"], is_over_time: bool) -> np.ndarray:
    """Return a copy of the rows of some pedestrians."""
    row = np.arange(len(index))[:, None]
    return array[row, :, index].swapaxes(1, 2).copy() if is_over_time else array[row, index]


@no_type_check
@njit
def _find_nearest(position, others, seen, index):
    """Find the nearest, see `with_nearest`.

    Args:
        position: `[world, 2]`, of the vehicle, in metres.
        others: `[world, pedestrian, 2]`, in metres.
        seen: `[world, pedestrian]`.
        index: `[world, nearest]`, filled: pedestrians in ascending order.
    """
    number = index.shape[1]
    distance = np.empty(number)
    for w in range(len(index)):
        n = 0
        for p in range(seen.shape[1]):
            dx, dy = others[w, p, 0] - position[w, 0], others[w, p, 1] - position[w, 1]
            apart = dx * dx + dy * dy if seen[w, p] else np.inf
            if n == number and not apart < distance[n - 1]:
                continue
            n = insert_sorted(p, apart, n, number, index[w], distance)
        index[w].sort()


def _everybody(world: World) -> Pedestrians:
    """Return every pedestrian that is present, without error or delay."""
    seen = world.present[:, 1:].copy()
    observed, age = np.empty(seen.shape, np.int64), np.empty(seen.shape)
    _see(seen, world.step, world.since, observed, age)
    position, velocity, radius = (array[:, 1:].copy() for array in (world.position, world.velocity, world.radius))
    return Pedestrians(position, velocity, radius, seen, world.history.copy(), observed, age)


def _tracked(world: World) -> Pedestrians:
    """Return the pedestrians that were seen and are not forgotten, as they were measured, or the tracks."""
    state, seen, detector = world.sight["state"], world.sight["unseen"] >= 0, world.rules.sensor.detector
    position, velocity, radius = (state[:, :, part].copy() for part in (slice(2), slice(2, 4), 4))
    history, observed, filled = (world.sight[name].copy() for name in ("history", "observed", "filled"))
    deviation = None
    if detector is not None:  # tracks that are not confirmed are not shown
        history[~np.repeat(seen[:, None], HISTORY, axis=1)], observed[~seen] = 0.0, 0
        filled &= seen[:, None]
        deviation = None if detector.raw else world.sight["deviation"].copy()
    return Pedestrians(position, velocity, radius, seen, history, observed, ages(world), filled, deviation)


def ages(world: World) -> Float[np.ndarray, "world pedestrian"]:
    """Return the age in seconds of each pedestrian's last measurement, infinite if the pedestrian is not seen.

    Args:
        world: Worlds with limited sight.
    """
    unseen, dt = world.sight["unseen"], world.rules.dt
    return np.where(unseen < 0, np.inf, (unseen + world.rules.sensor.steps_delayed(dt)) * dt)


@no_type_check
@njit
def _see(seen, step, since, observed, age):
    """Fill the number of observed positions of each pedestrian, and the time since it was last seen.

    Compiled, because in one world NumPy would take half as long for this as for the rest of an observation.

    Args:
        seen: `[world, pedestrian]`, whether the pedestrian is seen now.
        step: `[world]`, steps done so far.
        since: `[world, pedestrian]`, the step after which the pedestrian came.
        observed: `[world, pedestrian]`, filled: positions that were really observed, at most `HISTORY`.
        age: `[world, pedestrian]`, filled: 0 s if the pedestrian is seen, infinite otherwise.
    """
    for w in range(len(step)):
        for p in range(seen.shape[1]):
            observed[w, p] = min(step[w] - since[w, p] + 1, HISTORY) if seen[w, p] else 0
            age[w, p] = 0.0 if seen[w, p] else math.inf
