import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from ranking import (
    CONFIDENCE,
    SCT,
    SUCCESS,
    compare_all,
    pareto,
    rank_by_bounds,
    ranks,
    scores,
)

from crowdbench.metrics.summary import DELTA, Scale
from crowdbench.utils.errors import InputError

CASES = 500
ALONE = np.ones(1)


def entry(failures, seconds=1.5):
    """The columns of an entry that fails in some cases, and otherwise takes `seconds` times the shortest time."""
    success = np.ones(CASES)
    success[list(failures)] = 0.0
    return {SUCCESS: success[None], SCT: (success / np.broadcast_to(seconds, CASES))[None]}


def numbered(entries):
    return {str(number): own for number, own in enumerate(entries)}


def ranked(entries, weights=ALONE, scale=Scale(), blocks=None):  # noqa: B008
    """The ranks by name, in the order in which the entries stand."""
    entries = entries if isinstance(entries, dict) else numbered(entries)
    return ranks(scores(entries, weights, scale), compare_all(entries, weights, scale, blocks))


def places(entries, **rules):
    found = ranked(entries, **rules)
    return [(found[name].rank, found[name].first, found[name].last) for name in sorted(found)]


@st.composite
def boards(draw, most=6, cases=40):
    """Entries of a few cases each, some alike."""
    seed = draw(st.integers(0, 2**32 - 1))
    generator = np.random.default_rng(seed)
    own = {}
    for number in range(draw(st.integers(2, most))):
        rate = draw(st.sampled_from([0.0, 0.3, 0.6, 0.9, 1.0]))
        success = (generator.random(cases) < rate).astype(float)
        sct = success * draw(st.sampled_from([0.5, 0.9])) * generator.uniform(0.9, 1.0, cases)
        own[f"entry{number}"] = {SUCCESS: success[None], SCT: sct[None]}
    if draw(st.booleans()):
        own["twin"] = own["entry0"]
    return own


def test_a_score_is_success_and_up_to_half_a_point_for_being_quick():
    found = scores({"a": entry(range(50), 1.25), "b": entry([], 4.0)}, ALONE, Scale(0.4, 0.6))
    assert list(found) == ["b", "a"]
    assert found["b"] == 1.0  # an SCT of 0.25
    assert found["a"] == pytest.approx(0.9 + DELTA)  # 0.72
    assert scores({"c": entry([], 2.0)}, ALONE, Scale(0.4, 0.6))["c"] == pytest.approx(1.0 + DELTA / 2)


@settings(max_examples=25)
@given(boards())
def test_ranks_are_an_order(own):
    """Whoever has the higher score has no worse rank, and equal scores have equal ranks and places."""
    score, found = scores(own, ALONE, Scale()), ranked(own)
    names = list(found)
    assert names == list(score)
    assert [score[name] for name in names] == sorted(score.values(), reverse=True)
    assert [found[name].rank for name in names] == sorted(rank.rank for rank in found.values())
    if "twin" in own:
        assert found["twin"].rank == found["entry0"].rank
    assert found[names[0]].rank == 1


@settings(max_examples=25)
@given(boards())
def test_a_rank_lies_within_its_interval(own):
    for rank in ranked(own).values():
        assert 1 <= rank.first <= rank.rank <= rank.last <= len(own)


@settings(max_examples=25)
@given(boards())
def test_success_comes_first_where_it_differs_by_more_than_half_a_point(own):
    score, rate = scores(own, ALONE, Scale()), {name: each[SUCCESS].mean() for name, each in own.items()}
    for a in own:
        for b in own:
            assert rate[a] <= rate[b] + DELTA or score[a] > score[b]


@settings(max_examples=25)
@given(boards())
def test_an_entry_that_stands_last_changes_nobodys_rank(own):
    assume(min(scores(own, ALONE, Scale()).values()) > 0.0)
    before = ranked(own)
    last = {SUCCESS: np.zeros((1, 40)), SCT: np.zeros((1, 40))}
    after = ranked(own | {"zzz": last})
    assert {name: after[name].rank for name in own} == {name: rank.rank for name, rank in before.items()}


@settings(max_examples=10)
@given(boards(), st.randoms())
def test_the_order_in_which_entries_come_does_not_matter(own, random):
    names = list(own)
    random.shuffle(names)
    assert ranked({name: own[name] for name in names}) == ranked(own)


def test_entries_that_chance_may_have_ordered_share_a_rank():
    assert places([entry([1, 2]), entry([3]), entry([])]) == [(1, 1, 3)] * 3


