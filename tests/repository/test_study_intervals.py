import math

import numpy as np
import pytest
from scipy.stats import t as student
from scipy.stats import ttest_1samp

from crowdbench.metrics.networks import mean_over_networks
from crowdbench.utils.tables import plain
from studies.li2020.claims import difference_over_networks, reduction_over_networks

SIMULATIONS = 2000


def spread(networks, cases, rest, n, rng, size=60):
    """Values whose true mean is 0, of so many networks, with these standard deviations: [simulation, network, case]."""
    effects = networks * rng.normal(size=(SIMULATIONS, n, 1)) + cases * rng.normal(size=(SIMULATIONS, 1, size))
    return effects + rest * rng.normal(size=(SIMULATIONS, n, size))


def false_holds(simulated):
    """How often an interval lies above the true value, which is 0."""
    return np.mean([mean_over_networks(values).low > 0.0 for values in simulated])


@pytest.mark.nightly
@pytest.mark.parametrize("n", [2, 3, 5, 10])
@pytest.mark.parametrize("spreads", [(0.1, 1.0, 0.5), (0.05, 0.2, 1.0)])
def test_a_claim_that_is_not_true_holds_in_no_more_than_3_of_100_studies(n, spreads):
    assert false_holds(spread(*spreads, n, np.random.default_rng([5, n]))) <= 0.03


@pytest.mark.nightly
@pytest.mark.parametrize("n", [2, 3, 5, 10])
def test_a_difference_in_success_that_is_not_there_holds_in_no_more_than_3_of_100_studies(n):
    rng = np.random.default_rng([6, n])
    size = (SIMULATIONS, n, 200)
    hard = rng.random((SIMULATIONS, 1, 200)) < 0.03
    failures = [(rng.random(size) < rng.beta(2.0, 150.0, (SIMULATIONS, n, 1))) | hard for _ in range(2)]
    won, lost = np.ones((SIMULATIONS, n, 1)), -np.ones((SIMULATIONS, n, 1))
    gain = failures[1].astype(float) - failures[0]
    assert false_holds(np.concatenate([gain, won, lost], axis=2)) <= 0.03


