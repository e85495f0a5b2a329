import re

import numpy as np
import pytest
from studies import CROWDS, episodes, leave, read

from crowdbench.metrics.summary import bootstrap
from crowdbench.runs.compare import compare
from crowdbench.runs.result_file import read_result
from crowdbench.study.crowds import CrowdRow, FilledCrowd, Pair
from crowdbench.study.folder import make_in_folder, run_directory
from crowdbench.study.measures import LEAST_SHARED
from crowdbench.utils.tables import printed_by

pytestmark = pytest.mark.usefixtures("study_folder")

MEASURES = ("navigation_time", "discomfort", "jerk", "minimum_gap")


def side_by_side(**better):
    """Two runs of 20 cases, both solving the first 12; the second is smaller by `better` in the measures named."""
    success = [1] * 12 + [0] * 8
    noise = np.random.default_rng(5).normal(size=(2, 4, 20))
    one = {name: 5.0 + noise[0, i] for i, name in enumerate(MEASURES)}
    two = {name: one[name] + 0.1 * noise[1, i] - better.get(name, 0.0) for i, name in enumerate(MEASURES)}
    return episodes(success, **one), episodes(success, **two)


def test_a_pair_differs_in_the_measures_whose_intervals_exclude_0():
    pair = Pair.of(("a", "b"), *side_by_side(navigation_time=1.0, minimum_gap=0.5, jerk=-0.5))
    assert pair.better == {"navigation_time": "b", "minimum_gap": "a", "jerk": "a"}
    assert pair.cell() == "better: time; worse: jerk, gap"
    assert (pair.p, pair.both_solved) == (1.0, 12)
    assert Pair.of(("a", "b"), *side_by_side()).cell() == "no significant difference"


def test_success_differs_by_mcnemar():
    columns = {name: np.ones(12) for name in MEASURES}
    all_of_them, most, half = (episodes([1] * n + [0] * (12 - n), **columns) for n in (12, 7, 6))
    assert Pair.of(("a", "b"), all_of_them, half).better == {"success_rate": "a"}
    assert Pair.of(("a", "b"), half, all_of_them).cell() == "better: success"
    assert Pair.of(("a", "b"), half, all_of_them).p == 2 * 0.5**6
    assert Pair.of(("a", "b"), all_of_them, most).cell() == "no significant difference"


def test_a_few_shared_successes_are_no_evidence_and_the_cell_says_so():
    def pair(shared):
        columns = {name: np.ones(10) for name in MEASURES}
        success = [1] * shared + [0] * (10 - shared)
        slower = columns | {"navigation_time": np.full(10, 2.0)}
        return Pair.of(("a", "b"), episodes(success, **columns), episodes(success, **slower)).cell()

    assert pair(LEAST_SHARED) == "worse: time"
    assert pair(LEAST_SHARED - 1) == "no significant difference (5 solved by both)"
    assert pair(0) == "no significant difference (0 solved by both)"


def test_the_tables_of_a_crowd_are_what_one_computes_by_hand(tmp_path):
    study = read('description = "What is compared"\n' + CROWDS.replace('"8"', '"20"'))
    for better, runs in zip((0, 4), study.tables[0].by_scenario, strict=True):
        one, two = side_by_side(navigation_time=1.0)
        two.columns["success_rate"][12 : 12 + better] = True
        # What a failure has says nothing of those who arrive.
        one.columns["minimum_gap"][12:] = -5.0
        one.columns["minimum_gap"][:12] = 0.25
        one.columns["discomfort"][:12] = 0.125
        one.columns["at_fault_rate"][12:16] = True
        leave(runs[0], tmp_path, one)
        leave(runs[1], tmp_path, two)
    text = study.page(study.fill(tmp_path), "study tiny.toml")
    head = text.split("\n\n")[:3]
    assert head == [printed_by("study tiny.toml"), "What is compared", "## Crowds"]
    assert re.findall("^##+ .*", text, re.MULTILINE) == ["## Crowds", "### circle_crossing_5", "### square_crossing_5"]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]
    assert lines[0] == ["success", "orca", "orca_margin"]
    assert lines[2:4] == [
        ["circle_crossing_5", "**60.0 %**", "**60.0 %**"],
        ["square_crossing_5", "60.0 %", "**80.0 %**"],
    ]
    crowd = lines[4:]
    assert crowd[0] == ["planner", "success", "collision", "at fault", "time-out", "time", "discomfort", "jerk", "gap"]
    assert crowd[2][:5] == ["orca", "60.0 % (38.7 to 78.1)", "40.0 %", "20.0 %", "0.0 %"]
    time = bootstrap(one.columns["navigation_time"][:12], np.ones(12))
    assert crowd[2][5] == f"{time.mean:.2f} s ({time.low:.2f} to {time.high:.2f})"
    assert crowd[2][6] == "12.50 % (12.50 to 12.50)"
    assert crowd[2][8] == "0.250 m (0.250 to 0.250)"
    assert crowd[4] == ["significantly better or worse than", "orca"]
    assert crowd[6][0] == "orca_margin"
    assert crowd[6][1].startswith("better: time")
    assert "The 5 tests in a crowd are not corrected" in text


def test_a_planner_may_have_options():
    runs = read(CROWDS.replace('"orca_margin"', '{ planner = "orca", options = { safety_space = 0.2 } }')).runs
    assert [run.label for run in runs[:2]] == ["orca", "orca (safety_space=0.2)"]
    assert runs[1].spec.options == {"safety_space": 0.2}


@pytest.mark.slow
def test_a_pair_differs_as_crowdbench_compare_says(tmp_path):
    table = read(CROWDS.replace('"8"', '"40"')).tables[0]
    for one in table.runs:
        make_in_folder(one, tmp_path, lambda done: None)
    found = table.fill(tmp_path)
    for runs, crowd in zip(table.by_scenario, found.crowds, strict=True):
        expected = compare(*(run_directory(one, tmp_path) for one in runs))
        (pair,) = crowd.pairs
        assert pair.both_solved == expected.both_solved > LEAST_SHARED
        assert pair.p == expected.rows["success_rate"].p
        for name, difference in pair.differences.items():
            row = expected.rows[name].difference
            assert (difference.mean, difference.low, difference.high) == pytest.approx((row.mean, row.low, row.high))
        rates = [entrant.success_rate.mean for entrant in crowd.planners]
        assert rates == [read_result(run_directory(one, tmp_path))["metrics"]["success_rate"]["mean"] for one in runs]


def test_collisions_with_walls_are_shown_where_there_are_any():
    run = read(CROWDS).tables[0].runs[0]
    columns = {name: np.ones(12) for name in MEASURES}
    walls = np.arange(12) >= 9
    for hit, header in [
        (walls, "| collision | at fault | with a wall | time-out |"),
        (walls & ~walls, "| collision | at fault | time-out |"),
    ]:
        made = CrowdRow.of(run, episodes([1] * 9 + [0] * 3, **columns, wall_collision_rate=hit))
        assert header in FilledCrowd("doorway", [made], []).markdown()
        assert ("| 25.0 % | 0.0 % | 25.0 % |" in FilledCrowd("doorway", [made], []).markdown()) == hit.any()
