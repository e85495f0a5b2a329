"""Features of the motion of persons, and the bins of their histograms. See definition.md."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core import norm
from crowdbench.scenario import ETH_UCY_DT
from studies.people.windows import BLOCK, FUTURE, HISTORY, NEAR, Window

BINS = 20
"""Number of bins of a feature; one more is for an undefined value."""

RANGES: Mapping[str, tuple[float, float]] = {
    "speed": (0.0, 2.5),
    "acceleration": (-2.0, 2.0),
    "turning": (-2.0, 2.0),
    "along": (-0.5, 2.5),
    "lateral": (-1.0, 1.0),
    "closest": (0.0, 4.0),
}
"""Bounds of the bins of each feature; values beyond belong to the first or the last bin."""

TURNS = 0.3
"""Speed in m/s of both steps, below which a change of direction is undefined."""

CONTACT = 0.4
"""Distance in metres of two persons in contact: twice a radius of 0.2 m."""

Places = Float[np.ndarray, "rollout time person 2"]
"""Positions of persons from the start on, in metres; NaN for absent persons."""

PerFrame = Float[np.ndarray, "rollout frame person"]
PerRollout = Float[np.ndarray, "rollout person"]


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
    time = ETH_UCY_DT * np.arange(1, FUTURE + 1)
    mean = (places[:, 1:] - places[:, :1]) / time[:, None, None]
    ahead = window.heading
    return {
        "speed": speed[:, 1:],
        "acceleration": np.diff(speed, axis=1) / ETH_UCY_DT,
        "turning": np.where(walks, turn, np.nan),
        "along": (mean * ahead).sum(axis=-1),
        "lateral": ahead[:, 0] * mean[..., 1] - ahead[:, 1] * mean[..., 0],
    }


def closest_approach(window: Window, places: Places, persons: Bool[np.ndarray, "all"]) -> PerRollout:
    """Return each person's closest approach to strangers that are farther than `NEAR` when both are first present.

    Between frames, motion is straight.

    Args:
        window: The window.
        places: Its rollouts, or the recording as the only one.
        persons: The persons to return.

    Returns:
        Distances in metres; infinite if there is no such stranger.
    """
    apart = places[:, :, None] - places[:, :, persons][:, :, :, None]
    distance = norm(apart)
    first = np.isfinite(distance).argmax(axis=1)[:, None]
    is_apart = np.take_along_axis(distance, first, axis=1)[:, 0] > NEAR
    begin, motion = apart[:, :-1], np.diff(apart, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.clip(-(begin * motion).sum(axis=-1) / (motion**2).sum(axis=-1), 0.0, 1.0)
    between = norm(begin + np.nan_to_num(share)[..., None] * motion)
    # A pair that is together in a single frame has no step.
    least = np.minimum(_least(between), _least(distance))
    counts = is_apart & window.strangers[persons]
    return np.where(counts, least, np.inf).min(axis=-1)


def _least(distance: Float[np.ndarray, "rollout time person other"]) -> Float[np.ndarray, "rollout person other"]:
    return np.where(np.isnan(distance), np.inf, distance).min(axis=1)


def bins_of(feature: str, values: Float[np.ndarray, "*shape"]) -> Int[np.ndarray, "*shape"]:
    """Return the bin of each value, from 0; `BINS` for values that are not finite."""
    low, high = RANGES[feature]
    position = np.where(np.isfinite(values), values, low)
    inside = np.clip(np.floor((position - low) / (high - low) * BINS), 0, BINS - 1).astype(np.int64)
    return np.where(np.isfinite(values), inside, BINS)


def blocks() -> Int[np.ndarray, "frame"]:
    """Return the number of the block of each frame after the start."""
    return np.arange(FUTURE) // BLOCK
