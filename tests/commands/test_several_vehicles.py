"""Runs with several vehicles: stored, replayed, compared, and with other planners in the other vehicles."""

import csv

import numpy as np
import pytest

from crowdbench.record.recorded_cases import recorded_outcomes
from crowdbench.results.compare import compare
from crowdbench.results.episodes import Episodes
from crowdbench.results.run_result import RunResult
from crowdbench.runs.loading import load_run
from crowdbench.runs.make import make_run
from crowdbench.runs.merge import merge
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a run of all vehicles, one of the same cases in two parts, and one with other planners."""
    place = tmp_path_factory.mktemp("fleet")
    for name, cases, others in (
        ("all", "4", None),
        ("first", "2", None),
        ("second", "2:4", None),
        ("mixed", "4", "orca"),
    ):
        make_run(load_run(RunSpec("straight", "fleet_4", Cases.parse(cases), others=others)), place / name)
    return place


def test_a_run_has_a_row_for_each_vehicle_and_replays_to_the_last_bit(folder, call):
    episodes = Episodes.read(folder / "all" / "episodes.csv")
    assert episodes.case.tolist() == np.arange(4).repeat(4).tolist()
    assert episodes.vehicle.tolist() == [0, 1, 2, 3] * 4
    assert episodes.block.tolist() == episodes.case.tolist(), "vehicles of a case are not independent"
    worst = episodes.columns["score"].reshape(4, 4).min(axis=1)
    assert episodes.columns["worst_score"].tolist() == worst.repeat(4).tolist()
    for name in ("all", "mixed"):
        done = call("score", str(folder / name))
        assert done.returncode == 0, done.stdout + done.stderr
        assert "to the last bit" in done.stdout


def test_a_recording_has_one_episode_of_each_case(folder, call):
    episodes = Episodes.read(folder / "all" / "episodes.csv")
    recorded = recorded_outcomes(folder / "all" / "run.rrd")
    assert list(recorded) == [0, 1, 2, 3]
    for case, outcome in recorded.items():
        ends = episodes.outcome[episodes.case == case]
        assert (outcome == "success") == (ends == 1).all(), "the first failure is shown"
    done = call("render", str(folder / "all"), "--case", "1", "--out", str(folder / "case.png"))
    assert done.returncode == 0, done.stderr


def test_parts_of_a_run_are_merged_into_the_same_rows(folder):
    merge([folder / "first", folder / "second"], folder / "merged")
    assert (folder / "merged" / "episodes.csv").read_bytes() == (folder / "all" / "episodes.csv").read_bytes()


def test_with_other_planners_only_the_first_vehicle_is_scored(folder):
    mixed = RunResult.read(folder / "mixed")
    assert mixed.label == "straight (others=orca)"
    assert mixed.episodes.vehicle.tolist() == [0] * 4
    assert mixed.commands.case.tolist() == np.arange(4).repeat(4).tolist()
    assert mixed.result["run"]["others"]["name"] == "orca"
    assert "others" not in RunResult.read(folder / "all").result["run"]
    assert compare(folder / "all", folder / "mixed").cases == 4, "the first vehicles are paired"
    assert compare(folder / "all", folder / "all").cases == 16


def test_a_cut_table_of_vehicles_is_noticed(folder):
    run = RunResult.read(folder / "all")
    few = run.episodes.take(np.flatnonzero(run.episodes.vehicle < 3))
    with pytest.raises(InputError, match="its cases differ from test:0:4"):
        RunResult(run.directory, run.result, few).check(rows_only=True)


@pytest.mark.slow
def test_cross_prints_a_matrix_in_each_format(call, tmp_path):
    given = ("cross", "straight", "orca", "--cases", "3", "--out", str(tmp_path))
    done = call(*given, "--picture", str(tmp_path / "cross.svg"))
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1].split() == ["planner", "straight", "orca", "strangers"]
    assert (tmp_path / "cross.svg").read_text().startswith("<?xml")
    rows = list(csv.DictReader(call(*given, "--format", "csv").stdout.splitlines()))
    assert [row["planner"] for row in rows] == ["straight", "orca"]
    assert rows[0]["strangers.mean"] == rows[0]["orca.mean"]
    assert float(rows[1]["orca.mean"]) > float(rows[0]["straight.mean"])
    assert "toprule" in call(*given, "--format", "latex").stdout


@pytest.mark.slow
def test_cross_with_workers_prints_the_same_matrix(call, tmp_path):
    given = ("cross", "straight", "orca", "--cases", "4", "--format", "csv")
    alone = call(*given, "--out", str(tmp_path / "alone"))
    together = call(*given, "--out", str(tmp_path / "together"), "--workers", "2")
    assert alone.returncode == together.returncode == 0, together.stderr
    assert alone.stdout == together.stdout


def test_wrong_teams_get_one_sentence(call, tmp_path):
    done = call("run", "--planner", "orca", "--others", "orca", "--cases", "1", "--out", str(tmp_path / "a"))
    assert done.returncode != 0
    assert "circle_crossing_5 has one vehicle" in done.stderr
    done = call("cross", "orca", "straight", "--scenario", "circle_20")
    assert done.stderr.startswith("crowdbench: circle_20 has one vehicle, but planners meet in a scenario with several")
    done = call("cross", "orca")
    assert done.returncode != 0
    assert "two or more different ones" in done.stderr
