"""The energy distance of displacements from recorded ones (Székely and Rizzo 2013), with intervals over clips."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.geometry import norm
from crowdbench.metrics.summary import CONFIDENCE
from studies.validity.cars import Vectors, Windows, group_names

LEAST = 20
"""People whom a group must have to count."""

RESAMPLES = 400
_SEED = 0

Times = Float[np.ndarray, "resample clip"]
"""How often each clip counts."""


class Range(NamedTuple):
    """A value with its 95 % interval."""

    mean: float
    low: float
    high: float


def distance(windows: Windows, moved: Vectors) -> Range:
    """The energy distance of displacements from the recorded ones in metres, over the groups by their sizes.

    Its interval is that of a bootstrap over clips.

    Args:
        windows: The people, and how they moved.
        moved: How somebody else moved the same people.
    """
    return _with_interval(_distances(windows, moved, _everything(windows)), _distances(windows, moved, _draw(windows)))


def difference(windows: Windows, moved: Vectors, other: Vectors) -> Range:
    """By how much the energy distance of displacements is larger than that of others, paired by clip."""
    whole, drawn = (
        _distances(windows, moved, times) - _distances(windows, other, times)
        for times in (_everything(windows), _draw(windows))
    )
    return _with_interval(whole, drawn)


def _everything(windows: Windows) -> Times:
    return np.ones((1, 1 + windows.clip.max()))


def _draw(windows: Windows) -> Times:
    draws, clips = np.random.default_rng(_SEED), np.unique(windows.clips)
    times = np.zeros((RESAMPLES, 1 + windows.clip.max()))
    times[:, clips] = draws.multinomial(len(clips), np.full(len(clips), 1.0 / len(clips)), size=RESAMPLES)
    return times


def _with_interval(value: Float[np.ndarray, "1"], drawn: Float[np.ndarray, "resample"]) -> Range:
    low, high = np.quantile(drawn, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return Range(float(value[0]), float(low), float(high))


def floor(windows: Windows) -> Range:
    """The energy distance in metres between recorded people of one half of the clips and of the others.

    Returns:
        The mean over divisions of the clips, and the bounds between which 95 % of them are.
    """
    draws, clips = np.random.default_rng(_SEED), np.unique(windows.clips)
    found, groups, moved = [], counted_groups(windows), windows.moved
    for _ in range(RESAMPLES):
        half = np.isin(windows.clips, draws.permutation(clips)[: len(clips) // 2])
        found.append(sum(share * _energy(moved[own & half], moved[own & ~half]) for own, share in groups))
    return _with_interval(np.array([np.mean(found)]), np.array(found))


def counted_groups(windows: Windows) -> list[tuple[Bool[np.ndarray, "person"], float]]:
    """Who is in each group that counts, and its share."""
    each = [windows.group == number for number in range(len(group_names()))]
    each = [own for own in each if own.sum() >= LEAST]
    return [(own, own.sum() / sum(other.sum() for other in each)) for own in each]


def _distances(
    windows: Windows, moved: Vectors, times: Float[np.ndarray, "resample clip"]
) -> Float[np.ndarray, "resample"]:
    """The energy distance where each clip counts so many times. Nobody is compared with itself."""
    total = np.zeros(len(times))
    for own, share in counted_groups(windows):
        weight = times[:, windows.clips[own]]
        other = 1.0 - np.eye(own.sum())
        pairs = np.maximum(((weight @ other) * weight).sum(axis=1), 1e-9)
        real, made = windows.moved[own], moved[own]
        mixed, of_real, of_made = (
            ((weight @ (_apart(a, b) * other)) * weight).sum(axis=1) / pairs
            for a, b in ((real, made), (real, real), (made, made))
        )
        total += share * (2.0 * mixed - of_real - of_made)
    return total


def _energy(a: Vectors, b: Vectors) -> float:
    """The energy distance between two samples; 0 where one of them has fewer than two values."""
    if min(len(a), len(b)) < 2:
        return 0.0
    within = [_apart(each, each).sum() / (len(each) * (len(each) - 1)) for each in (a, b)]
    return float(2.0 * _apart(a, b).mean() - sum(within))


def _apart(a: Vectors, b: Vectors) -> Float[np.ndarray, "one other"]:
    return norm(a[:, None] - b)