def test_where_networks_alone_differ_the_interval_is_students():
    values = np.repeat(np.random.default_rng(1).normal(size=(5, 1)), 50, axis=1)
    found = mean_over_networks(values)
    expected = ttest_1samp(values[:, 0], 0.0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    assert (found.n, found.max) == (250, values.max())


def test_where_cases_alone_differ_and_for_one_network_the_interval_is_students_too():
    case = np.random.default_rng(2).normal(size=40)
    expected = ttest_1samp(case, 0.0).confidence_interval(0.95)
    for networks in (1, 4):
        found = mean_over_networks(np.tile(case, (networks, 1)))
        assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


def test_both_parts_add_in_squares_over_the_values_that_are_there():
    values = np.random.default_rng(7).normal(size=(4, 9))
    values[values > 1.0] = np.nan
    values[2] = np.nan
    rows = [[(case, value) for case, value in enumerate(row) if not math.isnan(value)] for row in values]
    rows = [row for row in rows if row]
    means = [sum(value for _, value in row) / len(row) for row in rows]
    mean = sum(means) / 3
    parts = {}
    for row, of_network in zip(rows, means, strict=True):
        for case, value in row:
            parts[case] = parts.get(case, 0.0) + (value - of_network) / len(row) / 3
    count = len(parts)
    of_cases = student.ppf(0.975, count - 1) ** 2 * sum(part**2 for part in parts.values()) * count / (count - 1)
    of_networks = student.ppf(0.975, 2) ** 2 * sum((of_network - mean) ** 2 for of_network in means) / 2 / 3
    found = mean_over_networks(values)
    assert found.mean == pytest.approx(mean)
    assert found.high - found.mean == pytest.approx(math.sqrt(of_cases + of_networks))
    assert found.mean - found.low == pytest.approx(found.high - found.mean)
    assert found.n == sum(map(len, rows))


def test_nothing_measured_gives_no_interval():
    found = mean_over_networks(np.full((2, 3), np.nan))
    assert found.n == 0
    assert math.isnan(found.mean)
    assert plain([found])[0]["low"] is None


def test_a_single_case_has_a_mean_and_no_interval():
    found = mean_over_networks(np.array([[1.0, np.nan], [3.0, np.nan]]))
    assert (found.mean, found.n) == (2.0, 2)
    assert math.isnan(found.low)
    assert math.isnan(found.high)


def test_a_difference_of_the_same_networks_is_the_mean_of_the_differences():
    ours, theirs = np.random.default_rng(9).normal(size=(2, 3, 20))
    assert difference_over_networks(ours, theirs, paired=True) == mean_over_networks(ours - theirs)


def test_networks_of_two_trainings_add_their_parts_of_the_variance():
    rng = np.random.default_rng(10)
    ours, theirs = (np.repeat(rng.normal(size=(n, 1)), 30, axis=1) for n in (5, 3))
    found = difference_over_networks(ours, theirs, paired=False)
    parts = [student.ppf(0.975, len(each) - 1) ** 2 * each[:, 0].var(ddof=1) / len(each) for each in (ours, theirs)]
    assert found.mean == pytest.approx(ours.mean() - theirs.mean())
    assert found.high - found.mean == pytest.approx(math.sqrt(sum(parts)))
    cases = rng.normal(size=(2, 1, 30))
    found = difference_over_networks(np.tile(cases[0], (5, 1)), np.tile(cases[1], (3, 1)), paired=False)
    expected = ttest_1samp((cases[0] - cases[1])[0], 0.0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


@pytest.mark.nightly
@pytest.mark.parametrize("n", [2, 3, 5, 10])
def test_a_difference_between_two_trainings_that_is_not_there_holds_in_no_more_than_3_of_100_studies(n):
    rng = np.random.default_rng([9, n])
    case = 0.5 * rng.normal(size=(SIMULATIONS, 1, 60))
    ours, theirs = (case + spread(0.3, 0.3, 0.5, n, rng) for _ in range(2))
    found = [difference_over_networks(x, y, paired=False).low > 0.0 for x, y in zip(ours, theirs, strict=True)]
    assert np.mean(found) <= 0.03


@pytest.mark.parametrize("paired", [True, False])
def test_a_reduction_is_of_the_means_over_networks_and_cases(paired):
    ours, theirs = np.random.default_rng(11).uniform(1.0, 2.0, size=(2, 3, 8))
    found = reduction_over_networks(ours, theirs, paired)
    assert found.mean == pytest.approx(1.0 - ours.mean() / theirs.mean())
    # The linearised difference has the same relative width.
    ratio = ours.mean() / theirs.mean()
    linear = difference_over_networks(ours / theirs.mean(), ratio * theirs / theirs.mean(), paired)
    assert found.high - found.low == pytest.approx(linear.high - linear.low)
    assert found.n == 8


@pytest.mark.nightly
@pytest.mark.parametrize("n", [2, 3, 5, 10])
def test_a_reduction_that_is_not_there_holds_in_no_more_than_3_of_100_studies(n):
    rng = np.random.default_rng([8, n])
    ours, theirs = (10.0 + spread(0.3, 0.5, 0.5, n, rng) for _ in range(2))
    holds = [reduction_over_networks(x, y, True).low > 0.0 for x, y in zip(ours, theirs, strict=True)]
    assert np.mean(holds) <= 0.03


def test_nothing_can_be_reduced_from_nothing():
    zero = np.zeros((2, 3))
    for paired in (True, False):
        assert math.isnan(reduction_over_networks(zero, zero, paired).mean)
        assert reduction_over_networks(zero, zero + np.nan, paired).n == 0
        assert difference_over_networks(zero, zero + np.nan, paired).n == 0
