"""Enlargements of pedestrians' radii for uncertain positions."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Observation

RadiusInflation = Float[np.ndarray, "#world #time #pedestrian"]
"""Enlargements of the pedestrians' radii in metres, for uncertain future positions."""


def radius_inflation(obs: Observation, steps: int, sigma_factor: float, memory: float = np.inf) -> RadiusInflation:
    """Return `sigma_factor` standard deviations of pedestrians' positions in the next steps; 0 without a tracker.

    Args:
        obs: The observation, with standard deviations of positions and velocities if they are estimates.
        steps: Number of steps ahead.
        sigma_factor: Number of standard deviations [1].
        memory: Time in which the prediction forgets the observed velocity to 1 / e: the error of a velocity is
            forgotten with it. Infinite for predictions at constant velocity [s].
    """
    if obs.pedestrians.deviation is None:
        return np.zeros((1, 1, 1))
    position, velocity = np.moveaxis(obs.pedestrians.deviation[:, None], -1, 0)
    time = obs.dt * np.arange(1, steps + 1)[:, None]
    if np.isfinite(memory):
        time = memory * (1.0 - np.exp(-time / memory))  # the integral of exp(-t / memory)
    return sigma_factor * np.hypot(position, time * velocity)
