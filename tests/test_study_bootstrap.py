import itertools
import math

import numpy as np
import pytest

from crowdbench.evaluate.summary import RESAMPLES, bootstrap, interval
from crowdbench.study.bootstrap import two_level, two_level_reduction
from crowdbench.study.tables import plain


def test_the_bootstrap_draws_networks_and_then_cases_for_all_networks_alike():
    values = np.random.default_rng(7).normal(size=(4, 9))
    values[values > 1.0] = np.nan
    values[2] = np.nan

    def mean_of_means(rows):
        means = []
        for row in rows:
            numbers = [value for value in row if not math.isnan(value)]
            if numbers:
                means.append(sum(numbers) / len(numbers))
        return sum(means) / len(means) if means else None

    rng = np.random.default_rng(0)
    resampled = []
    for _ in range(RESAMPLES):
        networks = rng.integers(4, size=4)
        cases = rng.integers(9, size=9)
        resampled.append(mean_of_means([[values[network, case] for case in cases] for network in networks]))
    assert None in resampled
    expected = interval(np.array([value for value in resampled if value is not None]))
    found = two_level(values)
    assert (found.low, found.high) == pytest.approx(expected, abs=1e-12)
    assert found.mean == pytest.approx(mean_of_means(values))
    assert found.n == (~np.isnan(values)).sum()
    assert found.max == np.nanmax(values)


def test_the_bootstrap_is_as_wide_as_the_networks_differ():
    values = np.repeat([[0.0], [0.5], [1.0]], 50, axis=1)
    every_draw = [np.mean(draw) for draw in itertools.product([0.0, 0.5, 1.0], repeat=3)]
    found = two_level(values)
    assert (found.low, found.high) == interval(np.tile(every_draw, 100)) == (0.0, 1.0)


def test_networks_that_fail_in_the_same_cases_are_no_further_evidence():
    one = np.random.default_rng(3).random(200) < 0.8
    alone = bootstrap(one.astype(float), np.ones(200))
    together = two_level(np.tile(one.astype(float), (5, 1)))
    assert together.mean == alone.mean
    assert (together.low, together.high) == pytest.approx((alone.low, alone.high), abs=0.011)


def test_nothing_measured_gives_no_interval():
    found = two_level(np.full((2, 3), np.nan))
    assert found.n == 0
    assert math.isnan(found.mean)
    assert plain([found])[0]["low"] is None


def test_a_reduction_is_of_means_over_the_cases_that_both_have_resampled_together():
    rng = np.random.default_rng(11)
    ours, theirs = rng.uniform(1.0, 2.0, size=(2, 3, 8))
    ours[0, :5], theirs[1, 4:], theirs[2] = np.nan, np.nan, np.nan

    def reduction(networks, cases):
        means = []
        for values in (ours, theirs):
            by_network = [[values[s, c] for c in cases if not math.isnan(ours[s, c] + theirs[s, c])] for s in networks]
            by_network = [sum(row) / len(row) for row in by_network if row]
            if not by_network:
                return None
            means.append(sum(by_network) / len(by_network))
        return 1.0 - means[0] / means[1]

    rng = np.random.default_rng(0)
    resampled = [reduction(rng.integers(3, size=3), rng.integers(8, size=8)) for _ in range(RESAMPLES)]
    assert None in resampled
    found = two_level_reduction(ours, theirs)
    expected = interval(np.array([value for value in resampled if value is not None]))
    assert (found.low, found.high) == pytest.approx(expected, abs=1e-12)
    assert found.mean == pytest.approx(reduction(range(3), range(8)))
    assert found.n == 7
    assert found.max == np.nanmax(1.0 - ours / theirs)


def test_nothing_can_be_reduced_from_nothing():
    zero = np.zeros((2, 3))
    assert math.isnan(two_level_reduction(zero, zero).mean)
    assert two_level_reduction(zero, zero + np.nan).n == 0
