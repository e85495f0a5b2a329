"""What a predictor may return: dtype, shape and finite numbers. Whoever calls `predict` checks its answer here."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.predict.base import Prediction
from crowdbench.types import Observation


def checked(answer: object, name: str, obs: Observation, steps: int) -> Prediction:
    """Check what a predictor returned.

    Args:
        answer: What `predict` returned.
        name: What the predictor is called in errors.
        obs: What it was given.
        steps: For how many steps it was asked.

    Returns:
        The prediction as plain arrays; what is not finite for pedestrians that are not seen is 0.

    Raises:
        InputError: It is no prediction, of another shape, or not finite for a pedestrian that is seen.
    """
    return finite(shaped(answer, name, obs, steps), name, obs)


def shaped(answer: object, name: str, obs: Observation, steps: int) -> Prediction:
    """Check type and shape of what a predictor returned.

    Args:
        answer: What `predict` returned.
        name: What the predictor is called in errors.
        obs: What it was given.
        steps: For how many steps it was asked.

    Returns:
        The prediction as plain arrays.

    Raises:
        InputError: It is no prediction, or of another shape.
    """
    if not isinstance(answer, Prediction):
        raise InputError(f"predictor {name} returned a {type(answer).__name__} instead of a Prediction")
    position = _shaped(f"predictor {name} returned positions", answer.position, obs, steps)
    velocity = _shaped(f"predictor {name} returned velocities", answer.velocity, obs, steps)
    if position.shape != velocity.shape:
        raise InputError(
            f"predictor {name} returned positions in {position.shape[1]} modes and velocities in {velocity.shape[1]}, "
            "but each mode must have both"
        )
    return Prediction(position, velocity)


def finite(prediction: Prediction, name: str, obs: Observation) -> Prediction:
    """Check that a prediction is finite.

    Args:
        prediction: What a predictor returned, as plain arrays of the right shape.
        name: What the predictor is called in errors.
        obs: What it was given.

    Returns:
        The prediction; what is not finite for pedestrians that are not seen is 0.

    Raises:
        InputError: It is not finite for a pedestrian that is seen.
    """
    return Prediction(
        _finite(f"predictor {name} returned positions", prediction.position, obs),
        _finite(f"predictor {name} returned velocities", prediction.velocity, obs),
    )


def _shaped(
    returned: str, answer: object, obs: Observation, steps: int
) -> Float[np.ndarray, "world mode time pedestrian 2"]:
    if not isinstance(answer, np.ndarray) or answer.dtype.kind != "f":
        raise InputError(f"{returned} that are not an array of floats")
    # Without a mask or the methods of a subclass, which could hide what is not finite.
    values = np.asarray(answer)
    worlds, pedestrians = obs.pedestrians.seen.shape
    modes = values.shape[1:2]
    if values.shape != (worlds, *modes, steps, pedestrians, 2) or modes == (0,):
        raise InputError(
            f"{returned} of shape {list(values.shape)}, but they must be [world, mode, time, pedestrian, 2] with "
            f"{worlds} worlds, {steps} steps and {pedestrians} pedestrians"
        )
    return values


def _finite(
    returned: str, values: Float[np.ndarray, "world mode time pedestrian 2"], obs: Observation
) -> Float[np.ndarray, "world mode time pedestrian 2"]:
    numbers = np.isfinite(values)
    if numbers.all():
        return values
    wrong = ~numbers.all(axis=4) & obs.pedestrians.seen[:, None, None]
    if wrong.any():
        world, mode, time, pedestrian = np.argwhere(wrong)[0].tolist()
        raise InputError(
            f"{returned} that are not finite: {values[world, mode, time, pedestrian].tolist()} for pedestrian "
            f"{pedestrian} {time + 1} steps ahead in mode {mode} (row {world} of the batch, step {obs.step[world]})"
        )
    return np.where(numbers, values, 0.0)
