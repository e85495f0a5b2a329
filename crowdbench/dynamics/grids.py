"""The commands that a lookahead chooses from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

SPEEDS = 5
HEADINGS = 16

REACHED = 6
TURNS = 13
"""An odd number, so that one of them is straight ahead."""


def speeds_and_headings(preferred_speed: Float[np.ndarray, "world"]) -> Float[np.ndarray, "world action 2"]:
    """CrowdNav's 81 commands (Chen et al. 2019): standing still, and 5 speeds in each of 16 headings.

    The speeds are preferred_speed (exp(k / 5) - 1) / (e - 1), k = 1 to 5. The headings start along the x axis.

    Args:
        preferred_speed: In m/s.

    Returns:
        Commands in m/s.
    """
    speed = np.expm1(np.arange(1, SPEEDS + 1) / SPEEDS) / np.expm1(1.0)
    heading = np.arange(HEADINGS) * (2.0 * np.pi / HEADINGS)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    moving = (speed[:, None, None] * direction).reshape(-1, 2)
    return preferred_speed[:, None, None] * np.concatenate([np.zeros((1, 2)), moving])


def speeds_and_turns(
    slowest: Float[np.ndarray, "world"],
    fastest: Float[np.ndarray, "world"],
    right: Float[np.ndarray, "world"],
    left: Float[np.ndarray, "world"],
) -> Float[np.ndarray, "world action 2"]:
    """78 commands: 6 speeds and 13 turns, evenly between what a vehicle can reach in the step.

    Args:
        slowest: The lowest speed in m/s.
        fastest: The highest one.
        right: The lowest turn rate in rad/s, or steering angle in rad.
        left: The highest one.

    Returns:
        Each speed with each turn. Of the turns, the one nearest to straight ahead is straight ahead if it can be.
    """
    speed, turns = np.linspace(slowest, fastest, REACHED, axis=1), np.linspace(right, left, TURNS, axis=1)
    world, straightest = np.arange(len(turns)), np.abs(turns).argmin(axis=1)
    turns[world, straightest] = np.clip(0.0, right, left)
    return np.stack(np.broadcast_arrays(speed[:, :, None], turns[:, None]), axis=-1).reshape(len(turns), -1, 2)
