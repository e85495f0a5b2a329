import numpy as np
import pytest

from crowdbench.boards.board import read_board, read_boards
from crowdbench.boards.markdown import section
from crowdbench.boards.standings import standings
from crowdbench.utils.errors import InputError

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


def test_a_slow_entry_drives_500_cases_of_all_scenarios_together(tmp_path):
    many = read_board(write(tmp_path, BOARD.replace("cases = 4", "cases = 400")))
    assert len(many.cases_at(0.5)) == 400
    assert len(many.cases_at(1.5)) == 500 // 3
    few = read_board(write(tmp_path))
    assert len(few.cases_at(1.5)) == 4


def test_closed_boards_stand_last(tmp_path):
    first = BOARD.replace("version = 1", "version = 1\nposition = 1\nclosed = true")
    write(tmp_path, first)
    (tmp_path / "later").mkdir()
    (tmp_path / "later" / "board.toml").write_text(BOARD)
    assert [board.name for board in read_boards(tmp_path)] == ["later", "five"]
    assert "## Five (`five`) (closed)" in section(standings(read_boards(tmp_path)[1], [], None))


def test_the_digest_is_of_the_rules_alone(tmp_path):
    digest = read_board(write(tmp_path)).digest
    for same in ('"Five"', '"Five pedestrians"'):
        assert read_board(write(tmp_path, BOARD.replace(same, '"Other"'))).digest == digest
    for other in ("cases = 4", "version = 1"):
        assert read_board(write(tmp_path, BOARD.replace(other, f"{other[:-1]}7"))).digest != digest


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('title = "Five"', "", r"^five/board\.toml: title is missing, but must be a text in quotes, not an empty one$"),
        ("cases", "case", r"^five/board\.toml: unknown key case; the keys here are title, description, version, "),
        (
            "circle_crossing_10",
            "nowhere",
            r"^five/board\.toml: in families, no scenario is called 'nowhere'; there",
        ),
        ("square_crossing_5", "circle_crossing_5", r"^five/board\.toml: the scenario circle_crossing_5 is in two fam"),
        (
            "cases = 4",
            "sct_scale = [0.9, 0.2]",
            r"sct_scale is .*, but must be two numbers from 0 to 1, the smaller one first$",
        ),
        (
            "cases = 4",
            "sct_scale = [0.2]",
            r"sct_scale is .*, but must be two numbers from 0 to 1, the smaller one first$",
        ),
    ],
)
def test_what_is_wrong_in_a_board_gets_one_sentence(old, new, sentence, tmp_path):
    assert old in BOARD
    with pytest.raises(InputError, match=sentence):
        read_board(write(tmp_path, BOARD.replace(old, new)))
