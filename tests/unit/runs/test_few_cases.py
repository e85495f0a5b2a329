"""Intervals over few cases are not shown, and significant differences are marked."""

import json
import math

import numpy as np
import pytest

from crowdbench import InputError, Result, run
from crowdbench.metrics.registry import MAIN, info_of
from crowdbench.metrics.summary import LEAST_CASES, Estimate
from crowdbench.results.compare import Comparison, comparison_grid, correct
from crowdbench.results.paired import Paired, compare_metric
from crowdbench.results.table import RunTable, metric_grid
from crowdbench.utils.tables import Format, format_tables


def episodes(solved, times, block=None):
    """Episodes of which the first ones are solved, in the given times."""
    from crowdbench.results.episodes import Episodes

    case, success = np.arange(len(times)), np.arange(len(times)) < solved
    columns = {"success_rate": success, "navigation_time": np.where(success, times, np.nan)}
    return Episodes(case, case, case + 1, columns, block)


def pair(solved, cases=10, block=None):
    """Two runs with equal successes, of which the second is a second slower in each case."""
    times = 10.0 + np.arange(cases) % 3
    return Paired(episodes(solved, times, block), episodes(solved, times + 1.0 + 0.01 * (times - 10.0), block))


def comparison(*strata):
    rows = {name: compare_metric(name, strata) for name in strata[0].a.columns}
    return Comparison("corridor", ("a", "b"), 10, 3, rows, None, [], "test:0:10")


def cells(grid):
    return {row[0]: dict(zip(grid.header, row, strict=True)) for row in grid.rows}


def test_a_comparison_shows_n_and_no_interval_over_few_cases():
    few, enough = (comparison_grid([comparison(pair(solved))]) for solved in (LEAST_CASES - 1, LEAST_CASES))
    column = "difference (95 % interval)"
    assert (cells(few)["time, s"][column], cells(few)["time, s"]["n"]) == ("1.008", "5")
    assert cells(enough)["time, s"][column].startswith("1.010 (")
    assert cells(enough)["time, s"]["n"] == "6"
    assert cells(few)["success, %"]["n"] == "10"
    assert "No interval: fewer than 6 independent cases" in few.note
    assert "No interval" not in enough.note
    assert [record["n"] for record in few.records] == [10, 5]
    (_, time) = json.loads(format_tables([few], Format.JSON))
    assert (time["difference"]["low"], time["difference"]["high"], time["n"]) == (None, None, 5)
    for kind, ending in ((Format.CSV, "5,False"), (Format.LATEX, r" 5 \\"), (Format.MARKDOWN, " | 5 |")):
        assert any(line.endswith(ending) for line in format_tables([few], kind).splitlines())


def test_a_significant_difference_is_marked_and_the_note_says_so():
    grid = comparison_grid([comparison(pair(10))])
    assert cells(grid)["time, s"]["difference (95 % interval)"].endswith(") *")
    assert not cells(grid)["success, %"]["difference (95 % interval)"].endswith("*")
    assert "Marked with *: significant" in grid.note
    assert [record["significant"] for record in grid.records] == [False, True]
    assert "Marked with *" in repr(comparison(pair(10)))


def test_the_mark_of_several_comparisons_goes_by_the_corrected_p():
    times = np.full(20, 10.0)
    both = [Paired(episodes(solved, times), episodes(20, times)) for solved in (14, 13, 20)]
    alone = [compare_metric("success_rate", [each]) for each in both]
    assert [row.is_significant for row in alone] == [True, True, False]
    found = correct([comparison(each) for each in both])
    assert [each.rows["success_rate"].is_significant for each in found] == [False, True, False]
    assert alone[0].p < 0.05 < found[0].rows["success_rate"].corrected


@pytest.mark.parametrize(("blocks", "shown"), [(LEAST_CASES - 1, False), (LEAST_CASES, True)])
def test_blocks_of_recorded_time_count_as_one_case(blocks, shown):
    found = compare_metric("navigation_time", [pair(30, 30, np.arange(30) % blocks)])
    assert math.isfinite(found.difference.low) == shown == found.is_significant
    assert found.difference.n == 30


def test_each_scenario_of_a_pooled_difference_has_enough_cases():
    assert compare_metric("navigation_time", [pair(8), pair(6)]).is_significant
    found = compare_metric("navigation_time", [pair(10), pair(3)])
    assert (found.difference.n, found.is_significant) == (13, False)
    assert math.isnan(found.difference.low)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("few")
    return [run(name, cases=4, out=folder / name).directory for name in ("orca", "straight")]


def test_runs_of_two_scenarios_are_told_apart_by_their_names(folders, tmp_path):
    other = run("straight", "door_10", cases=2, out=tmp_path / "other")
    with pytest.raises(InputError, match="runs of different scenarios, circle_crossing_5 and door_10: run both"):
        Result.read(folders[0]).compare(other)


def test_tables_of_runs_show_no_interval_over_few_cases(folders):
    for grid in (RunTable.read(folders).grid(MAIN), RunTable.read(folders).all_metrics()):
        assert not any("(" in cell for row in grid.rows for cell in row)
        assert "fewer than 6 independent cases" in grid.note
    grid = RunTable.read(folders).cross("navigation_time_or_limit")
    assert [row[1].count("†") for row in grid.rows] in ([0, 1], [1, 0])
    assert "or these are fewer than 6" in grid.note
    shown = metric_grid("", {"jerk": Estimate(1.0, 0.5, 1.5, 5, 2.0)}, [])
    assert (shown.rows[0][3], bool(shown.note)) == ("", True)
    shown = metric_grid("", {"jerk": Estimate(1.0, 0.5, 1.5, 50, 2.0)}, [], blocks=5)
    assert (shown.rows[0][3], bool(shown.note)) == ("", True)
    shown = metric_grid("", {"jerk": Estimate(1.0, 0.5, 1.5, 6, 2.0)}, [])
    assert (shown.rows[0][3], bool(shown.note)) == ("0.500 to 1.500", False)
    assert info_of("jerk").estimate(Estimate(1.0, 0.5, 1.5, 5, 2.0)) == "1.000"
