import numpy as np
import pytest
from scipy import stats

from crowdbench.evaluate.summary import bootstrap, summarize, wilson


@pytest.mark.parametrize(("hits", "n"), [(0, 10), (7, 10), (500, 500), (212, 500)])
def test_wilsons_interval_is_scipys(hits, n):
    estimate = wilson(np.arange(n) < hits)
    interval = stats.binomtest(hits, n).proportion_ci(0.95, method="wilson")
    assert (estimate.low, estimate.high) == pytest.approx((interval.low, interval.high), abs=1e-12)
    assert estimate.mean == hits / n
    assert estimate.n == n


def test_the_bootstrap_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(300):
        estimate = bootstrap(rng.exponential(1.0, 60), np.ones(60))
        hits += estimate.low <= 1.0 <= estimate.high
    assert 0.89 <= hits / 300 <= 0.98


def test_the_bootstrap_agrees_with_scipys():
    values = np.random.default_rng(1).normal(3.0, 2.0, 400)
    ours = bootstrap(values, np.ones(400))
    theirs = stats.bootstrap((values,), np.mean, n_resamples=5000, method="percentile", rng=2).confidence_interval
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=0.02)


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
