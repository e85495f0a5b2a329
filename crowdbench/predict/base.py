"""The interface of predictors: models of the pedestrians' future motion."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Observation


@dataclass(frozen=True)
class Prediction:
    """Predicted futures of the pedestrians. Each mode is one possible future of the whole crowd.

    Time index 0 is the next step, one time step ahead. Values of pedestrians that are not seen are finite and
    meaningless.

    Attributes:
        position: Centres in metres.
        velocity: Velocities in m/s.
    """

    position: Float[np.ndarray, "world mode time pedestrian 2"]
    velocity: Float[np.ndarray, "world mode time pedestrian 2"]


class Predictor(abc.ABC):
    """Predicts the pedestrians in every world of a batch. The base class of predictors."""

    privileged: ClassVar[bool] = False
    """Whether it calls `Observation.true_next`. A planner that uses it must be privileged too."""

    facts: Mapping[str, str] = MappingProxyType({})
    """What results record of it beside its name and options, such as the digest of its weights."""

    @abc.abstractmethod
    def predict(self, obs: Observation, steps: int) -> Prediction:
        """Predict all pedestrians.

        Args:
            obs: The observation of every world.
            steps: Number of steps to predict, each of `obs.dt` seconds.

        Returns:
            The futures.
        """

    def unseen(self, scene: str) -> Predictor:
        """The predictor to be evaluated on a recorded scene: one that was not trained on it."""
        return self


def straight_on(
    start: Float[np.ndarray, "world pedestrian 2"],
    velocity: Float[np.ndarray, "world mode pedestrian 2"],
    dt: float,
    steps: int,
) -> Prediction:
    """The futures in which all pedestrians keep a constant velocity.

    Args:
        start: Present positions in metres.
        velocity: Velocities in m/s, for each mode.
        dt: Length of a step in seconds.
        steps: Number of steps to predict.

    Returns:
        The futures, with as many modes as there are velocities.
    """
    elapsed = dt * np.arange(1, steps + 1)[:, None, None]
    position = start[:, None, None] + elapsed * velocity[:, :, None]
    return Prediction(position, np.repeat(velocity[:, :, None], steps, axis=2))
