"""The parts of boards that need no planner's process."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from small_boards import card, write_board

from crowdbench.catalog import load_planner
from crowdbench.metrics import OF_FLEETS, mean_over_scenarios, range_over_networks
from crowdbench.metrics.summary import Estimate
from crowdbench.plugins.new_planner import make_planner
from crowdbench.results.episodes import Episodes
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards import ranked_run
from crowdbench_leaderboards.board import MEASURED
from crowdbench_leaderboards.consistency_test import ALPHA, CRITERIA, lower_than_claimed, p_value
from crowdbench_leaderboards.entry import read_card
from crowdbench_leaderboards.pages.standings import SHOWN, Standings
from crowdbench_leaderboards.submission import Submission, rehearse

FAMILIES = """
title = "Two"
description = "Two families"
version = 1
[families]
circle = ["circle_crossing_5", "circle_crossing_10"]
square = ["square_crossing_5"]
"""


def episodes(success, rng):
    """Episodes with these successes, in which all failures are collisions."""
    columns = {"success_rate": success, "collision_rate": ~success, "sct": success * rng.normal(0.7, 0.1, len(success))}
    assert tuple(columns) == CRITERIA
    each = np.arange(len(success))
    return Episodes(each, each, each, columns)


def test_an_honest_planner_is_hardly_ever_lower_than_claimed():
    rng = np.random.default_rng(1)
    called = 0
    for rate in (0.3, 0.9, 0.99, 0.998):
        for _ in range(100):
            public, other = (episodes(rng.random(n) < rate, rng) for n in (500, 2000))
            called += bool(lower_than_claimed({"a": public}, {"a": other}))
    assert called <= 400 * ALPHA + 3


@pytest.mark.parametrize(("claimed", "real"), [(1.0, 0.975), (0.95, 0.88), (0.5, 0.38)])
def test_a_planner_that_is_worse_is_lower_than_claimed(claimed, real):
    rng = np.random.default_rng(1)
    public, other = (episodes(rng.permutation(n) < round(n * rate), rng) for n, rate in ((500, claimed), (2000, real)))
    (success, *_) = lower_than_claimed({"circle": public}, {"circle": other})
    assert success.startswith(f"success in circle was {claimed:.4g} as reported and is {real:.4g} in 2000 other cases")


def test_a_better_planner_is_never_lower_than_claimed():
    rng = np.random.default_rng(1)
    public, other = (episodes(rng.permutation(n) < round(n * rate), rng) for n, rate in ((500, 0.5), (2000, 0.9)))
    assert lower_than_claimed({"a": public}, {"a": other}) == []


def test_equal_values_tell_nothing():
    assert p_value(np.ones(8), np.ones(20)) == 1.0


def test_a_skeleton_keeps_its_contract_and_has_a_valid_card(tmp_path):
    folder = make_planner("my_first", tmp_path)
    assert sorted(path.name for path in folder.iterdir()) == ["card.toml", "my_first.py", "test_my_first.py"]
    planner = load_planner(str(folder / "my_first.py"), {"near": 2.0})
    assert (planner.near, type(planner).__name__) == (2.0, "MyFirst")
    assert read_card(folder / "card.toml").method == "my_first"
    compile((folder / "test_my_first.py").read_text(), "test", "exec")
    with pytest.raises(InputError, match="exists already"):
        make_planner("my_first", tmp_path)
    for name in ("My", "7up", "a b", "../up", "none", "true"):
        with pytest.raises(InputError, match="cannot be the name of a planner"):
            make_planner(name, tmp_path)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"licence": '""'}, r"card\.toml: licence is '', but must be a text in quotes, not an empty one"),
        ({"validation_runs": "-1"}, r"card\.toml: validation_runs is -1, but must be a whole number from 0 to"),
        ({"colour": '"red"'}, r"card\.toml: unknown key colour; the keys here are title, authors, contact, "),
    ],
)
def test_what_is_wrong_in_a_card_gets_one_sentence(changes, sentence, tmp_path):
    (tmp_path / "card.toml").write_text(card(**changes))
    with pytest.raises(InputError, match=sentence):
        read_card(tmp_path / "card.toml")


def test_a_scenario_that_is_missing_counts_as_nothing(tmp_path):
    board = write_board(tmp_path, text=FAMILIES)
    perfect = Estimate(1.0, 0.9, 1.0, 500, 1.0)
    found = mean_over_scenarios(board.weights, [perfect, perfect, None])
    assert (found.mean, found.high) == (0.5, 0.5)
    assert found.low == pytest.approx(0.5 - np.hypot(0.025, 0.025))
    assert np.isnan(
        mean_over_scenarios(board.weights, [perfect, perfect, Estimate(np.nan, np.nan, np.nan, 0, np.nan)]).mean
    )


@pytest.mark.parametrize("shares", [np.ones((5, 250)), np.random.default_rng(0).random((5, 250)) < 0.97])
def test_the_interval_of_a_method_has_a_width_and_ends_at_1(shares):
    found = range_over_networks(np.array(shares, float))
    assert 0.0 < found.low < found.mean <= found.high <= 1.0
    assert found.high - found.low > 0.004


def test_a_card_as_it_was_made_is_refused(tmp_path):
    path = make_planner("gentle", tmp_path) / "card.toml"  # a name that no test has imported
    submission = Submission(write_board(tmp_path / "boards"), "careful", "orca", {}, [], path)
    with pytest.raises(InputError, match=r"card.toml has authors, contact, description as `new-planner` wrote it"):
        submission.check(tmp_path / "boards")
    text = path.read_text().replace("Your Name", "Ada").replace("you@example.org", "ada@example.org")
    path.write_text(text)
    with pytest.raises(InputError, match="has description as"):
        submission.check(tmp_path / "boards")
    path.write_text(text.replace("Drives straight to the goal", "Drives"))
    with pytest.raises(InputError, match="names no account"):
        submission.check(tmp_path / "boards")
    path.write_text(path.read_text().replace('account = ""', 'account = "ada"'))
    submission.check(tmp_path / "boards")


def test_a_rehearsal_makes_no_entry(tmp_path):
    board = write_board(tmp_path)
    (tmp_path / "card.toml").write_text(card())
    seconds = rehearse(Submission(board, "mine", "orca", {}, [], tmp_path / "card.toml"), tmp_path)
    assert seconds > 0.0
    assert not (board_folder := tmp_path / "small" / "entries").exists(), board_folder
    with pytest.raises(InputError, match="there is no card"):
        rehearse(Submission(board, "mine", "orca", {}, [], tmp_path / "no.toml"), tmp_path)


def test_a_board_shows_the_metrics_of_its_ranked_entries():
    def entry(*names):
        return SimpleNamespace(figures={name: Estimate(0.1 if name in names else np.nan, 0, 1, 5, 1) for name in SHOWN})

    old, new = entry("sct", "jerk"), entry("sct", "jerk", "at_fault_rate")
    assert Standings(None, [old], [new], {}, {}, []).shown == ["sct", "jerk"]
    assert Standings(None, [], [old, new], {}, {}, []).shown == ["at_fault_rate", "sct", "jerk"]


def test_every_board_ranks_by_the_score():
    assert "score" in MEASURED
    assert "score" not in SHOWN  # it has a column of its own
    assert set(SHOWN) <= {*MEASURED, *OF_FLEETS}


def test_a_ranked_run_that_waits_for_a_core_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ranked_run.tempfile, "gettempdir", lambda: str(tmp_path))
    with contextlib.ExitStack() as first, contextlib.ExitStack() as second:
        assert ranked_run._wait_for_core([0], first) == 0
        ends = iter([lambda: None, first.close])  # the core is free after the second look
        monkeypatch.setattr(ranked_run.time, "sleep", lambda seconds: next(ends)())
        assert ranked_run._wait_for_core([0], second) == 0
    assert capsys.readouterr().err == "waiting for a core: other ranked runs use all of them\n"
