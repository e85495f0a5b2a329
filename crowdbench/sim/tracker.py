"""The tracker of detections: it associates them to tracks itself, and never sees identities of pedestrians.

Each track is a Kalman filter at constant velocity. All detections of a step are assigned together by the Hungarian
method (global nearest neighbour): a call of SciPy for each world, which takes 1 to 7 us. Norfair, motpy and Stone Soup
track one scene with an object for each track, and so do not fit a batch of worlds.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from crowdbench.core.kalman import extrapolate_compiled, gain_compiled
from crowdbench.core.types import HISTORY, Sensor
from crowdbench.utils.compiled import njit

GATE = 9.21
"""Largest squared Mahalanobis distance from a track to its detection: 99 % of the chi-squared distribution."""

MANEUVER = 0.15
"""Standard deviation in metres by which people depart from constant velocity within a step, as the gate allows."""

HITS, SCANS = 2, 3
"""A new track is confirmed with so many detections, and deleted if it does not have them in so many steps."""

SPEED = 1.41
"""Standard deviation in m/s of each coordinate of the velocity of a new track, as in SPENCER (Linder et al. 2016)."""

UNKNOWN = 1e6
"""Variance of a velocity in (m/s)^2 that is not measured."""

PADDING = (0.0, 0.0, 0.0, 0.0, 1.0)
"""The state of a column without a track."""


class Tracks(NamedTuple):
    """Tracks of each world.

    Attributes:
        identity: Number of each track, in the order of their first detections; -1 in columns without one.
        born: Number of tracks of each world so far.
        mean: Estimated position in metres and velocity in m/s at the time of the last scan.
        covariance: See `crowdbench.core.kalman`.
        hits: Number of detections of a track.
        scans: Number of steps since the first one, itself included.
        misses: Steps since the last one.
        state: x, y, vx, vy and radius of confirmed tracks, extrapolated by the delay of the sensor; otherwise padding.
        deviation: As in `crowdbench.core.types.Pedestrians`; 0 for tracks that are not confirmed.
        unseen: Steps since the last detection of confirmed tracks; -1 for others.
        observed: As in `crowdbench.core.types.Pedestrians`, also of tracks that are not confirmed.
        history: The same.
        filled: The same.
    """

    identity: Int[np.ndarray, "world column"]
    born: Int[np.ndarray, "world"]
    mean: Float[np.ndarray, "world column 4"]
    covariance: Float[np.ndarray, "world column 3"]
    hits: Int[np.ndarray, "world column"]
    scans: Int[np.ndarray, "world column"]
    misses: Int[np.ndarray, "world column"]
    state: Float[np.ndarray, "world column 5"]
    deviation: Float[np.ndarray, "world column 2"]
    unseen: Int[np.ndarray, "world column"]
    observed: Int[np.ndarray, "world column"]
    history: Float[np.ndarray, "world time column 2"]
    filled: Bool[np.ndarray, "world time column"]


Detections = Float[np.ndarray, "world column 5"]


def no_tracks(worlds: int, columns: int) -> Tracks:
    """Return the tracks of worlds before the first scan."""
    zeros, shape = np.zeros((worlds, columns), np.int64), (worlds, columns)
    return Tracks(
        identity=zeros - 1,
        born=np.zeros(worlds, np.int64),
        mean=np.zeros((*shape, 4)),
        covariance=np.zeros((*shape, 3)),
        hits=zeros,
        scans=zeros,
        misses=zeros,
        state=np.tile(PADDING, (*shape, 1)),
        deviation=np.zeros((*shape, 2)),
        unseen=zeros - 1,
        observed=zeros,
        history=np.zeros((worlds, HISTORY, columns, 2)),
        filled=np.zeros((worlds, HISTORY, columns), bool),
    )


def untracked(tracks: Tracks, detections: Detections) -> Tracks:
    """Return detections in place of tracks: in a new order in each step, and without a past.

    Args:
        tracks: The tracks of the step before.
        detections: The detections that arrive now.
    """
    is_there = ~np.isnan(detections[..., 0])
    state = np.where(is_there[..., None], detections, PADDING)
    past = np.where(is_there[:, None, :, None], state[:, None, :, :2], 0.0)
    return tracks._replace(
        state=state,
        unseen=is_there - 1,
        observed=is_there.astype(np.int64),
        history=np.repeat(past, HISTORY, axis=1),
    )


def track(
    before: Tracks, detections: Detections, is_first: Bool[np.ndarray, "world"], sensor: Sensor, dt: float
) -> Tracks:
    """Continue tracks by the detections that arrive in a step.

    Args:
        before: The tracks of the step before.
        detections: x, y, vx, vy and radius, NaN without one.
        is_first: True for worlds whose first scan this is: there all tracks are confirmed at once.
        sensor: The sensor, with a detector.
        dt: Length of a step in seconds.

    Returns:
        The tracks after the step. Detections that find no free column are lost.
    """
    detector = sensor.detector
    assert detector is not None
    variance = detector.position**2, UNKNOWN if detector.velocity is None else detector.velocity**2
    tracks = Tracks(*(array.copy() for array in before))
    cost, has_pairs = np.empty((*tracks.identity.shape, detections.shape[1])), np.empty(len(detections), bool)
    _predict(tracks.identity, tracks.mean, tracks.covariance, detections, dt, variance[0], cost, has_pairs)
    match = np.full(tracks.identity.shape, -1)
    for world in np.flatnonzero(has_pairs):
        column, detection = linear_sum_assignment(cost[world])
        is_pair = cost[world, column, detection] < GATE
        match[world, column[is_pair]] = detection[is_pair]
    times = sensor.steps_remembered(dt), sensor.steps_delayed(dt) * dt
    _update(match, detections, is_first, variance, *times, detector.radius, *tracks)
    return tracks


@no_type_check
@njit(error_model="numpy")
def _predict(identity, mean, covariance, detections, dt, variance, cost, has_pairs):
    """Extrapolate tracks to the time of a scan, and fill the costs of all pairs of tracks and detections.

    A cost is the negative logarithm of the likelihood of the pair, twice and without constants. Outside of the gate it
    is `GATE`, which is thus also the cost of a track without a detection.

    Args:
        identity: `[world, column]`.
        mean: `[world, column, 4]`, changed.
        covariance: `[world, column, 3]`, changed.
        detections: `[world, column, 5]`.
        dt: Length of a step in seconds.
        variance: Variance in m^2 of the errors of detections.
        cost: `[world, column, column]`, filled.
        has_pairs: `[world]`, filled: True for worlds with a pair inside of the gate.
    """
    worlds, columns, number = cost.shape
    for w in range(worlds):
        has_pairs[w] = False
        for k in range(columns):
            cost[w, k] = GATE
            if identity[w, k] < 0:
                continue
            here, spread = mean[w, k], covariance[w, k]
            here[0], here[1] = here[0] + dt * here[2], here[1] + dt * here[3]
            spread[0], spread[1], spread[2] = extrapolate_compiled(spread[0], spread[1], spread[2], dt)
            total = spread[0] + max(variance, MANEUVER * MANEUVER)
            for d in range(number):
                dx, dy = detections[w, d, 0] - here[0], detections[w, d, 1] - here[1]
                distance = (dx * dx + dy * dy) / total
                if distance < GATE:  # not without a detection, which is NaN
                    cost[w, k, d] = min(distance + 2.0 * math.log(total), GATE)
                    has_pairs[w] = True


@no_type_check
@njit(error_model="numpy")
def _update(match, detections, is_first, variance, remembered, delay, radius, *tracks):
    """Correct tracks by their detections, delete tracks without detections, and start tracks.

    Args:
        match: `[world, column]`, the index of the detection of each track, -1 without one.
        detections: `[world, column, 5]`.
        is_first: `[world]`.
        variance: Variances of the errors of positions and of velocities.
        remembered: Number of steps for which a confirmed track needs no detection.
        delay: Seconds by which the shown tracks are extrapolated.
        radius: Radius of the tracks in metres.
        *tracks: The fields of `Tracks`, which are changed.
    """
    identity, born, mean, covariance, hits, scans, misses, state, deviation, unseen, observed, history, filled = tracks
    worlds, columns = identity.shape
    for w in range(worlds):
        is_free = np.empty(detections.shape[1], np.bool_)
        for d in range(len(is_free)):
            is_free[d] = not math.isnan(detections[w, d, 0])
        for k in range(columns):
            if identity[w, k] < 0:
                continue
            scans[w, k], misses[w, k] = scans[w, k] + 1, misses[w, k] + 1
            d = match[w, k]
            if d >= 0:
                is_free[d], misses[w, k], hits[w, k] = False, 0, hits[w, k] + 1
                _correct(mean[w, k], covariance[w, k], detections[w, d], variance)
            if (misses[w, k] > remembered) if hits[w, k] >= HITS else (scans[w, k] >= SCANS):
                identity[w, k] = -1
        k = 0
        for d in range(len(is_free)):
            while k < columns and identity[w, k] >= 0:
                k += 1
            if is_free[d] and k < columns:
                identity[w, k], born[w] = born[w], born[w] + 1
                hits[w, k], scans[w, k], misses[w, k], unseen[w, k] = 1, 1, 0, -1
                mean[w, k] = detections[w, d, :4]
                covariance[w, k, 0], covariance[w, k, 1] = variance[0], 0.0
                covariance[w, k, 2] = min(variance[1], SPEED * SPEED)
        for k in range(columns):
            is_shown = identity[w, k] >= 0 and (hits[w, k] >= HITS or unseen[w, k] >= 0 or is_first[w])
            unseen[w, k] = misses[w, k] if is_shown else -1
            _show(is_shown, mean[w, k], covariance[w, k], delay, radius, state[w, k], deviation[w, k])
            if identity[w, k] >= 0:
                observed[w, k] = min(scans[w, k], HISTORY)
                _append(mean[w, k], delay, scans[w, k] == 1, misses[w, k] > 0, history[w, :, k], filled[w, :, k])


@no_type_check
@njit(error_model="numpy")
def _correct(mean, covariance, detection, variance):
    """Correct a track by a detection."""
    p, c, v = covariance[0], covariance[1], covariance[2]
    pp, pv, vp, vv = gain_compiled(p, c, v, variance[0], variance[1])
    for axis in range(2):
        off = detection[axis] - mean[axis]
        # A velocity that is not measured has no error.
        faster = detection[2 + axis] - mean[2 + axis] if variance[1] < UNKNOWN else 0.0
        mean[axis] += pp * off + pv * faster
        mean[2 + axis] += vp * off + vv * faster
    covariance[0], covariance[1], covariance[2] = p - pp * p - pv * c, c - pp * c - pv * v, v - vp * c - vv * v


@no_type_check
@njit(error_model="numpy")
def _show(is_shown, mean, covariance, delay, radius, state, deviation):
    """Fill the state of a track, extrapolated by the delay, and its standard deviations; or the padding."""
    if not is_shown:
        for i in range(5):
            state[i] = PADDING[i]
        deviation[:] = 0.0
        return
    state[0], state[1] = mean[0] + delay * mean[2], mean[1] + delay * mean[3]
    state[2], state[3], state[4] = mean[2], mean[3], radius
    p, _, v = extrapolate_compiled(covariance[0], covariance[1], covariance[2], delay)
    deviation[0], deviation[1] = math.sqrt(p), math.sqrt(v)


@no_type_check
@njit(error_model="numpy")
def _append(mean, delay, is_new, is_filled, history, filled):
    """Append the position of a track to its history, or fill the history of a new one."""
    last = len(history) - 1
    for t in range(last):
        history[t], filled[t] = history[t + 1], filled[t + 1] and not is_new
    for t in range(0 if is_new else last, last + 1):
        history[t, 0], history[t, 1] = mean[0] + delay * mean[2], mean[1] + delay * mean[3]
    filled[last] = is_filled
