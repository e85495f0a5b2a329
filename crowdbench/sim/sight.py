"""Measurements of a vehicle with limited sight in each step, and tracks computed from them.

`World.sight` has these arrays; a measurement is x, y, vx, vy and radius of a pedestrian.

- `sent` `[world, delay, pedestrian, 5]`: delayed measurements that have not arrived, the oldest first, NaN without one;
  `sender` `[world, delay, pedestrian]`: the person of each column at the measurement, -1 if absent.
- `person` `[world, pedestrian]`: the person of each track, -1 before the first one.
- `state` `[world, pedestrian, 5]`: the last measurement, extrapolated at constant velocity; padding if the pedestrian
  is neither seen nor remembered.
- `unseen` `[world, pedestrian]`: steps since the last measurement; -1 if it is neither seen nor remembered.
- `observed` `[world, pedestrian]`, `history` `[world, time, pedestrian, 2]` and `filled` `[world, time, pedestrian]` as
  in `crowdbench.core.types.Pedestrians`.
"""

from __future__ import annotations

import math
import operator
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.rng import four_normal, purpose_bits, uniform
from crowdbench.core.types import HISTORY, World
from crowdbench.sim.lines_of_sight import is_hidden
from crowdbench.utils.compiled import njit

PADDING = (0.0, 0.0, 0.0, 0.0, 1.0)
"""The state of a pedestrian that is not seen."""

_SCENE = operator.attrgetter(
    "key", "step", "position", "velocity", "heading", "radius", "present", "person", "obstacles"
)
"""Arrays of a world that `_measure` takes."""

_NOISE, _MISSED = purpose_bits("sensor"), purpose_bits("missed detections")


class Tracks(NamedTuple):
    """The arrays of `World.sight` that are tracks."""

    person: Int[np.ndarray, "world pedestrian"]
    state: Float[np.ndarray, "world pedestrian 5"]
    unseen: Int[np.ndarray, "world pedestrian"]
    observed: Int[np.ndarray, "world pedestrian"]
    history: Float[np.ndarray, "world time pedestrian 2"]
    filled: Bool[np.ndarray, "world time pedestrian"]


def look(world: World) -> World:
    """Update the measurements of the vehicles' sensors, once in each step.

    Noise and missed detections are determined by case, step and person. They are drawn from the key of the case, which
    is not part of observations.

    Args:
        world: The current worlds; `sight` is that of the step before, or empty at the start.

    Returns:
        The worlds with their new `sight`. Worlds with exact sensors without limits or delay do not change.
    """
    if world.rules.sensor.sees_all:
        return world
    sensor, before = world.rules.sensor, world.sight or _nothing(world)
    measured = _measured(world)
    sender = np.where(world.present[:, 1:], world.person, -1)
    sent, dt = {}, world.rules.dt
    if sensor.steps_delayed(dt):
        sent["sent"] = np.concatenate([before["sent"][:, 1:], measured[:, None]], axis=1)
        sent["sender"] = np.concatenate([before["sender"][:, 1:], sender[:, None]], axis=1)
        measured, sender = (np.ascontiguousarray(before[name][:, 0]) for name in ("sent", "sender"))
    tracks = Tracks(*(before[name].copy() for name in Tracks._fields))
    _track(measured, sender, dt, sensor.steps_remembered(dt), *tracks)
    return world.replace(sight=sent | tracks._asdict())


def _nothing(world: World) -> dict[str, np.ndarray]:
    """Return the sight of vehicles before the first measurement."""
    worlds, pedestrians = world.person.shape
    delay = world.rules.sensor.steps_delayed(world.rules.dt)
    return {
        "sent": np.full((worlds, delay, pedestrians, 5), np.nan),
        "sender": np.full((worlds, delay, pedestrians), -1),
        "person": np.full((worlds, pedestrians), -1),
        "state": np.tile(PADDING, (worlds, pedestrians, 1)),
        "unseen": np.full((worlds, pedestrians), -1),
        "observed": np.zeros((worlds, pedestrians), np.int64),
        "history": np.zeros((worlds, HISTORY, pedestrians, 2)),
        "filled": np.zeros((worlds, HISTORY, pedestrians), bool),
    }


def _measured(world: World) -> Float[np.ndarray, "world pedestrian 5"]:
    """Return measurements of each pedestrian, NaN for undetected ones."""
    sensor = world.rules.sensor
    measured = np.full((*world.person.shape, 5), np.nan)
    reach = np.inf if sensor.range is None else sensor.range
    least_cosine = -2.0 if sensor.field_of_view >= 360.0 else math.cos(math.radians(sensor.field_of_view / 2.0))
    noise = sensor.noise.position, sensor.noise.velocity
    _measure(measured, reach, least_cosine, sensor.occlusion, *noise, sensor.missed, *_SCENE(world))
    return measured


