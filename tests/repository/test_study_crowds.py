import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from study_folders import CROWDS, episodes, leave, read_page

from crowdbench.catalog import load_scenario
from crowdbench.metrics.networks import mean_over_networks
from crowdbench.metrics.summary import bootstrap
from crowdbench.results.compare import compare
from crowdbench.results.paired import LEAST_SHARED
from crowdbench.results.result_file import read_result
from crowdbench.results.run_result import RunResult
from crowdbench.runs.folder import make_in_folder, run_directory
from crowdbench.utils.tables import printed_by
from studies.side_by_side import OVER_SOLVED, comparisons, verdict_grid

pytestmark = pytest.mark.usefixtures("study_folder")

MEASURES = OVER_SOLVED


def result(name, table):
    """A run of ORCA with these episodes."""
    scenario = {"name": "circle_crossing_5", **load_scenario("circle_crossing_5").table}
    planner = {"name": name, "options": {}}
    run = {"planner": planner, "replanning": {}, "scenario": "", "cases": f"test:{len(table)}", "simulator": 1}
    stated = {"overrides": {}, "privileged": False}
    return RunResult(Path(name), {"run": run, "scenario": scenario, "stated": stated}, table)


def pair(one, two):
    """Two planners, compared, and the cell that says how the second differs."""
    found = comparisons({"a": [result("a", one)], "b": [result("b", two)]})
    return found[0], verdict_grid(found).rows[0][1]


def side_by_side(**better):
    """Two runs of 20 cases, both solving the first 12; the second is smaller by `better` in the measures named."""
    success = [1] * 12 + [0] * 8
    noise = np.random.default_rng(5).normal(size=(2, 4, 20))
    one = {name: 5.0 + noise[0, i] for i, name in enumerate(MEASURES)}
    two = {name: one[name] + 0.1 * noise[1, i] - better.get(name, 0.0) for i, name in enumerate(MEASURES)}
    return episodes(success, **one), episodes(success, **two)


def test_a_pair_differs_in_the_measures_whose_intervals_exclude_0():
    found, cell = pair(*side_by_side(navigation_time=1.0, minimum_gap=0.5, jerk=-0.5))
    assert cell == "better: time; worse: jerk, smallest gap"
    assert (found.rows["success_rate"].p, found.both_solved) == (1.0, 12)
    assert pair(*side_by_side())[1] == "no significant difference"


def test_success_differs_by_mcnemar():
    columns = {name: np.ones(12) for name in MEASURES}
    all_of_them, most, half = (episodes([1] * n + [0] * (12 - n), **columns) for n in (12, 7, 6))
    assert pair(all_of_them, half)[1] == "worse: success"
    found, cell = pair(half, all_of_them)
    assert cell == "better: success"
    assert found.rows["success_rate"].p == 2 * 0.5**6
    assert pair(all_of_them, most)[1] == "no significant difference"


def test_a_few_shared_successes_are_no_evidence_and_the_cell_says_so():
    def cell(shared):
        columns = {name: np.ones(10) for name in MEASURES}
        success = [1] * shared + [0] * (10 - shared)
        slower = columns | {"navigation_time": np.full(10, 2.0)}
        return pair(episodes(success, **columns), episodes(success, **slower))[1]

    assert cell(LEAST_SHARED) == "worse: time"
    assert cell(LEAST_SHARED - 1) == "no significant difference (5 solved by both)"
    assert cell(0) == "no significant difference (0 solved by both)"


