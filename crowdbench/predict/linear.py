"""Predictors that go straight on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.predict.base import Prediction, Predictor, straight_on
from crowdbench.types import Observation


class Linear(Predictor):
    """Straight on along the least-squares line through the points observed so far, 8 at most: the paper's Lin.

    Positions lie on the line, so the first does not follow from the last one seen; the velocity is the line's
    slope. A pedestrian seen only once stands still.
    """

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """One mode."""
        crowd = obs.pedestrians
        points = crowd.history.shape[1]
        time = obs.dt * np.arange(1 - points, 1)
        # Weight 0 for the points that only repeat the first: they would make everybody look slow.
        weight = (np.arange(points) >= points - crowd.observed[:, :, None]).astype(float)
        share = weight / np.maximum(weight.sum(axis=2, keepdims=True), 1.0)
        mean_time = (share * time).sum(axis=2, keepdims=True)
        offset = weight * (time - mean_time)
        spread = (offset**2).sum(axis=2, keepdims=True)
        slope = np.divide(offset, spread, out=np.zeros_like(offset), where=spread > 0.0)
        velocity, mean = (_weighted_sum(each, crowd.history) for each in (slope, share))
        return straight_on(mean - velocity * mean_time, velocity[:, None], obs.dt, steps)


class ConstantVelocity(Predictor):
    """Straight on with the velocity of the last step: CVM (Schöller et al. 2020).

    A pedestrian seen only once stands still.
    """

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """One mode."""
        return straight_on(obs.pedestrians.history[:, -1], last_velocity(obs)[:, None], obs.dt, steps)


class ConstantVelocitySampled(Predictor):
    """Straight on with the velocity of the last step, turned at random: CVM-S (Schöller et al. 2020).

    In each of `modes` futures every pedestrian turns by an angle of its own, whose standard deviation is `angle`
    degrees. A pedestrian seen only once stands still. Raises InputError where it has no modes, or `angle` is negative
    or infinite.
    """

    def __init__(self, modes: int = 20, angle: float = 25.0) -> None:
        if not isinstance(modes, int) or modes < 1:
            raise InputError(f"modes is {modes!r}, but must be a whole number, 1 or more")
        if not isinstance(angle, int | float) or not 0.0 <= angle < np.inf:
            raise InputError(f"angle is {angle!r}, but must be a number of degrees, 0 or more")
        self.modes = modes
        self.angle = np.radians(angle)

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """As many modes as it was made with, all of them random."""
        turn = self.angle * obs.normal("constant_velocity_sampled", self.modes).transpose(0, 2, 1)
        x, y = np.moveaxis(last_velocity(obs)[:, None], -1, 0)
        turned = np.stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)], axis=-1)
        return straight_on(obs.pedestrians.history[:, -1], turned, obs.dt, steps)


def _weighted_sum(
    weight: Float[np.ndarray, "world pedestrian time"], history: Float[np.ndarray, "world time pedestrian 2"]
) -> Float[np.ndarray, "world pedestrian 2"]:
    """The sum over time of weighted positions."""
    # Not by matrix products, whose last bits depend on how many worlds there are.
    return (np.ascontiguousarray(weight.swapaxes(1, 2))[..., None] * history).sum(axis=1)


def last_velocity(obs: Observation) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocity of the last step in m/s, zero for whoever was seen only once."""
    crowd = obs.pedestrians
    moved = (crowd.history[:, -1] - crowd.history[:, -2]) / obs.dt
    return np.where(crowd.observed[:, :, None] > 1, moved, 0.0)
