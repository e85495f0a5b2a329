"""The commands that a lookahead chooses from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

SPEEDS = 5
HEADINGS = 16


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
