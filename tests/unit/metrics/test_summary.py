from statistics import NormalDist

import numpy as np
import pytest

from crowdbench.metrics import summary
from crowdbench.metrics.summary import Estimate, bootstrap, by_block, rate, summarize, weighted_mean, wilson


@pytest.mark.parametrize(("hits", "n"), [(0, 10), (7, 10), (500, 500), (212, 500), (1, 1)])
def test_a_rate_has_wilsons_interval(hits, n):
    estimate = wilson(np.arange(n) < hits)
    # The rates p from which hits / n is no further than z standard errors of p (Wilson 1927).
    z = NormalDist().inv_cdf(0.975)
    rate = hits / n
    low, high = np.sort(np.roots([n + z * z, -(2 * n * rate + z * z), n * rate**2]).real)
    assert (estimate.low, estimate.high) == pytest.approx((low, high), abs=1e-12)
    assert 0.0 <= estimate.low <= estimate.mean == rate <= estimate.high <= 1.0
    assert estimate.n == n


def test_the_bootstrap_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(300):
        estimate = bootstrap(rng.exponential(1.0, 60), np.ones(60))
        hits += estimate.low <= 1.0 <= estimate.high
    assert 0.89 <= hits / 300 <= 0.98


def bootstrapped_slowly(values, weights):
    rng = np.random.default_rng(0)
    rows = rng.integers(len(values), size=(2000, len(values)))
    means = [np.average(values[row], weights=weights[row]) for row in rows]
    return np.quantile(means, [0.025, 0.975])


@pytest.mark.parametrize("n", [1, 2, 40, 1500])
def test_the_interval_is_that_of_2000_resampled_weighted_means(n, monkeypatch):
    rng = np.random.default_rng(1)
    values, weights = rng.normal(3.0, 2.0, n), rng.integers(1, 50, n).astype(float)
    found = bootstrap(values, weights)
    np.testing.assert_allclose((found.low, found.high), bootstrapped_slowly(values, weights), rtol=1e-12)
    assert found.mean == weighted_mean(values, weights)
    # However few rows are drawn at once, they are the same.
    monkeypatch.setattr(summary, "_MOST_DRAWN", 1000)
    assert bootstrap(values, weights) == found


def test_one_episode_has_an_interval_without_width():
    assert bootstrap(np.array([0.5]), np.array([3.0])) == Estimate(0.5, 0.5, 0.5, 1, 0.5)


def test_undefined_values_are_left_out_and_counted():
    estimate = bootstrap(np.array([1.0, np.nan, 3.0]), np.ones(3))
    assert (estimate.mean, estimate.n, estimate.max) == (2.0, 2, 3.0)
    assert bootstrap(np.array([np.nan]), np.ones(1)).n == 0


def test_a_pooled_metric_weighs_episodes_by_their_steps():
    columns = {"discomfort": np.array([0.0, 1.0]), "discomfort_frequency": np.array([0.0, 1.0])}
    summary = summarize(columns, np.array([30, 10]))
    assert summary["discomfort"].mean == 0.5
    assert summary["discomfort_frequency"].mean == 0.25


def test_the_same_episodes_have_the_same_interval():
    values = np.random.default_rng(1).normal(size=3000)
    assert bootstrap(values, np.ones(3000)) == bootstrap(values, np.ones(3000))


def test_rounding_leaves_no_mean_outside_its_interval():
    rates = [wilson(np.ones(n, bool)) for n in range(1, 600, 7)]
    means = [bootstrap(np.full(n, 0.7), np.arange(1.0, n + 1)) for n in range(1, 60, 7)]
    assert [each for each in rates + means if not each.low <= each.mean <= each.high] == []


def test_cases_of_the_same_block_do_not_make_an_interval_narrower():
    values = np.random.default_rng(3).uniform(size=12)
    block = np.arange(12)
    once, often = (
        bootstrap(values, np.ones(12), block),
        bootstrap(np.tile(values, 20), np.ones(240), np.tile(block, 20)),
    )
    assert once == bootstrap(values, np.ones(12))
    assert (often.low, often.high) == pytest.approx((once.low, once.high))
    assert often.n == 240
    assert bootstrap(np.tile(values, 20), np.ones(240)).high < often.high


def test_blocks_have_the_weighted_mean_of_their_cases():
    values, weights, block = np.array([1.0, 3.0, 5.0]), np.array([1.0, 3.0, 2.0]), np.array([7, 7, 2])
    means, sums = by_block(values, weights, block)
    assert dict(zip(means.tolist(), sums.tolist(), strict=True)) == {5.0: 2.0, 2.5: 4.0}
    assert weighted_mean(means, sums) == pytest.approx(weighted_mean(values, weights))


def test_a_rate_without_failures_has_the_interval_of_as_many_cases_as_blocks():
    block = np.repeat(np.arange(8), 5)
    found = rate(np.ones(40, bool), block)
    assert (found.low, found.high) == (wilson(np.ones(8, bool)).low, 1.0)
    assert found.n == 40
    mixed = np.repeat(np.arange(8) < 6, 5)
    assert rate(mixed, block).low < rate(mixed, None).low
    assert rate(mixed, None) == wilson(mixed)
