"""Features of the motion of persons, and the bins of their histograms. See definition.md."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core import norm
from crowdbench.scenario import ETH_UCY_DT
from studies.people.encounters import Places
from studies.people.windows import HISTORY, Window

BINS = 20
"""Number of bins of a feature; one more is for an undefined value."""

RANGES: Mapping[str, tuple[float, float]] = {
    "speed": (0.0, 3.0),
    "acceleration": (-4.2, 3.8),
    "turning": (-3.15, 2.85),
    "along": (-0.5, 2.5),
    "lateral": (-1.05, 0.95),
    "closest": (0.0, 4.0),
    "rim": (0.0, 6.0),
    "time to collision": (0.0, 6.0),
}
"""Bounds of the bins of each feature; values beyond belong to the first or the last bin. 0 is in the middle of a bin of
acceleration, turning and lateral velocity: at a bound, rounding would decide about those who walk straight."""

TURNS = 0.3
"""Speed in m/s of both steps, below which a change of direction is undefined."""

CONTACT = 0.4
"""Distance in metres of two persons in contact: twice a radius of 0.2 m."""

PerFrame = Float[np.ndarray, "rollout frame person"]


def per_frame(window: Window, places: Places) -> dict[str, PerFrame]:
    """Return the features of each frame after the start: motion and path; NaN if undefined.

    Args:
        window: The window.
        places: Its rollouts, or the recording as the only one.
    """
    past = np.broadcast_to(window.position[HISTORY - 1], (len(places), 1, *places.shape[2:]))
    velocity = np.diff(np.concatenate([past, places], axis=1), axis=1) / ETH_UCY_DT
    speed = norm(velocity)
    before, after = velocity[:, :-1], velocity[:, 1:]
    cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    turn = np.arctan2(cross, (before * after).sum(axis=-1)) / ETH_UCY_DT
    walks = np.minimum(speed[:, :-1], speed[:, 1:]) >= TURNS
    time = ETH_UCY_DT * np.arange(1, places.shape[1])
    mean = (places[:, 1:] - places[:, :1]) / time[:, None, None]
    ahead = window.heading
    return {
        "speed": speed[:, 1:],
        "acceleration": np.diff(speed, axis=1) / ETH_UCY_DT,
        "turning": np.where(walks, turn, np.nan),
        "along": (mean * ahead).sum(axis=-1),
        "lateral": ahead[:, 0] * mean[..., 1] - ahead[:, 1] * mean[..., 0],
    }


def bins_of(feature: str, values: Float[np.ndarray, "*shape"]) -> Int[np.ndarray, "*shape"]:
    """Return the bin of each value, from 0; `BINS` for values that are not finite."""
    low, high = RANGES[feature]
    position = np.where(np.isfinite(values), values, low)
    inside = np.clip(np.floor((position - low) / (high - low) * BINS), 0, BINS - 1).astype(np.int64)
    return np.where(np.isfinite(values), inside, BINS)
