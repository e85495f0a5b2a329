"""The study of the suite: levels of its scenarios, and the order of planners in both tracks of sensing."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from crowdbench.catalog import read_suite
from crowdbench.cli.app import build_script
from crowdbench.metrics import Estimate
from studies.pages import read_file
from studies.suite.levels import FILE, LevelsSpec, levels
from studies.suite.run import FILE as ORDER
from studies.suite.run import Standing, SuiteSpec, order_grid, score_grid

FEW = """
description = "Few."
[[planners]]
planner = "straight"
cases = "val:2"
[[planners]]
planner = "orca"
cases = "val:1"
[levels]
street_8 = [0, 8]
"""


def standing(score):
    return Standing(
        {"circle_20": Estimate(score, score, score, 9, score)}, Estimate(score, 0.0, 1.0, 9, 1.0), score, 0.1
    )


def test_levels_have_the_scores_of_planners_and_their_spread(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("few.toml").write_text(FEW)
    result = CliRunner().invoke(build_script(levels), ["--file", "few.toml", "--format", "json"])
    assert result.exit_code == 0, result.output
    empty, full = json.loads(result.stdout)
    assert (empty["scenario"], empty["people"], full["people"]) == ("street_8", 0, 8)
    assert empty["scores"] == pytest.approx([1.0, 1.0], abs=0.05)
    assert full["scores"] != empty["scores"]


def test_every_ranked_scenario_has_levels_and_its_own_level_is_among_them():
    spec = read_file(FILE, LevelsSpec)
    assert sorted(spec.levels) == sorted(read_suite().ranked)
    assert [name for name, numbers in spec.levels.items() if int(name.rpartition("_")[2]) not in numbers] == []


def test_planners_of_the_order_have_a_place_on_the_earlier_suite():
    spec = read_file(ORDER, SuiteSpec)
    assert {each.planner for each in spec.planners} <= set(spec.earlier)
    assert len(spec.planners) >= 10


def test_the_order_shows_places_and_the_loss_between_tracks():
    planners = read_file(ORDER, SuiteSpec).planners[:2]
    one, two = (each.planner for each in planners)
    standings = {(one, "perfect"): 0.4, (one, "realistic"): 0.35, (two, "perfect"): 0.6, (two, "realistic"): 0.3}
    standings = {place: standing(score) for place, score in standings.items()}
    grid = order_grid(planners, {one: 70.0, two: 60.0}, standings)
    assert [row[0] for row in grid.rows] == [two, one]
    assert grid.rows[0][2:6] == ["2: 60.0", "1: 0.600 (0.000 to 1.000)", "2: 0.300 (0.000 to 1.000)", "0.300"]
    assert grid.rows[1][6:] == ["40 (10.0)", "35 (10.0)"]
    scores = score_grid("realistic", planners, ["circle_20"], standings)
    assert [row[:3] for row in scores.rows] == [[one, "0.350", "0.350"], [two, "0.300", "0.300"]]