def test_the_tables_of_a_crowd_are_what_one_computes_by_hand(tmp_path):
    study = read_page('description = "What is compared"\n' + CROWDS.replace('"8"', '"20"'))
    for better, runs in zip((0, 4), study.tables[0].by_scenario, strict=True):
        one, two = side_by_side(navigation_time=1.0)
        two = episodes([1] * (12 + better) + [0] * (8 - better), **{name: two.columns[name] for name in MEASURES})
        # What a failure has says nothing of those who arrive.
        one.columns["minimum_gap"][12:] = -5.0
        one.columns["minimum_gap"][:12] = 0.25
        one.columns["discomfort"][:12] = 0.125
        one.columns["at_fault_rate"][12:16] = True
        one.columns["vehicle_share"][12:] = [0.1, 0.2, 0.4, 0.9, 0.02, 0.07, 0.09, np.nan]
        leave(runs[0], tmp_path, one)
        leave(runs[1], tmp_path, two)
    text = study.markdown(study.fill(tmp_path), "python studies/run.py tiny.toml")
    head = text.split("\n\n")[:3]
    assert head == [printed_by("python studies/run.py tiny.toml"), "What is compared", "## Crowds"]
    assert re.findall("^##+ .*", text, re.MULTILINE) == ["## Crowds", "### circle_crossing_5", "### square_crossing_5"]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]
    assert lines[0] == ["success, %", "circle_crossing_5", "square_crossing_5"]
    assert lines[2:4] == [["orca_margin", "**60.0**", "**80.0**"], ["orca", "**60.0**", "60.0"]]  # the best first
    # 4 of 20 cases from 0.1 on, as the column says; of the other planner's there are none.
    assert lines[4] == ["at fault from a share of", "0.05", "0.1", "0.2", "0.5"]
    assert lines[6:8] == [
        ["orca_margin", "0.0 %", "0.0 %", "0.0 %", "0.0 %"],
        ["orca", "30.0 %", "20.0 %", "15.0 %", "5.0 %"],
    ]
    crowd = lines[8:]
    failures = ["collisions, %", "at fault, %", "timeouts, %"]
    over_solved = ["time, s", "discomfort, %", "jerk, m/s^3", "smallest gap, m"]
    assert crowd[0] == ["planner", "success, %", *failures, *over_solved]
    assert crowd[2][:5] == ["orca", "60.0 (38.7 to 78.1)", "40.0", "20.0", "0.0"]
    time = bootstrap(one.columns["navigation_time"][:12], np.ones(12))
    assert crowd[2][5] == f"{time.mean:.3f} ({time.low:.3f} to {time.high:.3f})"
    assert crowd[2][6] == "12.50 (12.50 to 12.50)"
    assert crowd[2][8] == "0.250 (0.250 to 0.250)"
    assert crowd[4] == ["significantly better or worse than", "orca"]
    assert crowd[6][0] == "orca_margin"
    assert crowd[6][1].startswith("better: time")
    assert "The 5 tests of a scenario are not corrected" in text


def test_a_planner_with_several_networks_is_their_mean_over_networks_and_cases(tmp_path):
    planners = '["orca", { planner = "./mine.py", weights = ["one", "two"] }]'
    study = read_page(CROWDS.replace('["orca", "orca_margin"]', planners).replace('"8"', '"20"'))
    solved = [np.arange(20) < n for n in (8, 12, 16)]
    for runs in study.tables[0].by_scenario:
        assert [run.spec.options for run in runs] == [{}, {"weights": "one"}, {"weights": "two"}]
        for run, success, slower in zip(runs, solved, (0.0, 1.0, 2.0), strict=True):
            times = 10.0 + slower + 0.1 * np.arange(20)
            table = episodes(success, **dict.fromkeys(MEASURES, np.zeros(20)) | {"navigation_time": times})
            table.columns["at_fault_rate"][17:] = table.columns["vehicle_share"][17:] = slower > 1.0
            leave(run, tmp_path, table)
    filled = study.fill(tmp_path)
    (_, row), (pair,) = filled[0].crowds[0].planners, filled[0].crowds[0].pairs
    assert row["planner"] == "mine, 2 networks"
    expected = mean_over_networks(np.array(solved[1:], float))
    assert expected.low < 0.0 < 1.0 < expected.high
    assert row["success_rate"] == dataclasses.replace(expected, low=0.0, high=1.0)
    assert row["at_fault_rate"].mean == pytest.approx(3 / 20 / 2)
    assert filled[0].crowds[0].at_fault["mine, 2 networks"] == pytest.approx([3 / 20 / 2] * 4)
    over_solved = [
        np.mean(10.0 + slower + 0.1 * np.flatnonzero(own)) for own, slower in ((solved[1], 1), (solved[2], 2))
    ]
    assert row["navigation_time"].mean == pytest.approx(np.mean(over_solved))
    # In the 8 cases that all solve, the networks are 1 s and 2 s slower: t of two networks is 12.7.
    assert pair.both_solved == 8
    difference = pair.rows["navigation_time"].difference
    assert difference.mean == pytest.approx(1.5)
    assert difference.high - difference.mean == pytest.approx(12.706 * 0.5, rel=1e-3)
    success = pair.rows["success_rate"].difference
    assert success.mean == pytest.approx(6 / 20)
    # Two networks, of which one solves 4 cases more and the other 8: nothing is sure.
    assert not pair.rows["success_rate"].is_significant
    assert "A planner with several networks" in study.markdown(filled, "")


@pytest.mark.slow
def test_a_pair_differs_as_crowdbench_compare_says(tmp_path):
    table = read_page(CROWDS.replace('"8"', '"40"')).tables[0]
    for one in table.runs:
        make_in_folder(one, tmp_path, lambda done: None)
    found = table.fill(tmp_path)
    for runs, crowd in zip(table.by_scenario, found.crowds, strict=True):
        expected = compare(*(run_directory(one, tmp_path) for one in runs))
        (found,) = crowd.pairs
        assert found.both_solved == expected.both_solved > LEAST_SHARED
        assert found.rows == {name: expected.rows[name] for name in ("success_rate", *MEASURES)}
        rates = [row["success_rate"].mean for row in crowd.planners]
        assert rates == [read_result(run_directory(one, tmp_path))["metrics"]["success_rate"]["mean"] for one in runs]
