"""Predictors in which pedestrians keep a constant velocity."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench.core.arrays import Vectors
from crowdbench.core.types import Observation
from crowdbench.predict.predictor import Prediction, Predictor
from crowdbench.utils.errors import require, require_count


class Linear(Predictor):
    """The least-squares line through the last 8 observed positions: Lin (Li et al. 2020).

    Predicted positions lie on the line; the last observed position may be off it. The velocity is the slope of the
    line. A pedestrian that was observed once stands still. Positions that were filled in are used only if fewer than
    two of the last 8 were observed.
    """

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`. There is one mode."""
        crowd = obs.pedestrians
        points = crowd.history.shape[1]
        time = obs.dt * np.arange(1 - points, 1)
        # 0 before the first observation, because the positions there only repeat it and would lower the speed.
        weight = (np.arange(points) >= points - crowd.observed[:, :, None]).astype(float)
        if crowd.filled is not None:
            measured = weight * ~crowd.filled.swapaxes(1, 2)
            weight = np.where(measured.sum(axis=2, keepdims=True) > 1.0, measured, weight)
        mean_weight = weight / np.maximum(weight.sum(axis=2, keepdims=True), 1.0)
        mean_time = (mean_weight * time).sum(axis=2, keepdims=True)
        deviation = weight * (time - mean_time)
        variance = (deviation**2).sum(axis=2, keepdims=True)
        slope_weight = np.divide(deviation, variance, out=np.zeros_like(deviation), where=variance > 0.0)
        # Without matrix products, whose last bits depend on the number of worlds.
        weights = [np.ascontiguousarray(weight.swapaxes(1, 2))[..., None] for weight in (slope_weight, mean_weight)]
        velocity, mean = ((weight * crowd.history).sum(axis=1) for weight in weights)
        return _extrapolate(mean - velocity * mean_time, velocity[:, None], obs, steps)


class ConstantVelocity(Predictor):
    """The velocity of the last step: the constant velocity model, CVM (Schöller et al. 2020).

    Tracks keep their estimated velocity. A pedestrian that was observed once stands still.
    """

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`. There is one mode."""
        return _extrapolate(obs.pedestrians.history[:, -1], last_velocity(obs)[:, None], obs, steps)


class ConstantVelocitySampled(Predictor):
    """The velocity of the last step, turned by random angles: CVM-S (Schöller et al. 2020).

    In each future, each pedestrian turns once, by an independent, normally distributed angle. A pedestrian that was
    observed once stands still.

    Args:
        modes: Number of futures [1].
        angle: Standard deviation of the angle [degrees].

    Raises:
        InputError: `modes` is not a whole number, 1 or more, or `angle` is negative or infinite.
    """

    def __init__(self, modes: int = 20, angle: float = 25.0) -> None:
        require_count("modes", modes)
        good = isinstance(angle, int | float) and 0.0 <= angle < np.inf
        require("angle", angle, good, "a number of degrees, 0 or more")
        self.modes = modes
        self.angle = np.radians(angle)

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`. There are `modes` modes, all of them random."""
        turn = self.angle * obs.noise("constant_velocity_sampled", (self.modes, obs.pedestrians.seen.shape[1]))
        x, y = np.moveaxis(last_velocity(obs)[:, None], -1, 0)
        turned = np.stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)], axis=-1)
        return _extrapolate(obs.pedestrians.history[:, -1], turned, obs, steps)


class Oracle(Predictor):
    """The true velocity of the next step, extrapolated: it shows the benefit of a perfect one-step prediction."""

    privileged: ClassVar[bool] = True

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`. There is one mode. Raises PermissionError if the planner is not privileged."""
        return _extrapolate(obs.pedestrians.position, obs.true_next()[:, None], obs, steps)


def last_velocity(obs: Observation) -> Float[np.ndarray, "world pedestrian 2"]:
    """Return the velocities of the last step in m/s, zero for pedestrians that were observed once.

    The velocity of a track is its estimate. The difference of two estimated positions has a larger error.
    """
    crowd = obs.pedestrians
    if crowd.deviation is not None:
        return crowd.velocity
    moved = (crowd.history[:, -1] - crowd.history[:, -2]) / obs.dt
    return np.where(crowd.observed[:, :, None] > 1, moved, 0.0)


def _extrapolate(
    start: Vectors, velocity: Float[np.ndarray, "world mode pedestrian 2"], obs: Observation, steps: int
) -> Prediction:
    """Return the futures with constant velocities in m/s from a start in metres, a mode for each velocity."""
    elapsed = obs.dt * np.arange(1, steps + 1)[:, None, None]
    position = start[:, None, None] + elapsed * velocity[:, :, None]
    return Prediction(position, np.repeat(velocity[:, :, None], steps, axis=2))