@no_type_check
@njit(error_model="numpy")
def _measure(measured, reach, least_cosine, occlusion, position_noise, velocity_noise, missed, *scene):
    """Measure pedestrians that can be seen and are not missed.

    Args:
        measured: `[world, pedestrian, 5]`, filled with measurements.
        reach: Largest distance in metres between the rims of the vehicle and of a person that is seen.
        least_cosine: Smallest cosine of the angle between the heading and a person that is seen.
        occlusion: True if walls and other pedestrians hide pedestrians.
        position_noise: Standard deviation in metres.
        velocity_noise: Standard deviation in m/s.
        missed: Probability that a person is not detected.
        *scene: `_SCENE` of the worlds.
    """
    key, step, position, velocity, heading, radius, present, person, obstacles = scene
    for w in range(len(key)):
        for p in range(person.shape[1]):
            a = p + 1
            if not present[w, a]:
                continue
            dx, dy = position[w, a, 0] - position[w, 0, 0], position[w, a, 1] - position[w, 0, 1]
            distance = math.sqrt(dx * dx + dy * dy)
            if distance - radius[w, 0] - radius[w, a] > reach:
                continue
            if dx * math.cos(heading[w]) + dy * math.sin(heading[w]) < least_cosine * distance:
                continue
            if occlusion and is_hidden(a, position[w], radius[w], present[w], obstacles[w]):
                continue
            if missed > 0.0 and uniform(person[w, p], step[w], key[w], _MISSED) < missed:
                continue
            row = measured[w, p]
            row[0], row[1] = position[w, a, 0], position[w, a, 1]
            row[2], row[3], row[4] = velocity[w, a, 0], velocity[w, a, 1], radius[w, a]
            if position_noise > 0.0 or velocity_noise > 0.0:
                noise = four_normal(0, person[w, p], step[w], np.uint64(0), key[w], _NOISE)
                row[0], row[1] = row[0] + position_noise * noise[0], row[1] + position_noise * noise[1]
                row[2], row[3] = row[2] + velocity_noise * noise[2], row[3] + velocity_noise * noise[3]


@no_type_check
@njit(error_model="numpy")
def _track(measured, sender, dt, remembered, *tracks):
    """Continue the tracks by the measurements that arrive in a step.

    If a person is measured again after a gap, linear interpolation from its last measured position fills the gap in its
    history. Another person in the same column starts a new track.

    Args:
        measured: `[world, pedestrian, 5]`, NaN if none arrives.
        sender: `[world, pedestrian]`, the person of each column at the measurement, -1 if absent.
        dt: Length of a step in seconds.
        remembered: For how many steps a person is remembered.
        *tracks: The fields of `Tracks`, which are changed.
    """
    person, state, unseen, observed, history, filled = tracks
    worlds, length, pedestrians, _ = history.shape
    for w in range(worlds):
        for p in range(pedestrians):
            gap = unseen[w, p]
            if sender[w, p] >= 0 and sender[w, p] != person[w, p]:
                person[w, p], gap = sender[w, p], -1
            is_measured = not math.isnan(measured[w, p, 0])
            if not is_measured and (gap < 0 or gap >= remembered):
                _forget(w, p, state, unseen, observed, history, filled)
                continue
            for t in range(length - 1):
                history[w, t, p, 0], history[w, t, p, 1] = history[w, t + 1, p, 0], history[w, t + 1, p, 1]
                filled[w, t, p] = filled[w, t + 1, p]
            last_x, last_y = state[w, p, 0] - gap * state[w, p, 2] * dt, state[w, p, 1] - gap * state[w, p, 3] * dt
            if is_measured:
                state[w, p] = measured[w, p]
            else:
                state[w, p, 0] += state[w, p, 2] * dt
                state[w, p, 1] += state[w, p, 3] * dt
            unseen[w, p] = 0 if is_measured else gap + 1
            observed[w, p] = 1 if gap < 0 else min(observed[w, p] + 1, length)
            filled[w, length - 1, p] = not is_measured
            x, y = state[w, p, 0], state[w, p, 1]
            history[w, length - 1, p, 0], history[w, length - 1, p, 1] = x, y
            if gap < 0:
                for t in range(length - 1):
                    history[w, t, p, 0], history[w, t, p, 1], filled[w, t, p] = x, y, False
            elif is_measured:
                for back in range(1, min(gap, length - 1) + 1):
                    share = back / (gap + 1)
                    history[w, length - 1 - back, p, 0] = x + share * (last_x - x)
                    history[w, length - 1 - back, p, 1] = y + share * (last_y - y)


@no_type_check
@njit
def _forget(w, p, state, unseen, observed, history, filled):
    """Reset a pedestrian to unseen in the arrays of `_track`."""
    for k in range(5):
        state[w, p, k] = PADDING[k]
    unseen[w, p], observed[w, p] = -1, 0
    for t in range(history.shape[1]):
        history[w, t, p, 0], history[w, t, p, 1], filled[w, t, p] = 0.0, 0.0, False
