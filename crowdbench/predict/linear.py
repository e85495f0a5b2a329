"""Predictors that go straight on."""

from __future__ import annotations

import numpy as np

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
        seen = (np.arange(points) >= points - crowd.observed[:, None]).astype(float)
        share = seen / seen.sum(axis=1, keepdims=True)
        mean_time = (share * time).sum(axis=1, keepdims=True)
        offset = seen * (time - mean_time)
        spread = (offset**2).sum(axis=1, keepdims=True)
        slope = np.divide(offset, spread, out=np.zeros_like(offset), where=spread > 0.0)
        # Not by matrix products, whose last bits depend on how many worlds there are.
        velocity = (slope[:, :, None, None] * crowd.history).sum(axis=1)
        mean = (share[:, :, None, None] * crowd.history).sum(axis=1)
        return straight_on(mean - velocity * mean_time[:, :, None], velocity, obs.dt, steps)


class ConstantVelocity(Predictor):
    """Straight on with the velocity of the last step: CVM (Schöller et al. 2020).

    A pedestrian seen only once stands still.
    """

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """One mode."""
        crowd = obs.pedestrians
        moved = (crowd.history[:, -1] - crowd.history[:, -2]) / obs.dt
        velocity = np.where(crowd.observed[:, None, None] > 1, moved, 0.0)
        return straight_on(crowd.history[:, -1], velocity, obs.dt, steps)
