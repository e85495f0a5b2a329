import numpy as np
import pytest

from crowdbench.metrics import compare_all, is_competent, ranks
from crowdbench.metrics.networks import mean_over_networks

WEIGHTS = np.array([0.5, 0.5])


def scores(mean, networks=1, cases=100, seed=0, spread=0.0, noise=0.1):
    """Scores of a planner in two scenarios; its networks differ by `spread`."""
    draws = np.random.default_rng(seed)
    means = mean + spread * np.linspace(-1.0, 1.0, networks) if networks > 1 else np.array([mean])
    return np.clip(means[:, None, None] + draws.normal(0.0, noise, (networks, 2, cases)), 0.0, 1.0)


def places(values):
    rank = ranks([*values], compare_all(values, WEIGHTS))
    return {name: str(each) for name, each in rank.items()}


def test_scores_that_are_far_apart_are_ranked():
    values = {"a": scores(0.6, seed=1), "b": scores(0.5, seed=2), "c": scores(0.499, seed=3)}
    assert places(values) == {"a": "1", "b": "2 to 3", "c": "2 to 3"}


def test_the_spread_of_networks_widens_a_difference():
    alike, unlike = scores(0.6, 3, seed=1), scores(0.6, 3, seed=1, spread=0.2)
    (sure,) = compare_all({"a": alike, "b": scores(0.5, seed=2)}, WEIGHTS)
    (unsure,) = compare_all({"a": unlike, "b": scores(0.5, seed=2)}, WEIGHTS)
    assert sure.is_sure
    assert not unsure.is_sure
    of_networks = mean_over_networks(unlike.mean(axis=1))
    assert unsure.error == pytest.approx(of_networks.high - of_networks.mean, rel=0.05)


def test_a_network_that_is_given_twice_does_not_change_a_difference():
    one, two = scores(0.6, seed=1), scores(0.5, seed=2)
    (expected,) = compare_all({"a": one, "b": two}, WEIGHTS)
    (found,) = compare_all({"a": one.repeat(2, axis=0), "b": two}, WEIGHTS)
    assert (found.difference, found.error) == pytest.approx((expected.difference, expected.error))


def test_an_interval_of_scores_is_that_of_students_t():
    a, b = scores(0.52, seed=1, noise=0.3), scores(0.5, seed=2, noise=0.3)
    (pair,) = compare_all({"a": a, "b": b}, WEIGHTS)
    deviations = (a - b)[0].std(axis=1, ddof=1)
    assert pair.error == pytest.approx(1.98 * np.sqrt(np.sum((0.5 * deviations) ** 2) / 100), rel=0.1)


def faults(*numbers, cases=100):
    """Cases at fault of a network: so many in each scenario."""
    return (np.arange(cases) < np.array(numbers)[:, None]).astype(float)


def test_a_competent_planner_is_seldom_at_fault_in_all_scenarios_and_in_each():
    assert is_competent(faults(1, 2)[None])
    assert not is_competent(faults(11, *[0] * 8)[None])  # pooled 1.2 %, but 11 % in one scenario
    assert not is_competent(faults(*[4] * 9)[None])  # pooled 4 %, with an upper bound of 5.5 %
    assert is_competent(faults(*[3] * 9)[None])


def test_every_network_of_a_competent_planner_is_seldom_at_fault():
    assert not is_competent(np.array([faults(*[0] * 9), faults(*[9] * 9)]))
