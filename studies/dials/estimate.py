"""The level of a dial up to which a planner succeeds, with an interval, from outcomes at some levels.

Success does not rise with the level. So the rates are fitted by isotonic regression, weighted by cases (Ayer et al.
1955), and the level is where the fit crosses the wanted rate, interpolated on the scale of log odds. Levels are counted
from 0 here.

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

WANTED, HALF = 0.9, 0.5
"""The success rate that defines the figure of a dial, and the rate that is reported beside it."""

AROUND = 3
"""Levels of the second stage."""

RESAMPLES = 2000
SIGNIFICANT = 0.01
"""Significance level of a rise of success with the level: after a significant rise, a dial has no figure."""

_SEED = 0
"""Seed of the bootstrap: the same cases are resampled for every planner, so that differences are paired."""

First = Bool[np.ndarray, "level case"]
Second = Mapping[int, Bool[np.ndarray, "other_case"]]
"""Successes of a planner: at all levels in the cases of the first stage, and by level in the second stage."""

Rates = Float[np.ndarray, "*resample level"]
Counts = Int[np.ndarray, "*#resample level"]
"""Success rates, and their numbers of cases."""


@dataclasses.dataclass(frozen=True)
class Crossing:
    """The level at which success crosses a rate.

    Attributes:
        level: The level; -inf if success is below the rate at all levels, inf if at none.
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
    """Fit of the outcomes of a planner.

    Attributes:
        cases: The number of cases driven at each level.
        success: The success rate at each level.
        fitted: The isotonic fit, which does not rise.
        p_rising: The p-value of the rise of success, if the fit is the truth.
        wanted: The crossing of `WANTED`.
        half: The crossing of `HALF`.
    """

    cases: Int[np.ndarray, "level"]
    success: Float[np.ndarray, "level"]
    fitted: Float[np.ndarray, "level"]
    p_rising: float
    wanted: Crossing
    half: Crossing

    @property
    def is_monotone(self) -> bool:
        """True if success does not rise significantly with the level, so that the dial has a figure."""
        return self.p_rising >= SIGNIFICANT


def levels_around(first: First) -> list[int]:
    """Return the levels of the second stage: the nearest to the crossing of `WANTED` in the first stage."""
    return np.flatnonzero(_around(first.mean(axis=1), np.full(len(first), first.shape[1]))).tolist()


def fit(first: First, second: Second) -> Fit:
    """Fit the outcomes of both stages.

    Args:
        first: See `First`.
        second: See `Second`; the levels are the return value of `levels_around`.
    """
    draws, levels = np.random.default_rng(_SEED), len(first)
    pools = [second.get(level, first[level]) for level in range(levels)]
    is_second, most = np.isin(np.arange(levels), list(second)), max(map(len, second.values()), default=0)
    cases, successes = first.shape[1] + most * is_second, first.sum(axis=1) + [*map(np.sum, pools)] * is_second
    success = successes / cases
    fitted = _not_rising(success, cases)

    one = first[:, draws.integers(first.shape[1], size=(RESAMPLES, first.shape[1]))].sum(axis=2).T
    again, coins = draws.random((RESAMPLES, most)), draws.random((RESAMPLES, levels)) < 0.5
    two = np.stack([_draw(pool, again, coin) for pool, coin in zip(pools, coins.T, strict=True)], axis=1)
    around = _around(one / first.shape[1], np.full(levels, first.shape[1]))
    count = first.shape[1] + most * around
    again_fitted = _not_rising((one + two * around) / count, count)
    wanted, half = (
        Crossing(float(_cross(fitted, cases, rate)), *_interval(each), each)
        for rate, each in ((rate, _cross(again_fitted, count, rate)) for rate in (WANTED, HALF))
    )
    # The probability of such a rise of success if the fit were the truth.
    rising = _rise((one + two * is_second) / cases + fitted - success, cases) >= _rise(success, cases)
    return Fit(cases, success, fitted, float(rising.mean()), wanted, half)


def difference(one: Crossing, other: Crossing) -> tuple[float, float, float]:
    """Return the difference of the levels that two planners hold, with the 95 % interval of the paired bootstrap.

    NaN if one of them has no level, or none in some resample.
    """
    if not (np.isfinite(one.resampled).all() and np.isfinite(other.resampled).all()):
        return math.nan, math.nan, math.nan
    return one.level - other.level, *_interval(one.resampled - other.resampled)


def _draw(
    outcomes: Bool[np.ndarray, "case"], where: Float[np.ndarray, "resample draw"], coin: Bool[np.ndarray, "resample"]
) -> Int[np.ndarray, "resample"]:
    """Return the number of successes among outcomes, drawn with replacement.

    The draws include one more, random outcome: otherwise outcomes without a failure would have none in any resample.
    """
    case = (where * (len(outcomes) + 1)).astype(np.int64)
    return np.asarray((np.append(outcomes, False)[case] | ((case == len(outcomes)) & coin[:, None])).sum(axis=1))


def _around(success: Rates, cases: Counts) -> Bool[np.ndarray, "*resample level"]:
    """Return which levels are nearest to the crossing of `WANTED`."""
    number = np.arange(success.shape[-1])
    level = np.clip(_cross(_not_rising(success, cases), cases, WANTED), 0.0, number[-1])
    away = np.abs(number - level[..., None])
    return away.argsort(axis=-1, kind="stable").argsort(axis=-1, kind="stable") < AROUND


def _not_rising(success: Rates, cases: Counts) -> Rates:
    """Return the isotonic regression of rates, weighted by cases."""
    rates, numbers = np.atleast_2d(success), np.broadcast_to(cases, success.shape).reshape(-1, success.shape[-1])
    rows = zip(rates, numbers, strict=True)
    fits = [isotonic_regression(rate, weights=number, increasing=False).x for rate, number in rows]
    return np.reshape(fits, success.shape)


def _rise(success: Rates, cases: Counts) -> Float[np.ndarray, "*resample"]:
    """Return the rise of rates: their squared distance from their isotonic regression, weighted by cases."""
    return np.asarray((cases * (success - _not_rising(success, cases)) ** 2).sum(axis=-1))


def _cross(fitted: Rates, cases: Counts, wanted: float) -> Float[np.ndarray, "*resample"]:
    """Return the level at which non-rising rates cross a rate; infinite if they do not."""
    solved = (fitted >= wanted).sum(axis=-1)
    # With half a success and half a failure more, since the log odds of 0 and of 1 are infinite (Haldane 1956).
    odds = np.log((fitted * cases + 0.5) / ((1.0 - fitted) * cases + 0.5)) - math.log(wanted / (1.0 - wanted))
    last = np.clip(solved - 1, 0, fitted.shape[-1] - 2)
    before, after = (np.take_along_axis(odds, each[..., None], axis=-1)[..., 0] for each in (last, last + 1))
    part = np.clip(before / np.where(before > after, before - after, 1.0), 0.0, 1.0)
    level = np.where(solved == fitted.shape[-1], np.inf, last + part)
    return np.asarray(np.where(solved == 0, -np.inf, level))


def _interval(levels: Float[np.ndarray, "resample"]) -> tuple[float, float]:
    """Return the bounds between which 95 % of the levels lie; levels may be infinite, so that none is interpolated."""
    low, high = np.quantile(levels, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], method="inverted_cdf")
    return float(low), float(high)
