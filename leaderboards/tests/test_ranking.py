import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rank_simulation import BETTER, simulate

from crowdbench.metrics import Rank, compare_all, ranks
from crowdbench_leaderboards.pages.ranking import Candidate, place, rank_all

CASES = 500
ALONE = np.ones(1)


def entry(failures, cases=CASES):
    """The successes of an entry that fails in some cases."""
    success = np.ones((1, 1, cases))
    success[0, 0, list(failures)] = 0.0
    return success


def numbered(entries):
    return {str(number): own for number, own in enumerate(entries)}


def ranked(entries, blocks=None):
    """The ranks by name."""
    entries = entries if isinstance(entries, dict) else numbered(entries)
    return ranks([*entries], compare_all(entries, ALONE, blocks))


def places(entries, blocks=None):
    return [str(rank) for rank in ranked(entries, blocks).values()]


@st.composite
def boards(draw, most=6, cases=40):
    """Entries of a few cases each, some alike."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    own = {}
    for number in range(draw(st.integers(2, most))):
        rate = draw(st.sampled_from([0.0, 0.3, 0.6, 0.9, 1.0]))
        own[f"entry{number}"] = (generator.random((1, 1, cases)) < rate).astype(float)
    if draw(st.booleans()):
        own["twin"] = own["entry0"]
    return own


@settings(max_examples=25)
@given(boards())
def test_ranks_agree_with_the_pairs(own):
    pairs, found = compare_all(own, ALONE), ranked(own)
    assert all(1 <= rank.first <= rank.last <= len(own) for rank in found.values())
    for pair in pairs:
        assert pair.difference == pytest.approx(own[pair.higher].mean() - own[pair.lower].mean())
        if pair.is_sure:
            # Surely better is transitive, so that both ends of a rank are those of an order.
            assert found[pair.higher].first < found[pair.lower].first
            assert found[pair.higher].last < found[pair.lower].last
        elif pair.difference == 0.0:
            assert not pair.is_sure
    if "twin" in own:
        assert all(not pair.is_sure for pair in pairs if {pair.higher, pair.lower} == {"twin", "entry0"})


@settings(max_examples=10)
@given(boards(), st.randoms())
def test_the_order_in_which_entries_come_does_not_matter(own, random):
    names = list(own)
    random.shuffle(names)
    assert ranked({name: own[name] for name in names}) == ranked(own)


def test_entries_that_chance_may_have_ordered_share_a_rank():
    assert places([entry([1, 2]), entry([3]), entry([])]) == ["1 to 3"] * 3


def test_a_rank_is_an_interval_of_what_is_sure():
    # The first and the third are apart, the second is apart from neither.
    assert places([entry([]), entry(range(5)), entry(range(9))]) == ["1 to 2", "1 to 3", "2 to 3"]
    assert places([entry([]), entry(range(20)), entry(range(60))]) == ["1", "2", "3"]


@pytest.mark.parametrize(
    ("rank", "text"),
    [
        (Rank(1, 1), "1st"),
        (Rank(1, 5), "tied, 1st to 5th"),
        (Rank(2, 3), "tied, 2nd to 3rd"),
        (Rank(11, 13), "tied, 11th to 13th"),
        (Rank(21, 22), "tied, 21st to 22nd"),
    ],
)
def test_a_rank_is_written_as_a_place(rank, text):
    assert place(rank) == text


def candidate(name, score, faults=0, owner=None, cases=400):
    generator = np.random.default_rng(len(name))
    at_fault = (np.arange(cases)[None] < faults).astype(float)
    scores = (generator.random((1, cases)) < score) * generator.uniform(0.8, 1.0, (1, cases))
    return Candidate(name, owner or name, scores, at_fault)


def test_who_is_often_at_fault_is_in_a_block_of_its_own():
    found = rank_all([candidate("fast", 0.99, 40), candidate("careful", 0.6), candidate("slow one", 0.3)], ALONE)
    assert found.block == {"fast": "B", "careful": "A", "slow one": "A"}
    assert found.order == ["careful", "slow one", "fast"]
    assert {name: str(rank) for name, rank in found.rank.items()} == {"careful": "1", "slow one": "2", "fast": "1"}
    assert {frozenset((pair.higher, pair.lower)) for pair in found.pairs} == {frozenset(("careful", "slow one"))}


def test_entries_of_the_same_rank_are_listed_by_score():
    found = rank_all([candidate("a", 0.50), candidate("bb", 0.52), candidate("ccc", 0.51)], ALONE)
    means = {each: found.rank[each] for each in found.order}
    assert {str(rank) for rank in means.values()} == {"1 to 3"}
    scores = [candidate(name, share).score.mean() for name, share in (("a", 0.50), ("bb", 0.52), ("ccc", 0.51))]
    assert found.order == [name for _, name in sorted(zip(scores, ("a", "bb", "ccc"), strict=True), reverse=True)]


def test_scenarios_count_by_their_weights():
    two = [each.reshape(1, 2, -1) for each in (entry([]), entry(range(25)))]
    (pair,) = compare_all(numbered(two), np.array([0.75, 0.25]))
    assert pair.difference == pytest.approx(0.75 * 25 / 250)


def test_cases_of_a_block_count_as_one_observation():
    """Ten blocks of fifty cases, of which one entry fails in a whole block: too little to tell it from the other."""
    blocks = np.arange(CASES)[None] // 50
    both = [entry([]), entry(range(50))]
    assert places(both) == ["1", "2"]
    assert places(both, blocks=blocks) == ["1 to 2"] * 2
    assert places(both, blocks=np.arange(CASES)[None]) == places(both)


def test_an_interval_is_that_of_students_t_where_many_cases_differ():
    success = np.random.default_rng(3).random((2, CASES)) < [[0.7], [0.5]]
    (pair,) = compare_all(numbered(success[:, None, None].astype(float)), ALONE)
    values = success[0].astype(float) - success[1]
    assert pair.error == pytest.approx(1.965 * values.std(ddof=1) / np.sqrt(CASES), rel=0.05)


@pytest.mark.nightly
@pytest.mark.parametrize(("entries", "rate", "correlation"), [(3, 0.97, 0.3), (7, 0.99, 0.2)])
def test_equal_entries_are_told_apart_on_at_most_5_percent_of_boards(entries, rate, correlation):
    repetitions = 120
    found = simulate(entries, rate, correlation, repetitions)
    most = 0.05 + 2.0 * np.sqrt(0.05 * 0.95 / repetitions)
    assert found["a false sure pair"] <= most


@pytest.mark.nightly
def test_a_better_entry_is_found_with_the_power_that_is_printed():
    found = {cases: simulate(3, 0.97, 0.3, 60, BETTER, cases) for cases in (500, 1000)}
    power = {cases: each["the first is surely better than another"] for cases, each in found.items()}
    print(f"power for {100 * BETTER:g} points by the number of cases: {power}")
    assert power[1000] > max(power[500], 0.7)
    assert max(each["a false sure pair"] for each in found.values()) <= 0.1


def test_one_entry_is_the_first():
    assert places([entry([])]) == ["1"]
