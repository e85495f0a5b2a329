"""Planners among several pedestrian policies."""

import json
import re

import numpy as np

from crowdbench.utils import Format
from studies.people.planners import planners, with_interval


def test_the_difference_is_that_of_the_scores_in_the_same_cases(tmp_path, capsys):
    chosen = {"planner": ["straight", "orca"], "pedestrians": ["straight", "orca"], "cases": "val:3"}
    planners(scenario="circle_crossing_5_visible", out=tmp_path, format=Format.JSON, **chosen)
    rows = {row["planner"]: row for row in json.loads(capsys.readouterr().out)}
    assert {row["straight"]["rank"] for row in rows.values()} == {1, 2}
    planners(scenario="circle_crossing_5_visible", out=tmp_path, **chosen)
    page = capsys.readouterr().out
    gained = rows["orca"]["orca"]["score"] - rows["orca"]["straight"]["score"]
    assert f"{gained:+.3f} (" in page


def test_the_interval_contains_the_mean_and_is_a_point_without_spread():
    assert with_interval(np.full(9, 0.25)) == "0.250 (0.250 to 0.250)"
    mean, low, high = map(float, re.findall(r"[\d.]+", with_interval(np.arange(50) / 50)))
    assert low < mean == 0.49 < high
