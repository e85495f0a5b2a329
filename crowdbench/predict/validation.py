"""What a predictor may return: dtype, shape and finite numbers. Whoever calls `predict` checks its answer here."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Observation
from crowdbench.predict.base import Prediction
from crowdbench.utils.errors import InputError


def validate_prediction(answer: object, name: str, obs: Observation, steps: int) -> Prediction:
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
    return validate_numbers(validate_shape(answer, name, obs, steps), name, obs)


def validate_shape(answer: object, name: str, obs: Observation, steps: int) -> Prediction:
    """Check type and shape alone, as `validate_prediction` does; numbers may still not be finite."""
    if not isinstance(answer, Prediction):
        raise InputError(f"predictor {name} returned a {type(answer).__name__} instead of a Prediction")
    worlds, pedestrians = obs.pedestrians.seen.shape
    plain = []
    for what, array in (("positions", answer.position), ("velocities", answer.velocity)):
        if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
            raise InputError(f"predictor {name} returned {what} that are not an array of floats")
        # Without a mask or the methods of a subclass, which could hide what is not finite.
        values = np.asarray(array)
        modes = values.shape[1:2]
        if values.shape != (worlds, *modes, steps, pedestrians, 2) or modes == (0,):
            raise InputError(
                f"predictor {name} returned {what} of shape {list(values.shape)}, but they must be "
                f"[world, mode, time, pedestrian, 2] with {worlds} worlds, {steps} steps and {pedestrians} pedestrians"
            )
        plain.append(values)
    position, velocity = plain
    if position.shape != velocity.shape:
        raise InputError(
            f"predictor {name} returned positions in {position.shape[1]} modes and velocities in {velocity.shape[1]}, "
            "but each mode must have both"
        )
    return Prediction(position, velocity)


def validate_numbers(prediction: Prediction, name: str, obs: Observation) -> Prediction:
    """Check the numbers of a prediction of the right shape alone, as `validate_prediction` does."""
    return Prediction(
        _finite(f"predictor {name} returned positions", prediction.position, obs),
        _finite(f"predictor {name} returned velocities", prediction.velocity, obs),
    )


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