def test_an_entry_starts_a_tier_where_any_of_the_tier_above_beats_it():
    # 6 failures are beaten by none at all, but not by 3: the first and the third are apart, the second with neither.
    none, three, six = entry([]), entry(range(3)), entry(range(6))
    assert places([none, three]) == [(1, 1, 2), (1, 1, 2)]
    assert places([none, three, six]) == [(1, 1, 3), (1, 1, 3), (3, 1, 3)]


def test_speed_counts_among_those_who_succeed_alike_in_many_cases():
    """In few cases nobody knows that they succeed alike: the variance is that of one failure more."""
    both = [entry([], seconds * np.random.default_rng(0).uniform(0.9, 1.1, CASES)) for seconds in (1.4, 1.2)]
    assert list(ranked(both)) == ["1", "0"]
    assert places(both) == [(1, 1, 2), (1, 1, 2)]
    often = [{metric: np.tile(values, 8) for metric, values in each.items()} for each in both]
    assert places(often) == [(2, 2, 2), (1, 1, 1)]


def test_scenarios_count_by_their_weights_however_many_cases_they_have():
    two = [{name: values.reshape(2, -1) for name, values in each.items()} for each in (entry([]), entry(range(25)))]
    (pair,) = compare_all(numbered(two), np.array([0.75, 0.25]), Scale())
    assert pair.difference == pytest.approx(0.75 * 25 / 250 * (1 + DELTA / 1.5))


def test_cases_of_a_block_count_as_one_observation():
    """Ten blocks of fifty cases, of which one entry fails in a whole block: too little to tell it from the other."""
    blocks = np.arange(CASES)[None] // 50
    both = [entry([]), entry(range(50))]
    assert places(both) == [(1, 1, 1), (2, 2, 2)]
    assert places(both, blocks=blocks) == [(1, 1, 2), (1, 1, 2)]
    assert places(both, blocks=np.arange(CASES)[None]) == places(both)


def test_a_bound_is_that_of_students_t_where_many_cases_differ():
    generator = np.random.default_rng(3)
    success = generator.random((2, CASES)) < [[0.7], [0.5]]
    own = {
        name: {SUCCESS: each[None].astype(float), SCT: np.zeros((1, CASES))}
        for name, each in zip("ab", success, strict=True)
    }
    (pair,) = compare_all(own, ALONE, Scale())
    values = success[0].astype(float) - success[1]
    expected = values.mean() - 1.965 * values.std(ddof=1) / np.sqrt(CASES)
    assert pair.bound == pytest.approx(expected, abs=0.004)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.01, 0.4])
def test_what_does_not_differ_is_told_apart_no_more_often_than_is_said(rate):
    generator = np.random.default_rng(2)
    trials, pairs, surely = 100, 0, 0
    for _ in range(trials):
        own = [entry(np.flatnonzero(generator.random(CASES) < rate), generator.uniform(1, 2, CASES)) for _ in range(4)]
        found = compare_all(numbered(own), ALONE, Scale())
        pairs += sum(pair.is_decided for pair in found)
        surely += any(pair.is_sure for pair in found)
    wrong = 1.0 - CONFIDENCE
    assert pairs / (6 * trials) <= wrong + 3.0 * np.sqrt(wrong * (1 - wrong) / trials)
    assert surely / trials <= wrong + 3.0 * np.sqrt(wrong * (1 - wrong) / trials)


def test_a_metric_without_a_value_cannot_rank():
    without = entry([]) | {SCT: np.full((1, CASES), np.nan)}
    with pytest.raises(InputError, match=r"^entries cannot be compared: sct has no value in some case$"):
        ranked([entry([]), without])


def test_one_entry_is_the_first():
    assert places([entry([])]) == [(1, 1, 1)]


def test_figures_alone_rank_by_their_intervals():
    score, error = {"a": 0.9, "b": 0.95, "c": 0.5, "d": 0.91}, {"a": 0.04, "b": 0.01, "c": 0.1, "d": 0.04}
    assert rank_by_bounds(score, error) == {"b": 1, "d": 1, "a": 3, "c": 4}


def test_the_pareto_set_is_what_nothing_beats():
    costs = np.array([[0.0, 3.0], [1.0, 1.0], [1.0, 2.0], [2.0, 0.5], [1.0, 1.0]])
    assert pareto(costs).tolist() == [True, True, False, True, True]


def test_what_ranks_are_metrics():
    from crowdbench.metrics import METRICS

    assert {SUCCESS, SCT} <= set(METRICS)
