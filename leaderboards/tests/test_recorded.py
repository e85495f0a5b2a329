"""Boards whose people were recorded."""

import shutil

import numpy as np
import pytest
from boards_site import build_site
from small_boards import BOARD, SEASON, card, make_key, verify, write_board

from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import find_board, read_board
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.fill import freeze_entries
from crowdbench_leaderboards.pages.readme import section
from crowdbench_leaderboards.pages.standings import blocks_of_time, standings
from crowdbench_leaderboards.season import read_season
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verification import Verifier

TWO_SCENES = BOARD.replace("version = 1", "version = 1\nrecorded = true").replace(
    "public_cases = 8", "public_cases = 2"
)
TWO_SCENES = TWO_SCENES.replace('["circle_crossing_5"]', '["eth_reactive", "hotel_reactive"]')

NOT_TRAINED_ON_THE_SCENE = """
from crowdbench import Planner

class Careful(Planner):
    facts = {"network": "mine"}

    def for_held_out_scene(self, scene):
        other = Careful()
        other.facts = {"network": "mine", "weights": f"all but {scene}"}
        return other

    def plan(self, obs):
        return 0.1 * (obs.vehicle.local_goal - obs.vehicle.position)

def planner():
    return Careful()
"""

RECORDED = BOARD.replace("version = 1", "version = 1\nrecorded = true").replace("circle_crossing_5", "eth_reactive")


@pytest.mark.parametrize(
    ("text", "data", "sentence"),
    [
        (RECORDED, None, "the people of the board small were recorded: give their tracks, --data DIR"),
        (BOARD, "here", "--data does not go with the board small, whose people were not recorded"),
        (RECORDED, "here", "there is no folder here with the recorded tracks of the scene eth"),
    ],
)
def test_a_board_says_whether_it_needs_recorded_tracks(text, data, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    board = write_board(tmp_path, text=text)
    with pytest.raises(InputError, match=sentence):
        board.with_data(data and tmp_path.relative_to(tmp_path) / data)


def test_what_ranks_does_not_change_the_digest(tmp_path):
    board = write_board(tmp_path, text=RECORDED)
    shown = write_board(tmp_path, text=RECORDED.replace("recorded = true", "recorded = true\nranked = false"))
    assert board.digest == shown.digest


def test_a_board_refuses_tracks_that_it_does_not_need(tmp_path):
    with pytest.raises(InputError, match="--data does not go with the board five"):
        find_board("five").with_data(tmp_path)


@pytest.fixture(scope="module")
def root(shared, tmp_path_factory):
    """A folder of boards with two verified entries of a board whose people were recorded."""
    folder = tmp_path_factory.mktemp("recorded")
    root, work = folder / "leaderboards", folder / "work"
    board = write_board(root, text=RECORDED).with_data(shared / "data" / "eth_ucy")
    (root / "season.toml").write_text(SEASON)
    for name in ("orca", "straight"):
        (folder / "card.toml").write_text(card(title=f'"{name}"'))
        submit(Submission(board, name, name, {}, [], folder / "card.toml"), root, work)
    season, key = freeze_entries(board, root), make_key(folder, root)
    for entry in read_entries(board, root).good:
        assert Verifier(board, root, work, {}).verify_in_season(entry, season, key).verdict == "re-run"
    return root


@pytest.mark.slow
def test_entries_are_ranked_by_blocks_of_time(root):
    board = read_board(root / "small")
    found = standings(board, read_entries(board, root), read_season(root))
    assert {one.entry.name for one in found.ranked} == {"orca", "straight"}
    assert all(len(np.unique(one.episodes["eth_reactive"].block)) == 10 for one in found.ranked)
    assert len(np.unique(blocks_of_time(board, found.ranked)[0])) == 10
    assert "10 cases of each scenario." in section(found)


@pytest.mark.slow
def test_a_board_that_shows_has_no_ranks(root, tmp_path):
    shutil.copytree(root, tmp_path / "boards")
    write_board(tmp_path / "boards", text=RECORDED.replace("recorded = true", "recorded = true\nranked = false"))
    board = read_board(tmp_path / "boards" / "small")
    found = standings(board, read_entries(board, tmp_path / "boards"), None)
    assert [one.reason for one in found.others] == ["not ranked", "not ranked"]


@pytest.mark.slow
def test_pages_show_no_tracks(root, tmp_path):
    folder = build_site(root, tmp_path) / "leaderboards" / "small"
    assert not list(folder.rglob("*.rrd"))
    assert not (folder / "replay").exists()
    assert "their tracks may not be redistributed" in (folder / "entries" / "orca.html").read_text()


@pytest.mark.nightly
def test_a_planner_has_other_weights_in_each_scene_and_is_verified(shared, tmp_path):
    board = write_board(tmp_path / "boards", text=TWO_SCENES).with_data(shared / "data" / "eth_ucy")
    (tmp_path / "careful.py").write_text(NOT_TRAINED_ON_THE_SCENE)
    (tmp_path / "card.toml").write_text(card())
    submission = Submission(board, "careful", str(tmp_path / "careful.py"), {}, [], tmp_path / "card.toml")
    entry, failed = submit(submission, tmp_path / "boards", tmp_path / "work")
    assert failed == {}
    assert entry.spec.facts == {
        "eth_reactive": {"network": "mine", "weights": "all but eth"},
        "hotel_reactive": {"network": "mine", "weights": "all but hotel"},
    }
    found = verify(entry, board, work=tmp_path / "work", cases=Cases("test", 0, 2))
    assert (found.verdict, found.reason[:20]) == ("re-run", "the recorded command")
