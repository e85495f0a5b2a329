"""Tables of runs on disk: the same scenario and cases, the intervals of results, the tests of `compare`."""

import itertools

import pytest

from crowdbench.api import run
from crowdbench.metrics.registry import info_of
from crowdbench.metrics.summary import Estimate
from crowdbench.results.compare import compare, comparison_grid
from crowdbench.results.episodes import read_estimate
from crowdbench.results.table import RunTable, estimate_grid, estimates
from crowdbench.utils.errors import InputError
from studies.side_by_side import comparisons, verdict_grid

METRICS = ["success_rate", "navigation_time", "discomfort", "jerk", "minimum_gap"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    made = {}
    for planner, scenario in itertools.product(("orca", "orca_margin"), ("circle_crossing_5", "square_crossing_5")):
        made[planner, scenario] = folder / f"{planner}-{scenario}"
        run(planner, scenario, cases="40", record="none", out=made[planner, scenario])
    return made


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """Runs that do not go with `runs`: of fewer cases, of other cases, of another radius."""
    folder = tmp_path_factory.mktemp("others")
    run("straight", cases="30", record="none", out=folder / "few")
    run("straight", cases="val:40", record="none", out=folder / "val")
    run("straight", cases="40", overrides={"vehicle.radius": 0.2}, record="none", out=folder / "small")
    return folder


def test_intervals_are_those_of_the_results(runs):
    table = RunTable.read(list(runs.values()))
    assert list(table.columns) == ["circle_crossing_5", "square_crossing_5"]
    grid = table.grid(METRICS)
    assert list(grid.header) == ["scenario", "planner", *(info_of(name).heading for name in METRICS)]
    for record, row in zip(grid.records, grid.rows, strict=True):
        result = table.columns[record["scenario"]][record["planner"]].result["metrics"]
        for name, cell in zip(METRICS, row[2:], strict=True):
            assert record[name] == read_estimate(result[name])
            fewer = "" if record[name].n == 40 else f" [{record[name].n}]"
            assert cell == info_of(name).estimate(record[name]) + fewer
    assert grid.note == "Cases test:0:40, n = 40. [n]: a mean over n cases only, those in which it is defined."


def test_means_may_be_over_the_cases_that_a_planner_solves(runs):
    (one,) = RunTable.read([runs["orca", "circle_crossing_5"]]).runs
    infos = {name: info_of(name) for name in METRICS}
    solved, every = estimates(one, infos, solved=True), estimates(one, infos)
    assert solved["success_rate"] == every["success_rate"]
    assert solved["navigation_time"] == every["navigation_time"]
    succeeds = one.episodes.columns["success_rate"]
    assert solved["jerk"].n == succeeds.sum() < every["jerk"].n
    assert solved["jerk"].mean == pytest.approx(one.episodes.columns["jerk"][succeeds].mean())


def test_pairs_are_tested_as_compare_does(runs):
    column = RunTable.read([runs[planner, "circle_crossing_5"] for planner in ("orca", "orca_margin")])
    found = comparisons({name: [run] for name, run in column.columns["circle_crossing_5"].items()})
    expected = compare(*(run.directory for run in column.runs))
    (pair,) = found
    assert pair.rows == {name: expected.rows[name] for name in METRICS}
    (verdicts,) = verdict_grid(found).rows
    better = [
        name for name in METRICS if (d := pair.rows[name]).is_significant and info_of(name).sign * d.difference.mean > 0
    ]
    assert "success_rate" in better
    assert verdicts[0] == "orca_margin"
    assert verdicts[1].startswith(f"better: {', '.join(info_of(name).title for name in better)}")
    grid = comparison_grid(found, ["jerk"])
    assert list(grid.header) == ["metric", "orca", "orca_margin", "difference (95 % interval)", "p", "n"]
    difference = expected.rows["jerk"].difference
    assert grid.rows[0][3] == info_of("jerk").estimate(difference) + " *" * expected.rows["jerk"].is_significant
    assert grid.rows[0][5] == str(difference.n)


def test_a_table_shows_the_metrics_that_are_asked_for_and_a_dash_where_there_is_none():
    success, time = Estimate(0.5, 0.4, 0.6, 40, 1.0), Estimate(9.0, 8.0, 10.0, 20, 11.0)
    records = [{"scenario": "a", "success_rate": success, "sct": time, "navigation_time": time}, {"scenario": "b"}]
    infos = {name: info_of(name) for name in ("success_rate", "navigation_time")}
    grid = estimate_grid("", records, infos, brief=["navigation_time"])
    assert list(grid.header) == ["scenario", "success, %", "time, s"]
    assert grid.rows == [["a", "50.0 (40.0 to 60.0)", "9.000"], ["b", "-", "-"]]


@pytest.mark.parametrize(("other", "cases"), [("few", "test:0:30"), ("val", "val:0:40")])
def test_runs_of_different_cases_are_refused_also_in_other_scenarios(runs, others, other, cases):
    sentence = f"has the cases test:0:40 and .*{other} has {cases}: make all runs with the same cases"
    with pytest.raises(InputError, match=sentence) as error:
        RunTable.read([runs["orca", "square_crossing_5"], others / other])
    assert "\n" not in str(error.value)


def test_runs_of_changed_scenarios_stand_apart(runs, others):
    table = RunTable.read([runs["orca", "circle_crossing_5"], others / "small"])
    assert list(table.columns) == ["circle_crossing_5", "circle_crossing_5, vehicle.radius=0.2"]


def test_a_run_stands_in_a_table_once(runs):
    with pytest.raises(InputError, match="are both of orca and circle_crossing_5: leave one of them out"):
        RunTable.read([runs["orca", "circle_crossing_5"]] * 2)
