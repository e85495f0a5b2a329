"""A Kalman filter of points that move at constant velocity with white acceleration (Bar-Shalom et al. 2001).

Both axes have the same covariance: the variance p of the position, the covariance c, and the variance v of the
velocity. The functions take numbers or arrays; their compiled forms take numbers.
"""

from __future__ import annotations

from typing import Any

from crowdbench.utils.compiled import njit

ACCELERATION = 0.1
"""Changes of the pedestrians' velocities: spectral density of white acceleration, in m^2/s^3."""


def extrapolate_covariance(p: Any, c: Any, v: Any, time: Any) -> tuple[Any, Any, Any]:
    """Return p, c and v after some seconds."""
    q = ACCELERATION * time
    return p + time * (2.0 * c + time * v) + q * time**2 / 3.0, c + time * v + q * time / 2.0, v + q


def gain(p: Any, c: Any, v: Any, position: Any, velocity: Any) -> tuple[Any, Any, Any, Any]:
    """Return the gain of a measurement, P S^-1 with S = P + R.

    Args:
        p: Variance of the position before the measurement.
        c: Covariance.
        v: Variance of the velocity.
        position: Variance of the error of a measured position.
        velocity: Variance of the error of a measured velocity.

    Returns:
        The change of the position by the error of the position and of the velocity, and of the velocity by both.
    """
    a, b = p + position, v + velocity
    determinant = a * b - c * c
    return (
        (p * b - c * c) / determinant,
        (c * a - p * c) / determinant,
        (c * b - v * c) / determinant,
        (v * a - c * c) / determinant,
    )


extrapolate_compiled, gain_compiled = njit(extrapolate_covariance), njit(gain)
