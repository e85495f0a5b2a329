"""A planner behind a Kalman filter, for studies of scenarios with noise and without a tracker."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from crowdbench import Observation, Planner, load_planner
from crowdbench.core import HISTORY, Pedestrians, extrapolate_covariance, gain
from crowdbench.planners import AheadPlanner, Sequence

Means = Float[np.ndarray, "world pedestrian 4"]
Covariances = Float[np.ndarray, "world pedestrian 3"]
Estimates = tuple[Means, Covariances]

MEMORY = 4.0
"""Seconds for which a pedestrian without measurements is tracked."""

EXACT = 1e-3
"""Smallest standard deviation of a measurement, in metres and in m/s. It avoids singular matrices without noise."""


class _Tracks:
    """The estimates of the pedestrians of a batch, by the row of a world and the index of a pedestrian.

    Attributes:
        mean: Position in metres and velocity in m/s at the last measurement that has arrived, or extrapolated from it.
        covariance: Variance of the position, covariance, and variance of the velocity, along each axis.
        radius: Radius in metres.
        age: Seconds since the last measurement, without its delay; infinite if there is none.
        time: Time of the last observation of each world, in seconds from the start of the episode.
    """

    def __init__(self, worlds: int, pedestrians: int) -> None:
        self.mean = np.zeros((worlds, pedestrians, 4))
        self.covariance = np.zeros((worlds, pedestrians, 3))
        self.radius = np.ones((worlds, pedestrians))
        self.age = np.full((worlds, pedestrians), np.inf)
        self.time = np.zeros(worlds)
        self.last = np.full((worlds, pedestrians, 2), np.nan)


class KalmanFilter:
    """A Kalman filter for each pedestrian: constant velocity with white acceleration (Bar-Shalom et al. 2001).

    `Observation.sensor` contains the noise and the delay of the sensor. Measurements refer to the time before the
    delay; estimates are extrapolated to the present. A pedestrian without measurements is tracked for `MEMORY` seconds
    with growing uncertainty.
    """

    def __init__(self) -> None:
        self.reset(np.arange(0))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """Delete all tracks. See `Planner.reset`."""
        self.worlds = len(rows)
        self.tracks: _Tracks | None = None

    def forget(self, rows: Int[np.ndarray, "world"]) -> None:
        """Delete all tracks in some worlds, in which another episode starts."""
        if self.tracks is not None:
            self.tracks.age[rows], self.tracks.time[rows] = np.inf, 0.0

    def filter(self, obs: Observation) -> Observation:
        """Return the filtered observation: estimates of the present, with their standard deviations.

        The tracks of a detector are estimates already, and do not change.
        """
        if obs.sensor.detector is not None:
            return obs
        if self.tracks is None:
            self.tracks = _Tracks(max(self.worlds, int(obs.row.max(initial=-1)) + 1), obs.pedestrians.seen.shape[1])
        tracks, row, delay = self.tracks, obs.row, obs.sensor.steps_delayed(obs.dt) * obs.dt
        elapsed = obs.time - tracks.time[row]
        tracks.time[row] = obs.time
        mean, covariance = _move_on(tracks.mean[row], tracks.covariance[row], elapsed[:, None])
        age, radius = tracks.age[row] + elapsed[:, None], tracks.radius[row]
        crowd = obs.pedestrians
        measured = crowd.seen & (crowd.age <= delay + 1e-6)
        # An index has another pedestrian if `observed` starts again, or if the previous position is not that of the
        # last measurement; the second condition is False if nothing was measured in the last step.
        is_other = np.abs(crowd.history[:, -2] - tracks.last[row]).max(axis=-1) > 1e-9
        is_new = measured & (~np.isfinite(age) | (crowd.observed <= 1) | is_other)
        noise = obs.sensor.noise
        variance = np.array([max(noise.position, EXACT) ** 2, max(noise.velocity, EXACT) ** 2])
        values = np.concatenate([crowd.position, crowd.velocity], axis=2)
        mean = np.where(is_new[..., None], values, mean)
        covariance = np.where(is_new[..., None], [variance[0], 0.0, variance[1]], covariance)
        better = _measure(mean, covariance, values, variance)
        again = (measured & ~is_new)[..., None]
        mean, covariance = np.where(again, better[0], mean), np.where(again, better[1], covariance)
        age, radius = np.where(measured, 0.0, age), np.where(measured, crowd.radius, radius)
        tracks.mean[row], tracks.covariance[row], tracks.age[row], tracks.radius[row] = mean, covariance, age, radius
        tracks.last[row] = np.where(measured[..., None], crowd.position, np.nan)
        mean, covariance = _move_on(mean, covariance, np.full_like(age, delay))
        return dataclasses.replace(obs, pedestrians=_estimated(obs, mean, covariance, age, radius))


def _move_on(mean: Means, covariance: Covariances, time: Float[np.ndarray, "world #pedestrian"]) -> Estimates:
    """Return estimates after some seconds at constant velocity, with white acceleration."""
    p, c, v = np.moveaxis(covariance, -1, 0)
    later = extrapolate_covariance(p, c, v, time)
    position = mean[..., :2] + time[..., None] * mean[..., 2:]
    return np.concatenate([position, mean[..., 2:]], axis=-1), np.stack(later, axis=-1)


def _measure(mean: Means, covariance: Covariances, values: Means, variance: Float[np.ndarray, "2"]) -> Estimates:
    """Return estimates after a measurement of position and velocity, whose errors have these variances."""
    p, c, v = np.moveaxis(covariance, -1, 0)
    pp, pv, vp, vv = gain(p, c, v, *variance)
    off = values - mean
    position = mean[..., :2] + pp[..., None] * off[..., :2] + pv[..., None] * off[..., 2:]
    velocity = mean[..., 2:] + vp[..., None] * off[..., :2] + vv[..., None] * off[..., 2:]
    after = np.stack([p - pp * p - pv * c, c - pp * c - pv * v, v - vp * c - vv * v], axis=-1)
    return np.concatenate([position, velocity], axis=-1), after


def _estimated(
    obs: Observation, mean: np.ndarray, covariance: np.ndarray, age: np.ndarray, radius: np.ndarray
) -> Pedestrians:
    """Return the estimated pedestrians, each with a history on a straight line at its velocity."""
    known = age <= MEMORY
    position, velocity = (np.where(known[..., None], part, 0.0) for part in (mean[..., :2], mean[..., 2:]))
    back = obs.dt * np.arange(1 - HISTORY, 1)[:, None, None]
    return Pedestrians(
        position=position,
        velocity=velocity,
        radius=np.where(known, radius, 1.0),
        seen=known,
        history=position[:, None] + back * velocity[:, None],
        observed=np.where(known, HISTORY, 0),
        age=np.where(known, age, np.inf),
        deviation=np.where(known[..., None], np.sqrt(covariance[..., [0, 2]]), 0.0),
    )


class FilteredPlanner(AheadPlanner):
    """A planner that gets filtered observations.

    Args:
        planner: The planner.
    """

    def __init__(self, planner: Planner) -> None:
        self.planner, self.filter = planner, KalmanFilter()
        self.privileged, self.native = planner.privileged, planner.native
        self.trained_pedestrians, self.trained_dt = planner.trained_pedestrians, planner.trained_dt
        self.facts: Mapping[str, str] = planner.facts

    def for_held_out_scene(self, scene: str) -> FilteredPlanner:
        """See `Planner`."""
        return FilteredPlanner(self.planner.for_held_out_scene(scene))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        self.filter.reset(rows)
        self.planner.reset(rows)

    def plan_ahead(self, obs: Observation, steps: int) -> Sequence:
        """See `Planner`. The vehicle stands until the first measurements can have arrived."""
        shown = obs if obs.sensor.sees_all else self.filter.filter(obs)
        commands = self.planner.plan_ahead(shown, steps) if steps > 1 else self.planner.plan(shown)[:, None]
        return np.where((obs.step < obs.sensor.steps_delayed(obs.dt))[:, None, None], 0.0, commands)


def planner(name: str, weights: str | None = None) -> FilteredPlanner:
    """Make the planner.

    Args:
        name: The planner behind the filter.
        weights: Its trained network; None for its default.

    Returns:
        The planner.
    """
    return FilteredPlanner(load_planner(name, {} if weights is None else {"weights": weights}))
