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

With a detector, `sent` has detections, the tracks are `crowdbench.sim.tracker.Tracks`, and there are

- `detected` `[world, pedestrian]`: True for pedestrians whose detection arrives now; `on_way` `[world, delay,
  pedestrian]`: the same for those in `sent`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.types import HISTORY, World
from crowdbench.sim import tracker
from crowdbench.sim.detections import detect, measure
from crowdbench.sim.tracker import PADDING
from crowdbench.utils.compiled import njit


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
    sensor, dt = world.rules.sensor, world.rules.dt
    if sensor.sees_all:
        return world
    if sensor.detector is not None:
        return world.replace(sight=_look_by_detector(world))
    before = world.sight or _nothing(world)
    now = {"sent": measure(world), "sender": np.where(world.present[:, 1:], world.person, -1)}
    sent, (measured, sender) = _delay(before, now, sensor.steps_delayed(dt))
    tracks = Tracks(*(before[name].copy() for name in Tracks._fields))
    _track(measured, sender, dt, sensor.steps_remembered(dt), *tracks)
    return world.replace(sight=sent | tracks._asdict())


def _look_by_detector(world: World) -> dict[str, np.ndarray]:
    """Return the sight of vehicles with a detector of people."""
    sensor, dt = world.rules.sensor, world.rules.dt
    delay = sensor.steps_delayed(dt)
    now = dict(zip(("sent", "on_way"), detect(world), strict=True))
    before = world.sight or _no_detections(now, delay)
    sent, (detections, detected) = _delay(before, now, delay)
    tracks = tracker.Tracks(*(before[name] for name in tracker.Tracks._fields))
    if sensor.detector is not None and sensor.detector.raw:
        tracks = tracker.untracked(tracks, detections)
    else:
        tracks = tracker.track(tracks, detections, world.step == delay, sensor, dt)
    return sent | {"detected": detected} | tracks._asdict()


def _no_detections(now: Mapping[str, np.ndarray], delay: int) -> dict[str, np.ndarray]:
    """Return the sight of vehicles before the first detection, from the arrays of detections in the first step."""
    before = {"sent": np.full_like(now["sent"], np.nan), "on_way": np.zeros_like(now["on_way"])}
    before = {name: np.repeat(array[:, None], delay, axis=1) for name, array in before.items()}
    return before | tracker.no_tracks(*now["sent"].shape[:2])._asdict()


def _delay(
    before: Mapping[str, np.ndarray], now: Mapping[str, np.ndarray], delay: int
) -> tuple[dict[str, np.ndarray], tuple[np.ndarray, ...]]:
    """Send measurements.

    Args:
        before: The measurements on their way, by name, `[world, delay, ...]`.
        now: The measurements of this step by name.
        delay: Number of steps until they arrive.

    Returns:
        The measurements that are then on their way, and those that arrive now.
    """
    if not delay:
        return {}, tuple(now.values())
    sent = {name: np.concatenate([before[name][:, 1:], array[:, None]], axis=1) for name, array in now.items()}
    return sent, tuple(np.ascontiguousarray(before[name][:, 0]) for name in now)


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
