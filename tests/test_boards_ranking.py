import itertools

import numpy as np
import pytest
from scipy import stats

from crowdbench.boards.ranking import ALPHA, CRITERIA, compare_all, p_value, pareto, ranks, smallest_difference
from crowdbench.runs.compare import holm
from crowdbench.utils.errors import InputError

CASES = 500


def entry(failures, seconds=1.0, collide=True):
    """The columns of an entry that fails in some cases, and otherwise takes `seconds` times the shortest time."""
    success = np.ones(CASES)
    success[list(failures)] = 0.0
    collisions = (1.0 - success) * collide
    return {"success_rate": success, "collision_rate": collisions, "sct": success / np.broadcast_to(seconds, CASES)}


def compared(entries):
    """Comparisons on a board of one scenario."""
    return compare_all(
        {i: {name: values[None] for name, values in each.items()} for i, each in enumerate(entries)}, np.ones(1)
    )


def ranked(*entries):
    comparisons = compared(entries)
    return [(rank.rank, rank.last) for rank in ranks(range(len(entries)), comparisons).values()]


def test_entries_that_do_not_differ_share_the_first_rank():
    assert ranked(entry([1, 2]), entry([3]), entry([])) == [(1, 3)] * 3


def test_success_comes_first_then_collisions_then_time():
    generator = np.random.default_rng(0)
    noise = generator.uniform(0.9, 1.1, CASES)
    fails, collides = entry(range(50)), entry(range(50, 100))
    waits, slow = entry(range(100, 150), collide=False), entry([], 1.4 * noise)
    quick = entry([], 1.2 * noise)
    assert ranked(quick, slow, waits, collides, fails) == [(1, 1), (2, 2), (3, 3), (4, 5), (4, 5)]
    criteria = {one.entries: one.criterion for one in compared([quick, slow, waits, collides])}
    assert criteria[0, 1] == "sct"
    assert criteria[0, 2] == "success_rate"
    assert criteria[2, 3] == "collision_rate"


def test_ranks_do_not_depend_on_the_order_of_entries():
    generator = np.random.default_rng(1)
    entries = [entry(generator.choice(CASES, size, replace=False)) for size in (0, 5, 20, 40)]
    expected = dict(enumerate(ranked(*entries)))
    for order in itertools.permutations(range(4)):
        assert dict(zip(order, ranked(*(entries[i] for i in order)), strict=True)) == expected


def test_holm_multiplies_by_the_number_of_tests_that_are_left():
    # By hand: the smallest times 4, the next times 3, then times 2 and 1, and none smaller than the one before.
    p = np.array([0.01, 0.04, 0.03, 0.005])
    np.testing.assert_allclose(holm(p), [0.03, 0.06, 0.06, 0.02])


@pytest.mark.slow
def test_a_wrong_difference_is_found_in_no_more_than_one_board_of_twenty():
    generator = np.random.default_rng(2)
    boards, wrong = 400, 0
    for _ in range(boards):
        difficulty = generator.beta(0.3, 3.0, CASES)
        entries = [
            entry(np.flatnonzero(generator.random(CASES) < difficulty), generator.uniform(1.0, 1.5, CASES))
            for _ in range(4)
        ]
        wrong += any(one.criterion for one in compared(entries))
    assert wrong / boards <= ALPHA + 2.0 * np.sqrt(ALPHA * (1 - ALPHA) / boards)


def test_a_p_value_is_mcnemars_or_students():
    generator = np.random.default_rng(3)
    a, b = (generator.random((2, CASES)) < [[0.9], [0.8]]).astype(float)
    table = stats.binomtest(int((a > b).sum()), int((a != b).sum())).pvalue
    assert p_value(a, b, np.ones(CASES)) == pytest.approx(table)
    a, b = generator.normal(size=(2, CASES))
    assert p_value(a, b, np.ones(CASES)) == pytest.approx(stats.ttest_rel(a, b).pvalue)
    assert p_value(a, a, np.ones(CASES)) == 1.0


def test_weights_count_as_repeated_families_do():
    """Where the cases of one family count twice as much, so do their differences, and the error with them."""
    generator = np.random.default_rng(4)
    a, b = generator.normal(0.1, 1.0, CASES), generator.normal(size=CASES)
    weights = np.repeat([1.0, 2.0], CASES // 2)
    error = np.sqrt((weights**2 * (a - b - np.average(a - b, weights=weights)) ** 2).sum()) / weights.sum()
    t = np.average(a - b, weights=weights) / error / np.sqrt(CASES / (CASES - 1))
    assert p_value(a, b, weights) == pytest.approx(2 * stats.t.sf(abs(t), CASES - 1))


def test_cases_of_a_block_count_as_one_observation():
    """Ten blocks of ten cases that differ little tell what their ten means tell, not what a hundred cases would."""
    generator = np.random.default_rng(5)
    means, block = generator.normal(0.4, 1.0, 10), np.repeat(np.arange(10), 10)
    a, b = means[block] + generator.normal(0.0, 0.1, 100), np.zeros(100)
    by_mean = stats.ttest_1samp(a.reshape(10, 10).mean(axis=1), 0.0).pvalue
    assert p_value(a, b, np.ones(100), block) == pytest.approx(by_mean)
    assert p_value(a, b, np.ones(100)) < by_mean / 100
    assert p_value(a, b, np.ones(100), np.arange(100)) == pytest.approx(p_value(a, b, np.ones(100)))


def test_entries_are_compared_in_the_cases_that_both_drove():
    good, bad = entry([]), entry(range(60, 100))
    few = {name: values[:50] for name, values in bad.items()}
    first, second, third = compared([good, few, bad])
    assert not first.criterion  # it fails in none of the first 50
    assert second.differences["success_rate"] == pytest.approx(40 / CASES)
    assert third.differences["success_rate"] == 0.0


def test_scenarios_count_by_their_weights_however_many_cases_they_have():
    two = [{name: values.reshape(2, -1) for name, values in each.items()} for each in (entry([]), entry(range(25)))]
    (found,) = compare_all(dict(enumerate(two)), np.array([0.75, 0.25]))
    assert found.differences["success_rate"] == pytest.approx(0.75 * 25 / 250)


@pytest.mark.parametrize("entries", [2, 5])
def test_the_smallest_difference_is_the_smallest_that_is_found(entries):
    least = round(smallest_difference(CASES, entries) * CASES)
    others = {"collision_rate": np.zeros(CASES), "sct": np.ones(CASES)}
    for failures in (least - 1, least):
        columns = [entry([]) | others for _ in range(entries - 1)] + [entry(range(failures)) | others]
        found = {one.criterion for one in compared(columns)}
        assert ("success_rate" in found) == (failures == least)


def test_a_metric_without_a_value_cannot_rank():
    without = entry([]) | {"sct": np.full(CASES, np.nan)}
    with pytest.raises(InputError, match=r"^entries cannot be compared: sct has no value in some case$"):
        compared([entry([]), without])


def test_the_pareto_set_is_what_nothing_beats():
    costs = np.array([[0.0, 3.0], [1.0, 1.0], [1.0, 2.0], [2.0, 0.5], [1.0, 1.0]])
    assert pareto(costs).tolist() == [True, True, False, True, True]


def test_what_ranks_are_metrics():
    from crowdbench.metrics import METRICS

    assert set(CRITERIA) <= set(METRICS)
