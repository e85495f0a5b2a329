import pickle
import shutil
import tomllib

import numpy as np
import pytest

from crowdbench import catalog, read_suite
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import ROOT, find_board, read_board, read_boards

BOARD = """
title = "Five"
description = "Five pedestrians"
version = 1
cases = 4
[families]
circle = ["circle_crossing_5", "circle_crossing_10"]
square = ["square_crossing_5"]
"""


def write(tmp_path, text=BOARD):
    (tmp_path / "five").mkdir(exist_ok=True)
    (tmp_path / "five" / "board.toml").write_text(text)
    return tmp_path / "five"


def test_families_count_alike_and_so_do_the_scenarios_in_them(tmp_path):
    board = read_board(write(tmp_path))
    assert board.scenarios == ["circle_crossing_5", "circle_crossing_10", "square_crossing_5"]
    np.testing.assert_allclose(board.weights, [0.25, 0.25, 0.5])


def test_a_seed_reaches_every_case_of_every_scenario(tmp_path):
    board = read_board(write(tmp_path))
    for public, other in zip(board.load(None), board.load(7), strict=True):
        starts = [scenario.worlds(board.cases).position[:, 1:] for scenario in (public, other)]
        assert not (starts[0] == starts[1]).all(axis=(1, 2)).any()


def test_a_board_with_loaded_scenarios_crosses_to_another_process():
    board = read_board(ROOT / "suite_realistic")
    digest, sent = board.digest, pickle.dumps(board)
    assert b"crowdbench_plugins" not in sent  # the modules of policies, which another process cannot import
    assert pickle.loads(sent).digest == digest


def test_boards_are_listed_by_their_position(tmp_path):
    write(tmp_path)
    (tmp_path / "later").mkdir()
    (tmp_path / "later" / "board.toml").write_text(BOARD.replace("version = 1", "version = 1\nposition = 1"))
    assert [board.name for board in read_boards(tmp_path)] == ["later", "five"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"Five"', '"Other"'),
        ('"Five pedestrians"', '"Other"'),
        ("version = 1", "version = 1  # a comment"),
        ("version = 1", "version = 1\nposition = 7"),
        ("version = 1", "version = 1\nranked = false"),
        ("version = 1", 'version = 1\ncollision = "swept"'),
    ],
)
def test_a_text_or_a_default_in_a_board_changes_no_digest(tmp_path, old, new):
    digest = read_board(write(tmp_path)).digest
    assert read_board(write(tmp_path, BOARD.replace(old, new))).digest == digest


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("version = 1", "version = 7"),
        ("cases = 4", "cases = 7"),
        ("cases = 4", "cases = 4\npublic_cases = 7"),
        ("cases = 4", "cases = 4\nreplan_every = 7"),
        ("cases = 4", 'cases = 4\ncollision = "crowdnav"'),
        ('square = ["square_crossing_5"]', ""),
        ("circle_crossing_10", "circle_crossing_5_visible"),
    ],
)
def test_every_other_rule_is_another_digest(tmp_path, old, new):
    digest = read_board(write(tmp_path)).digest
    assert read_board(write(tmp_path, BOARD.replace(old, new))).digest != digest


def scenarios_with(tmp_path, monkeypatch, name, change):
    """Change the file of a scenario in a copy of the scenarios."""
    if not (tmp_path / "scenarios").exists():
        shutil.copytree(catalog.SCENARIOS, tmp_path / "scenarios")
        monkeypatch.setattr("crowdbench.catalog.SCENARIOS", tmp_path / "scenarios")
    path = next((tmp_path / "scenarios").rglob(f"{name}.toml"))
    path.write_text(change(path.read_text()))


def test_a_changed_scenario_is_another_board_and_another_text_is_not(tmp_path, monkeypatch):
    folder = write(tmp_path)
    digest = read_board(folder).digest
    scenarios_with(tmp_path, monkeypatch, "square_crossing_5", lambda text: f"# a comment\n{text}")
    assert read_board(folder).digest == digest
    scenarios_with(
        tmp_path, monkeypatch, "square_crossing_5", lambda text: text.replace("[vehicle]", "[vehicle]\nradius = 0.31")
    )
    assert read_board(folder).digest != digest


def test_another_version_of_the_simulator_is_another_board(tmp_path, monkeypatch):
    digest = read_board(write(tmp_path)).digest
    monkeypatch.setattr("crowdbench_leaderboards.board.SIMULATOR", 10**6)
    assert read_board(write(tmp_path)).digest != digest


def test_a_board_of_recorded_people_has_a_digest_without_their_tracks(tmp_path, monkeypatch):
    text = BOARD.replace("version = 1", "version = 1\nrecorded = true").split("circle = ")[0]
    folder = write(tmp_path, f'{text}zara = ["zara1_reactive"]')
    digest = read_board(folder).digest
    scenarios_with(tmp_path, monkeypatch, "zara1_reactive", lambda text: text.replace("radius = 0.3", "radius = 0.31"))
    assert (other := read_board(folder).digest) != digest
    monkeypatch.setattr("crowdbench_leaderboards.board.known_files", lambda scene: {"a.txt": "0" * 64})
    assert read_board(folder).digest not in (digest, other)
    monkeypatch.setattr("crowdbench_leaderboards.board.known_files", lambda scene: {})
    with pytest.raises(InputError, match="zara1_reactive names no recorded tracks whose sha256 is known"):
        read_board(folder).digest  # noqa: B018


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('title = "Five"', "", r"^five/board\.toml: title is missing, but must be a text in quotes, not an empty one$"),
        (
            "cases",
            "case",
            r"^five/board\.toml: unknown key case .did you mean cases.*; the keys here are title, description, ",
        ),
        (
            "circle_crossing_10",
            "nowhere",
            r"^five/board\.toml: in families, no scenario is called 'nowhere'; there",
        ),
        ("square_crossing_5", "circle_crossing_5", r"^five/board\.toml: the scenario circle_crossing_5 is in two fam"),
    ],
)
def test_what_is_wrong_in_a_board_gets_one_sentence(old, new, sentence, tmp_path):
    assert old in BOARD
    with pytest.raises(InputError, match=sentence):
        read_board(write(tmp_path, BOARD.replace(old, new)))


@pytest.mark.parametrize(("name", "has_detector"), [("suite", False), ("suite_realistic", True)])
def test_a_board_of_the_suite_has_the_ranked_scenarios_in_one_track_of_sensing(name, has_detector):
    board = find_board(name)
    assert board.scenarios == read_suite().ranked
    assert {scenario.rules.sensor.detector is not None for scenario in board.load(7)} == {has_detector}


def test_a_board_without_a_track_has_no_track_in_its_rules():
    assert "track" not in find_board("five").parts["rules"]
    assert "sensor.track" not in find_board("five").overrides(7)


def test_every_board_that_ships_is_in_the_wheel():
    rules = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    boards = [path.parent.name for path in sorted(ROOT.glob("*/board.toml"))]
    assert list(rules["force-include"]) == [f"{name}/board.toml" for name in boards]
