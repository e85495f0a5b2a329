"""A predictor that knows the next step of the simulator."""

from __future__ import annotations

from typing import ClassVar

from crowdbench.predict.base import Prediction, Predictor, straight_on
from crowdbench.types import Observation


class Oracle(Predictor):
    """The true velocity of the next step, kept constant: shows what a perfect prediction of one step is worth."""

    privileged: ClassVar[bool] = True

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`. There is one mode. Raises PermissionError where the planner is not privileged."""
        return straight_on(obs.pedestrians.position, obs.true_next()[:, None], obs.dt, steps)
