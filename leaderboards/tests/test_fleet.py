"""A board of several vehicles: an entry drives all of them, or the first one among vehicles of planners that ship."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from board_entries import PLANNER, change_rows, submitted
from small_boards import SEASON, SHIPPED, make_key, verifier, verify, write_board

from crowdbench.core.types import Outcome
from crowdbench.isolation import sandbox
from crowdbench.results.episodes import Episodes
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board_runs import CaseSet
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.fill import freeze_entries
from crowdbench_leaderboards.means import case_means
from crowdbench_leaderboards.pages.readme import write_readme
from crowdbench_leaderboards.pages.replay import write_replay
from crowdbench_leaderboards.pages.standings import standings
from crowdbench_leaderboards.ranked_run import drive_ranked, read_ranked
from crowdbench_leaderboards.verdict import Verdict
from crowdbench_leaderboards.verification import replay_public

BOARD = """
title = "Fleet"
description = "Three unicycles at a door"
version = 1
cases = 3
public_cases = 2
[families]
self_play = ["fleet_door_3"]
cross_play = ["fleet_door_3+straight"]
"""

needs_sandbox = pytest.mark.skipif(sandbox.level() == sandbox.PROCESS, reason="verification needs bubblewrap")


@pytest.fixture(scope="module")
def entered(tmp_path_factory):
    """A folder with a board of several vehicles, and an entry on it."""
    folder = tmp_path_factory.mktemp("fleet")
    write_board(folder / "boards", text=BOARD)
    return folder, *submitted(folder, PLANNER)


@needs_sandbox
@pytest.mark.slow
def test_an_entry_of_a_fleet_is_verified_and_ranks(entered):
    folder, entry, board = entered
    root = folder / "boards"
    (root / "season.toml").write_text(SEASON)
    (root / "shipped.toml").write_text(SHIPPED)
    setting = verifier(root, folder / "work")
    season, key = freeze_entries(board, root), make_key(folder, root)
    found = setting.verify_in_season(entry, season, key)
    assert found.verdict == Verdict.RERUN, found.reason

    table = standings(board, read_entries(board, root), season)
    (one,) = table.ranked
    alone, among = (one.episodes[name] for name in board.scenarios)
    assert alone.vehicle.tolist() == [0, 1, 2] * 3
    assert among.vehicle.tolist() == [0] * 3
    score = alone.columns["score"].reshape(3, 3)
    assert one.figures["score"].mean == pytest.approx(0.5 * score.mean() + 0.5 * among.columns["score"].mean())
    assert one.figures["worst_score"].mean == pytest.approx(score.min(axis=1).mean())
    assert "worst_score" in table.shown
    assert "score of the worst vehicle" in write_readme(root).read_text()
    assert write_replay(board, [entry], folder / "page") == {}


def test_public_cases_have_the_commands_of_the_vehicles_of_the_entry(entered):
    _, entry, board = entered
    table = pq.read_table(entry.directory / "public.parquet")
    assert table["scenario"].to_pylist() == ["fleet_door_3"] * 6 + ["fleet_door_3+straight"] * 2
    assert table["vehicle"].to_pylist() == [0, 1, 2] * 2 + [0, 0]
    assert replay_public(entry, board).keys() == set(board.scenarios)


@pytest.mark.parametrize("command", [[0.0] * 2000, [0.0] * 3, [9.0, 9.0], [float("nan")] * 2, []])
def test_no_command_of_a_stranger_stops_the_pages(command, entered, tmp_path):
    _, entry, board = entered
    path, before = entry.directory / "public.parquet", (entry.directory / "public.parquet").read_bytes()
    change_rows(path, "command", lambda rows: [*rows[:-1], command])
    problems = write_replay(board, [entry], tmp_path / "page")
    path.write_bytes(before)
    assert problems.keys() == {"mine"}


@needs_sandbox
@pytest.mark.slow
def test_a_command_or_a_score_that_was_changed_is_not_reproduced(entered, tmp_path):
    _, entry, board = entered
    path, before = entry.directory / "public.parquet", (entry.directory / "public.parquet").read_bytes()
    for column, change in (
        ("command", lambda rows: [*rows[:-1], [0.0] * len(rows[-1])]),
        ("score", lambda rows: [*rows[:4], 0.99, *rows[5:]]),
        ("vehicle", lambda rows: [*rows[:-1], 1]),
    ):
        change_rows(path, column, change)
        assert verify(entry, board, tmp_path / "work").verdict == Verdict.NOT_REPRODUCED, column
        path.write_bytes(before)


def test_a_vehicle_among_others_is_timed_alone(entered):
    folder, entry, board = entered
    for task in verifier(folder / "boards", folder / "work").tasks(
        entry, CaseSet(board, board.cases, 7), folder / "runs"
    ):
        drive_ranked(task)
        run = read_ranked(task)
        assert run.episodes.case.tolist() == np.arange(3).repeat(board.scored_vehicles(task.scenario)).tolist()
        # One decision of all vehicles that still drive, until the last one has ended.
        assert len(run.seconds) == sum(run.episodes.steps[run.episodes.case == case].max() for case in range(3))


def test_the_mean_of_a_case_is_over_its_vehicles():
    case, columns = np.array([0, 0, 1, 1]), {"score": np.array([0.2, 0.4, 0.6, 1.0])}
    episodes = Episodes(case, np.full(4, Outcome.SUCCESS), np.ones(4, int), columns, case, np.array([0, 1, 0, 1]))
    assert case_means(episodes, "score") == pytest.approx([0.3, 0.8])


@pytest.mark.parametrize(
    ("scenario", "sentence"),
    [
        ("fleet_4+nobody", "needs a planner that ships, but none is called 'nobody'"),
        ("circle_crossing_5", "all scenarios of a board have several vehicles, or all have one"),
    ],
)
def test_a_wrong_board_gets_one_sentence(scenario, sentence, tmp_path):
    with pytest.raises(InputError, match=sentence):
        write_board(tmp_path, text=BOARD.replace("fleet_door_3+straight", scenario))
    with pytest.raises(InputError, match="all have one"):
        write_board(tmp_path, text=BOARD.replace("fleet_door_3", "circle_crossing_5"))
