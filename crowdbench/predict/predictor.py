"""The interface of predictors, models of the pedestrians' future motion, and the check of what they return."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench.core.arrays import WorldPaths
from crowdbench.core.types import Observation
from crowdbench.utils.errors import InputError


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
    """Base class of predictors, which predict the pedestrians in every world of a batch."""

    privileged: ClassVar[bool] = False
    """True if it calls `Observation.true_next`. A planner that uses it must be privileged too."""

    facts: Mapping[str, str] = MappingProxyType({})
    """Further facts for results, such as the digest of its weights."""

    @abc.abstractmethod
    def predict(self, obs: Observation, steps: int) -> Prediction:
        """Predict all pedestrians.

        Args:
            obs: The observation of every world.
            steps: Number of steps to predict, each of `obs.dt` seconds.
        """

    def predict_given(self, obs: Observation, steps: int, plan: WorldPaths) -> Prediction:
        """Predict all pedestrians, given the future commands of the vehicle.

        Args:
            obs: The observation of every world.
            steps: Number of steps to predict.
            plan: The commands of the vehicle in these steps, in the format of its dynamics.

        Returns:
            The futures. By default the result of `predict`, in which pedestrians do not react to the commands.
        """
        return self.predict(obs, steps)

    def for_held_out_scene(self, scene: str) -> Predictor:
        """Return the predictor for a recorded scene: one that was not trained on it."""
        return self


def predict(predictor: Predictor, obs: Observation, steps: int, plan: WorldPaths | None = None) -> Prediction:
    """Predict all pedestrians, and check the prediction.

    Args:
        obs: The observation of every world.
        steps: Number of steps to predict.
        plan: The commands of the vehicle in these steps, for `Predictor.predict_given`; None if unknown.

    Raises:
        InputError: See `validate_prediction`.
    """
    answer = predictor.predict(obs, steps) if plan is None else predictor.predict_given(obs, steps, plan)
    return validate_prediction(answer, type(predictor).__name__, obs, steps)


def validate_prediction(answer: object, name: str, obs: Observation, steps: int) -> Prediction:
    """Check the return value of a predictor.

    Args:
        answer: The return value of `predict`.
        name: Name of the predictor in error messages.
        obs: The observation that the predictor received.
        steps: The requested number of steps.

    Returns:
        The prediction as plain arrays; non-finite values of pedestrians that are not seen are replaced by 0.

    Raises:
        InputError: It is not a prediction, has another shape, or is not finite for a pedestrian that is seen.
    """
    if not isinstance(answer, Prediction):
        raise InputError(f"predictor {name} returned a {type(answer).__name__} instead of a Prediction")
    worlds, pedestrians = obs.pedestrians.seen.shape
    checked = []
    for quantity, array in {"positions": answer.position, "velocities": answer.velocity}.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
            raise InputError(f"predictor {name} returned {quantity} that are not an array of floats")
        # Without a mask or the methods of a subclass, which could hide non-finite values.
        values = np.asarray(array)
        shape = values.shape
        if shape != (worlds, *shape[1:2], steps, pedestrians, 2) or shape[1] == 0:
            raise InputError(
                f"predictor {name} returned {quantity} of shape {list(shape)}, but they must be "
                f"[world, mode, time, pedestrian, 2] with {worlds} worlds, {steps} steps and {pedestrians} pedestrians"
            )
        finite = np.isfinite(values)
        if not finite.all():
            wrong = ~finite.all(axis=4) & obs.pedestrians.seen[:, None, None]
            for world, mode, time, pedestrian in np.argwhere(wrong)[:1].tolist():
                raise InputError(
                    f"predictor {name} returned {quantity} that are not finite: "
                    f"{values[world, mode, time, pedestrian].tolist()} for pedestrian {pedestrian} {time + 1} steps "
                    f"ahead in mode {mode} (row {world} of the batch, step {obs.step[world]})"
                )
            values = np.where(finite, values, 0.0)
        checked.append(values)
    position, velocity = checked
    if position.shape != velocity.shape:
        raise InputError(
            f"predictor {name} returned positions in {position.shape[1]} modes and velocities in "
            f"{velocity.shape[1]}, but each mode must have both"
        )
    return Prediction(position, velocity)
