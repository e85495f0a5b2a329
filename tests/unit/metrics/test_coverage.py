"""How often printed intervals contain the truth, in simulated data.

Other intervals are simulated where they are made: of gains in `test_study_ladder`, of Kendall's tau in
`test_study_reactions`, of pairs that agree in `test_study_transfer`, of levels in `test_study_dials`, of ranks in
`test_boards_ranking`, of means over networks in `test_study_intervals`.
"""

import numpy as np
import pytest
from scipy.stats import binom
from study_folders import episodes

from crowdbench.metrics import mean_over_scenarios
from crowdbench.metrics.networks import mean_over_networks
from crowdbench.metrics.summary import bootstrap, rate, wilson
from crowdbench.results.paired import Paired, compare_metric
from studies.differences import gain_in_success

STUDIES = 300
LEAST = 0.95 - 2.0 * np.sqrt(0.95 * 0.05 / STUDIES)
"""Two standard errors of the simulation below 95 %."""


def covers(found, truth):
    return found.low <= truth <= found.high


@pytest.mark.parametrize("n", [50, 100, 500])
def test_wilsons_interval_covers_a_rate_of_any_size(n):
    # Exact: summed over all numbers of hits. The mean over rates is 95 %; at single rates it is a few per cent less.
    intervals = [wilson(np.arange(n) < hits) for hits in range(n + 1)]
    rates = np.linspace(0.01, 0.99, 99)
    coverage = np.array(
        [binom.pmf(np.arange(n + 1), n, each) @ [covers(one, each) for one in intervals] for each in rates]
    )
    print(f"Wilson, n = {n}: mean {coverage.mean():.3f}, least {coverage.min():.3f}")
    assert coverage.mean() == pytest.approx(0.95, abs=0.01)
    assert coverage.min() > 0.90


@pytest.mark.nightly
@pytest.mark.parametrize("n", [60, 200])
def test_the_bootstrap_covers_the_mean_of_skewed_values(n):
    # As times and delays are: a percentile interval of few skewed values is a little too narrow.
    draws = np.random.default_rng([1, n])
    found = [bootstrap(draws.exponential(1.0, n), np.ones(n)) for _ in range(STUDIES)]
    coverage = np.mean([covers(each, 1.0) for each in found])
    print(f"bootstrap of {n} exponential values: {coverage:.3f}")
    assert coverage > LEAST - 60.0 / n * 0.02


@pytest.mark.nightly
def test_the_bootstrap_over_blocks_covers_rates_and_means_of_dependent_cases():
    draws, block, found = np.random.default_rng(2), np.repeat(np.arange(40), 5), np.zeros(2)
    for _ in range(STUDIES):
        easy = np.repeat(draws.normal(size=40), 5)
        found[0] += covers(bootstrap(easy + draws.normal(size=200), np.ones(200), block), 0.0)
        found[1] += covers(rate(draws.random(200) < 0.5 + 0.3 * np.sign(easy), block), 0.5)
    print(f"bootstrap over 40 blocks of 5 cases, mean and rate: {found / STUDIES}")
    assert (found / STUDIES > LEAST - 0.02).all()


@pytest.mark.nightly
@pytest.mark.parametrize(("gained", "lost"), [(0.0, 0.0), (0.02, 0.0), (0.05, 0.03), (0.2, 0.1)])
def test_paired_differences_cover_the_true_ones(gained, lost):
    draws, found = np.random.default_rng([3, int(100 * gained)]), np.zeros(2)
    for _ in range(STUDIES):
        kind, case = draws.random(200), draws.gamma(4.0, 3.0, 200)
        times = [case + draws.exponential(1.0 + later, 200) for later in (0.0, gained)]
        two = [
            episodes(success, navigation_time=time)
            for success, time in zip((kind >= gained, kind <= 1.0 - lost), times, strict=True)
        ]
        pairs = [Paired(*two)]
        found[0] += covers(compare_metric("success_rate", pairs).difference, gained - lost)
        found[1] += covers(compare_metric("navigation_time", pairs).difference, gained)
    print(f"paired differences of success and of time, {gained} gained and {lost} lost: {found / STUDIES}")
    assert (found / STUDIES > LEAST - 0.015).all()


@pytest.mark.nightly
def test_the_mean_over_scenarios_of_a_board_covers_the_true_one():
    draws, weights, rates = np.random.default_rng(5), np.array([0.5, 0.3, 0.2]), np.array([0.99, 0.9, 0.6])
    found = [mean_over_scenarios(weights, [wilson(draws.random(100) < each) for each in rates]) for _ in range(1000)]
    coverage = np.mean([covers(each, weights @ rates) for each in found])
    print(f"weighted mean of Wilson's intervals: {coverage:.3f}")
    assert coverage > 0.935


@pytest.mark.nightly
@pytest.mark.parametrize(("networks", "spread"), [(3, 0.3), (5, 0.1), (5, 1.0)])
def test_intervals_over_networks_and_cases_cover_means_and_gains(networks, spread):
    draws, found = np.random.default_rng([4, networks]), np.zeros(2)
    for _ in range(STUDIES):
        case = draws.normal(size=100)
        one, two = (
            (case + spread * draws.normal(size=(networks, 1)) + draws.normal(size=(networks, 100))) for _ in range(2)
        )
        found[0] += covers(mean_over_networks(one), 0.0)
        found[1] += covers(gain_in_success((one < 1.0).astype(float), (two < 1.0).astype(float), False), 0.0)
    print(f"{networks} networks with a spread of {spread}, mean and gain in success: {found / STUDIES}")
    assert (found / STUDIES > LEAST).all()
