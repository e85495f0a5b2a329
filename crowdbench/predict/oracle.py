"""A predictor that looks into the simulator."""

from __future__ import annotations

from typing import ClassVar

from crowdbench.predict.base import Prediction, Predictor, straight_on
from crowdbench.types import Observation


class Oracle(Predictor):
    """The true next step of the simulator, and straight on from there: shows what perfect foresight is worth."""

    privileged: ClassVar[bool] = True

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """One mode. Raises PermissionError where the observation does not show the future."""
        return straight_on(obs.pedestrians.position, obs.true_next()[:, None], obs.dt, steps)
