"""The level of a dial up to which a planner has a mean score, with an interval, from the scores at some levels.

The mean score does not rise with the level. So the means are fitted by isotonic regression, weighted by cases (Ayer et
al. 1955), and the level is where the fit crosses the wanted score, interpolated on the scale of log odds. Levels are
counted from 0 here.

Cases are driven in two stages: few at all levels, then many at the three levels around the crossing. The bootstrap
repeats both. It resamples cases, and all levels of a case together. If a resample crosses at other levels, its second
stage includes levels without cases: there, it resamples the cases of the first stage.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import isotonic_regression

from crowdbench.metrics import CONFIDENCE

WANTED = 0.3
"""The mean score that defines the figure of a dial."""

AROUND = 3
"""Levels of the second stage."""

RESAMPLES = 2000
SIGNIFICANT = 0.01
"""Significance level of a rise of the score with the level: after a significant rise, a dial has no figure."""

_SEED = 0
"""Seed of the bootstrap: the same cases are resampled for every planner, so that differences are paired."""

First = Float[np.ndarray, "level case"]
Second = Mapping[int, Float[np.ndarray, "other_case"]]
"""Scores of a planner: at all levels in the cases of the first stage, and by level in the second stage."""

Means = Float[np.ndarray, "*resample level"]
Counts = Int[np.ndarray, "*#resample level"]
"""Mean scores, and their numbers of cases."""


@dataclasses.dataclass(frozen=True)
class Crossing:
    """The level at which the mean score crosses a score.

    Attributes:
        level: The level; -inf if the score is lower at all levels, inf if at none.
        low: The lower bound of its 95 % interval.
        high: The upper bound.
        resampled: The level in each resample; resamples of two planners are paired.
    """

    level: float
    low: float
    high: float
    resampled: Float[np.ndarray, "resample"]


@dataclasses.dataclass(frozen=True)
class Fit:
    """Fit of the scores of a planner.

    Attributes:
        cases: The number of cases driven at each level.
        score: The mean score at each level.
        bounds: The lower and the upper bound of its 95 % interval.
        fitted: The isotonic fit, which does not rise.
        p_rising: The p-value of the rise of the score, if the fit is the truth.
        wanted: The crossing of `WANTED`.
    """

    cases: Int[np.ndarray, "level"]
    score: Float[np.ndarray, "level"]
    bounds: Float[np.ndarray, "2 level"]
    fitted: Float[np.ndarray, "level"]
    p_rising: float
    wanted: Crossing

    @property
    def is_monotone(self) -> bool:
        """True if the score does not rise significantly with the level, so that the dial has a figure."""
        return self.p_rising >= SIGNIFICANT


def levels_around(first: First) -> list[int]:
    """Return the levels of the second stage: the nearest to the crossing of `WANTED` in the first stage."""
    return np.flatnonzero(_around(first.mean(axis=1), np.full(len(first), first.shape[1]))).tolist()


def fit(first: First, second: Second) -> Fit:
    """Fit the scores of both stages.

    Args:
        first: See `First`.
        second: See `Second`; the levels are the return value of `levels_around`.
    """
    draws, levels = np.random.default_rng(_SEED), len(first)
    pools = [second.get(level, first[level]) for level in range(levels)]
    is_second, most = np.isin(np.arange(levels), list(second)), max(map(len, second.values()), default=0)
    cases, total = first.shape[1] + most * is_second, first.sum(axis=1) + [*map(np.sum, pools)] * is_second
    score = total / cases
    fitted = _not_rising(score, cases)

    one = first[:, draws.integers(first.shape[1], size=(RESAMPLES, first.shape[1]))].sum(axis=2).T
    again, coins = draws.random((RESAMPLES, most)), draws.random((RESAMPLES, levels)) < 0.5
    two = np.stack([_draw(pool, again, coin) for pool, coin in zip(pools, coins.T, strict=True)], axis=1)
    around = _around(one / first.shape[1], np.full(levels, first.shape[1]))
    count = first.shape[1] + most * around
    resampled = _cross(_not_rising((one + two * around) / count, count), count)
    wanted = Crossing(float(_cross(fitted, cases)), *_interval(resampled), resampled)
    means = (one + two * is_second) / cases
    # The probability of such a rise of the score if the fit were the truth.
    rising = _rise(means + fitted - score, cases) >= _rise(score, cases)
    bounds = np.array([_interval(each) for each in means.T]).T
    return Fit(cases, score, bounds, fitted, float(rising.mean()), wanted)


def difference(one: Crossing, other: Crossing) -> tuple[float, float, float]:
    """Return the difference of the levels that two planners hold, with the 95 % interval of the paired bootstrap.

    NaN if one of them has no level, or none in some resample.
    """
    if not (np.isfinite(one.resampled).all() and np.isfinite(other.resampled).all()):
        return math.nan, math.nan, math.nan
    return one.level - other.level, *_interval(one.resampled - other.resampled)


def _draw(
    scores: Float[np.ndarray, "case"], where: Float[np.ndarray, "resample draw"], coin: Bool[np.ndarray, "resample"]
) -> Float[np.ndarray, "resample"]:
    """Return the sum of scores, drawn with replacement.

    The draws include one more score, 0 or 1 at random: otherwise cases of equal scores would have no variance.
    """
    case = (where * (len(scores) + 1)).astype(np.int64)
    return np.where(case == len(scores), coin[:, None], np.append(scores, 0.0)[case]).sum(axis=1)


def _around(score: Means, cases: Counts) -> Bool[np.ndarray, "*resample level"]:
    """Return which levels are nearest to the crossing of `WANTED`."""
    number = np.arange(score.shape[-1])
    level = np.clip(_cross(_not_rising(score, cases), cases), 0.0, number[-1])
    away = np.abs(number - level[..., None])
    return away.argsort(axis=-1, kind="stable").argsort(axis=-1, kind="stable") < AROUND


def _not_rising(score: Means, cases: Counts) -> Means:
    """Return the isotonic regression of mean scores, weighted by cases."""
    means, numbers = np.atleast_2d(score), np.broadcast_to(cases, score.shape).reshape(-1, score.shape[-1])
    rows = zip(means, numbers, strict=True)
    fits = [isotonic_regression(mean, weights=number, increasing=False).x for mean, number in rows]
    return np.reshape(fits, score.shape)


def _rise(score: Means, cases: Counts) -> Float[np.ndarray, "*resample"]:
    """Return the rise of mean scores: their squared distance from their isotonic regression, weighted by cases."""
    return np.asarray((cases * (score - _not_rising(score, cases)) ** 2).sum(axis=-1))


def _cross(fitted: Means, cases: Counts) -> Float[np.ndarray, "*resample"]:
    """Return the level at which non-rising mean scores cross `WANTED`; infinite if they do not."""
    solved = (fitted >= WANTED).sum(axis=-1)
    # With half a case of score 1 and half a case of score 0 more, since log odds can be infinite (Haldane 1956).
    odds = np.log((fitted * cases + 0.5) / ((1.0 - fitted) * cases + 0.5)) - math.log(WANTED / (1.0 - WANTED))
    last = np.clip(solved - 1, 0, fitted.shape[-1] - 2)
    before, after = (np.take_along_axis(odds, each[..., None], axis=-1)[..., 0] for each in (last, last + 1))
    part = np.clip(before / np.where(before > after, before - after, 1.0), 0.0, 1.0)
    level = np.where(solved == fitted.shape[-1], np.inf, last + part)
    return np.asarray(np.where(solved == 0, -np.inf, level))


def _interval(levels: Float[np.ndarray, "resample"]) -> tuple[float, float]:
    """Return the bounds between which 95 % of the levels lie; levels may be infinite, so that none is interpolated."""
    low, high = np.quantile(levels, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], method="inverted_cdf")
    return float(low), float(high)
