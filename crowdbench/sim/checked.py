"""What a pedestrian policy may return: type, shape and finite numbers. The simulator checks every answer here."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.types import World


def shaped(answer: object, name: str, world: World) -> Float[np.ndarray, "world pedestrian 2"]:
    """Check type and shape of what a policy returned.

    Args:
        answer: What `velocities` returned.
        name: What the policy is called in errors.
        world: What it was given.

    Returns:
        The velocities in m/s.

    Raises:
        InputError: It is no float64 array with a velocity per pedestrian.
    """
    expected = (len(world), world.position.shape[1] - 1, 2)
    if isinstance(answer, np.ndarray) and answer.shape == expected and answer.dtype == np.float64:
        return np.asarray(answer)  # a subclass may answer otherwise than its numbers
    found = f"{answer.dtype} of shape {answer.shape}" if isinstance(answer, np.ndarray) else repr(answer)
    raise InputError(f"pedestrian policy {name} returned {found}, but must return float64 of shape {expected}")


def finite(
    velocity: Float[np.ndarray, "world pedestrian 2"], name: str, world: World
) -> Float[np.ndarray, "world pedestrian 2"]:
    """Check that velocities are finite.

    Args:
        velocity: What a policy returned, in m/s.
        name: What the policy is called in errors.
        world: What it was given.

    Returns:
        The velocities.

    Raises:
        InputError: That of a pedestrian who is present is not finite.
    """
    # A sum is finite only if all its terms are, and takes half the time of a test of each.
    if not math.isfinite(velocity.sum()) and len(
        wrong := np.argwhere(~np.isfinite(velocity).all(axis=2) & world.present[:, 1:])
    ):
        row, pedestrian = wrong[0]
        raise InputError(
            f"pedestrian policy {name} returned {velocity[row, pedestrian].tolist()} for pedestrian {pedestrian} "
            f"of case {world.case[row]}, but a velocity must be finite"
        )
    return velocity
