"""The study of PSS-Social: its rows, both measures, and what is only reported."""

from pathlib import Path

import numpy as np
import pytest

from crowdbench import InputError
from crowdbench.utils.toml import Location
from studies.command import make_runs
from studies.pages import read_file
from studies.pss_social.table import HostedStudy, SceneSpec, SceneTable

ROOT = Path(__file__).parents[2]
SQUARE = str(ROOT / "adapters" / "pss_social" / "square.toml")
DRIVEN = str(ROOT / "adapters" / "pss_social" / "in_mpe.py")
HERE = Location("run.toml")


def spec(*rows):
    return SceneSpec(title="Scene", scenario=SQUARE, cases="val:6", pedestrians=[2, 12], rows=list(rows))


def test_the_file_of_the_study_reports_a_rate_for_each_number_of_pedestrians():
    study = read_file(ROOT / "studies" / "pss_social" / "run.toml", HostedStudy)
    first, ours, elsewhere = study.scenes
    for row in first.rows:
        assert len(row.success) == len(row.without_contact) == len(first.pedestrians)
        assert all(free <= success for free, success in zip(row.without_contact, row.success, strict=True))
    assert [len(row.weights) for row in first.rows] == [5, 5, 5, 5, 5, 0, 0, 0]
    assert ours.pedestrians == first.pedestrians
    assert not elsewhere.pedestrians


def test_both_measures_and_the_reported_rates_are_in_the_table(tmp_path):
    straight = {"label": "straight", "planner": DRIVEN, "options": {"name": "straight", "scale": 2.0}}
    reported = {"success": [0.0, 0.5], "without_contact": [0.0, 0.25]}
    table = SceneTable.of(spec({**straight, **reported}, {"label": "theirs", **reported}), tmp_path, HERE)
    assert len(table.runs) == 2
    make_runs(table.runs, tmp_path)
    few, many, *theirs = table.fill(tmp_path).rows
    assert few.measured[0].mean == 1.0  # contacts do not end an episode
    assert 0.0 <= many.measured[1].mean < many.measured[0].mean
    assert few.comparisons == [False, False]
    assert [row.cells() for row in theirs] == [
        ["theirs", "2", "0.0", "", "0.0", ""],
        ["theirs", "12", "50.0", "", "25.0", ""],
    ]
    page = table.fill(tmp_path).markdown()
    assert "| straight | 2 | 0.0 | 100.0" in page
    inside = sum(few.comparisons) + sum(many.comparisons)
    assert f"{inside} of 4 reported rates are within the measured intervals." in page


def test_columns_without_reported_rates_are_left_out_and_a_scene_may_stay_as_it_is(tmp_path):
    row = {"label": "straight", "planner": "straight"}
    table = SceneTable.of(
        SceneSpec(title="Other", scenario="circle_crossing_5", cases="val:2", rows=[row]), tmp_path, HERE
    )
    make_runs(table.runs, tmp_path)
    (grid,) = table.fill(tmp_path).grids()
    assert grid.header == ("planner", "success, %", "without contact, %")
    assert np.shape(grid.rows) == (1, 3)


def test_absent_weights_get_one_sentence(tmp_path):
    row = {"label": "mine", "planner": str(ROOT / "adapters" / "pss_social" / "pss_social.py"), "weights": ["absent"]}
    with pytest.raises(InputError, match=r"in rows.*absent.safetensors cannot be read") as error:
        SceneTable.of(spec(row), tmp_path, HERE)
    assert "\n" not in str(error.value)
