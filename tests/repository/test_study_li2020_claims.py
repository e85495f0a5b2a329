import re
from pathlib import Path

import numpy as np
import pytest
from study_folders import TABLE as NETWORKS
from study_folders import fill, refused, table

from crowdbench.metrics.networks import mean_over_networks
from crowdbench.results.paired import LEAST_SHARED
from crowdbench.utils.toml import Location
from studies.li2020.claims import OURS, difference_over_networks, tally
from studies.li2020.table import ClaimedTable, read_reproduction

pytestmark = pytest.mark.usefixtures("study_folder")

TABLE = NETWORKS.replace("[[networks", "[[tables")

CLAIM = """
[[tables.claims]]
text = "Mine is better"
source = "Experiment 1"
row = "mine"
than = "other"
measure = "success_rate"
kind = "difference"
bound = 0.0
"""

VARIANT = TABLE.replace(
    "replan_every = 2",
    """
quick = "4"
variant = { title = "a rule", overrides = { collision = "crowdnav" } }
""",
)


def read(text):
    """The tables of a file, with their claims."""
    Path("tiny.toml").write_text(text)
    return read_reproduction(None, False, Path("tiny.toml"))


def assessed(out, mine, other, **changes):
    """The one claim, changed, about rows with these episodes."""
    text = CLAIM
    for key, value in changes.items():
        text = re.sub(f"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    # Listed the other way round: networks are matched by name, not by place.
    found = fill(read(TABLE + text), out, mine=mine, other=other[::-1], orca=[table([1] * len(mine[0]))])
    (claim,) = found.claims
    return claim


def test_a_quick_look_has_the_first_network_and_its_own_cases():
    spec = read(VARIANT).tables[0].spec.quick_look()
    quick = ClaimedTable.plan(spec, Location("tiny.toml"))
    assert [str(run.spec.cases) for run in quick.runs] == ["test:0:4"] * 6
    assert [run.spec.options.get("weights") for run in quick.runs] == ["one", "one", "two", "two", None, None]


def test_a_claim_holds_is_refuted_or_undecided_as_its_interval_lies(tmp_path):
    all_of_them, most, some = (table([1] * n + [0] * (60 - n)) for n in (60, 57, 40))
    assert assessed(tmp_path / "a", [all_of_them] * 2, [some] * 2).verdict == "holds"
    assert assessed(tmp_path / "b", [some] * 2, [all_of_them] * 2).verdict == "refuted"
    near = assessed(tmp_path / "c", [all_of_them] * 2, [most] * 2)
    assert near.verdict == "undecided"
    assert near.figure.mean == pytest.approx(0.05)
    assert assessed(tmp_path / "d", [all_of_them] * 2, [most] * 2, bound=-0.05).verdict == "holds"


def test_the_interval_of_success_has_a_case_won_and_a_case_lost_besides(tmp_path):
    rng = np.random.default_rng(3)
    mine, other = rng.random((2, 30)) < 0.9, rng.random((2, 30)) < 0.7
    claim = assessed(tmp_path, [table(row) for row in mine], [table(row) for row in other])
    gain = mine.astype(float) - other
    expected = mean_over_networks(np.concatenate([gain, [[1.0, -1.0]] * 2], axis=1))
    assert (claim.figure.low, claim.figure.high) == (expected.low, expected.high)
    assert claim.figure.mean == pytest.approx(gain.mean())
    assert (claim.networks, claim.cases) == ((2, 2), 30)


def test_networks_of_two_trainings_are_compared_as_independent_ones(tmp_path):
    other = TABLE.replace('weights = ["two", "one"]', 'weights = ["three", "four", "five"]') + CLAIM
    Path("weights.json").write_text('{"one": 0, "two": 0.1, "three": 0.2, "four": 0.3, "five": 0.4}')
    rng = np.random.default_rng(4)
    mine, theirs = rng.random((2, 60)) < 0.9, rng.random((3, 60)) < 0.7
    rows = {"mine": [table(row) for row in mine], "other": [table(row) for row in theirs], "orca": [table([1] * 60)]}
    (claim,) = fill(read(other), tmp_path, **rows).claims
    won, lost = (np.tile(pair, (len(row), 1)) for pair, row in (([1.0, 0.0], mine), ([0.0, 1.0], theirs)))
    expected = difference_over_networks(np.hstack([mine, won]), np.hstack([theirs, lost]), paired=False)
    assert (claim.figure.low, claim.figure.high) == (expected.low, expected.high)
    assert claim.figure.mean == pytest.approx(mine.mean() - theirs.mean())
    assert (claim.networks, claim.cells()[4]) == ((2, 3), "2 and 3")


def test_networks_of_which_some_are_shared_are_not_compared():
    Path("weights.json").write_text('{"one": 0, "two": 0.1, "three": 0.2}')
    text = TABLE.replace('weights = ["two", "one"]', 'weights = ["two", "three"]') + CLAIM
    refused(text, ["tables[1].claims[1].than is 'other'", "all networks of mine, or with none"], read)


def test_one_network_has_no_verdict_and_a_planner_without_any_has_one(tmp_path):
    alone = TABLE.replace('["one", "two"]', '["one"]').replace('["two", "one"]', '["one"]')
    rows = {"mine": [table([1] * 60)], "other": [table([0] * 60)], "orca": [table([0] * 60)]}
    for number, than in enumerate(("other", "orca")):
        claim = CLAIM.replace('"other"', f'"{than}"')
        (found,) = fill(read(alone + claim), tmp_path / str(number), **rows).claims
        assert found.verdict == "one network"
    (found,) = fill(
        read(TABLE + CLAIM.replace('"other"', '"orca"')),
        tmp_path / "2",
        **rows | {"mine": [table([1] * 60)] * 2, "other": [table([0] * 60)] * 2},
    ).claims
    assert (found.verdict, found.cells()[4]) == ("holds", "2 and 0")


def test_less_is_better_of_times_and_only_cases_that_both_solve_count(tmp_path):
    success = [1] * 20 + [0] * 10
    slow = table(success[::-1], time=12.0)
    fast = table(success, time=np.array([99.0] * 10 + [9.0] * 20))
    claim = assessed(tmp_path / "a", [fast] * 2, [slow] * 2, measure='"navigation_time"')
    assert (claim.figure.mean, claim.cases, claim.verdict) == (3.0, 10, "holds")
    claim = assessed(tmp_path / "b", [fast] * 2, [slow] * 2, measure='"navigation_time"', kind='"reduction"', bound=0.3)
    assert claim.figure.mean == pytest.approx(0.25)
    assert claim.verdict == "refuted"


@pytest.mark.slow
def test_a_few_cases_that_both_solve_decide_nothing(tmp_path):
    for shared, expected in [(LEAST_SHARED, "holds"), (LEAST_SHARED - 1, "undecided"), (0, "undecided")]:
        success = [1] * shared + [0] * (20 - shared)
        claim = assessed(
            tmp_path / str(shared), [table(success, change=0.5)] * 2, [table(success)] * 2,
            measure='"max_velocity_change"', kind='"reduction"', bound=0.41,
        )  # fmt: skip
        assert (claim.cases, claim.verdict) == (shared, expected)


def test_the_tally_counts_the_claims_of_the_paper_alone(tmp_path):
    ours = CLAIM.replace("Experiment 1", OURS)
    rows = {"mine": [table([1] * 60)] * 2, "other": [table([0] * 60)] * 2, "orca": [table([1] * 60)]}
    claims = fill(read(TABLE + CLAIM + ours), tmp_path, **rows).claims
    assert [claim.verdict for claim in claims] == ["holds", "holds"]
    assert tally(claims).startswith("Claims of the paper: 1 hold, 0 are refuted")


BROKEN = {
    TABLE + CLAIM.replace('"mine"', '"nine"'): ["tables[1].claims[1].row is 'nine'", '"mine", "other", "orca"'],
    TABLE + CLAIM.replace('"difference"', '"reduction"'): ["claims[1].kind is 'reduction'", "less success is no gain"],
    TABLE + CLAIM.replace("bound = 0.0", ""): ["claims[1].bound is missing", "a number above -1000"],
    TABLE.replace("replan", 'quick = "few"\nreplan'): ["in tables[1], cases 'few'", "val:100"],
}


@pytest.mark.parametrize("text", BROKEN)
def test_a_broken_claim_gets_one_sentence(text):
    refused(text, BROKEN[text], read)
