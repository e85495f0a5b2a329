"""What foresees the pedestrians' motion."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench.types import Observation


@dataclass(frozen=True)
class Prediction:
    """The pedestrians' positions in metres and velocities in m/s; time index 0 is the next step, one dt ahead.

    Each mode is one possible future of the whole crowd. What is said of absent pedestrians is finite but means
    nothing.
    """

    position: Float[np.ndarray, "world mode time pedestrian 2"]
    velocity: Float[np.ndarray, "world mode time pedestrian 2"]


class Predictor(abc.ABC):
    """Predicts the pedestrians in every world of a batch. Complete once it is constructed."""

    privileged: ClassVar[bool] = False
    """Whether it calls `Observation.true_next`: a planner that uses it must be privileged too."""

    facts: Mapping[str, str] = MappingProxyType({})
    """What results say of it beyond its name and options, such as the digest of its weights."""

    @abc.abstractmethod
    def predict(self, obs: Observation, steps: int) -> Prediction:
        """The next `steps` steps of every pedestrian, `obs.dt` apart."""

    def unseen(self, scene: str) -> Predictor:
        """The predictor to be scored on a recorded scene: one that was not trained on it."""
        return self


def straight_on(
    start: Float[np.ndarray, "world pedestrian 2"],
    velocity: Float[np.ndarray, "world mode pedestrian 2"],
    dt: float,
    steps: int,
) -> Prediction:
    """The futures in which everybody goes on from `start` (metres) with the constant `velocity` (m/s) of the mode."""
    elapsed = dt * np.arange(1, steps + 1)[:, None, None]
    position = start[:, None, None] + elapsed * velocity[:, :, None]
    return Prediction(position, np.repeat(velocity[:, :, None], steps, axis=2))
