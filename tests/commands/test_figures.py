"""`crowdbench table`, `compare` and `plot`: tables and figures of runs and trainings."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.cli.app import app
from crowdbench.figures import plots
from crowdbench.metrics.registry import METRICS, info_of
from crowdbench.results.compare import compare
from crowdbench.results.episodes import Episodes
from crowdbench.results.paired import Paired, compare_metric, holm
from crowdbench.utils.errors import InputError


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs of two planners among three and among five pedestrians."""
    folder = tmp_path_factory.mktemp("runs")
    for planner in ("orca", "straight"):
        for number in (3, 5):
            out = folder / f"{planner}-{number}"
            given = ["--planner", planner, "--set", f"pedestrians.number={number}", "--cases", "30", "--out", str(out)]
            assert CliRunner().invoke(app, ["run", *given, "--record", "none"]).exit_code == 0
    return folder


def words(figure):
    """The texts of an SVG."""
    return re.findall(r"<text[^>]*>([^<]+)</text>", figure.read_text())


def test_success_over_time_ends_at_the_success_rate(made, tmp_path):
    plots.success_over_time([made / "orca-5", made / "straight-5"], tmp_path / "a.svg")
    said = set(words(tmp_path / "a.svg"))
    assert {"orca", "straight", "time, s", "cases solved, %", "cases test:0:30, n = 30"} <= said


def test_success_over_time_ends_with_the_longest_episode_where_each_case_has_a_limit(made, tmp_path):
    for planner in ("orca", "straight"):
        given = ["--planner", planner, "--set", "time_limit_factor=2.0", "--set", "time_limit=200.0", "--cases", "6"]
        CliRunner().invoke(app, ["run", *given, "--record", "none", "--out", str(tmp_path / planner)])
    plots.success_over_time([tmp_path / "orca", tmp_path / "straight"], tmp_path / "a.svg")
    seconds = [int(word) for word in words(tmp_path / "a.svg") if word.isdigit() and int(word) % 20]
    assert 5 <= max(seconds) <= 16  # of the axis of time, twice 7.75 s at most


def test_a_metric_has_its_unit_and_a_row_for_each_run(made, tmp_path):
    plots.distribution([made / "orca-5", made / "straight-5"], "jerk", tmp_path / "a.svg")
    assert {"orca", "straight", "jerk, m/s³"} <= set(words(tmp_path / "a.svg"))


def test_learning_curves_are_joined_over_seeds(tmp_path):
    for seed, success in ((0, 0.5), (1, 0.7)):
        folder = tmp_path / f"s{seed}"
        folder.mkdir()
        (folder / "curve.csv").write_text(f"steps,seconds,mean_reward,success\n0,0,-1,0\n1000,9,2,{success}\n")
        (folder / "weights.json").write_text('{"network": "ppo", "training": {"scenario": {"name": "five"}}}')
    plots.learning_curves([tmp_path / "s0", tmp_path / "s1"], tmp_path / "a.svg")
    assert {"ppo, five, 2 seeds", "success on validation cases, %"} <= set(words(tmp_path / "a.svg"))
    plots.learning_curves([tmp_path / "s0", tmp_path / "s1"], tmp_path / "a.svg", "mean_reward")
    assert "mean reward" in words(tmp_path / "a.svg")
    with pytest.raises(InputError, match="s0 has no reward; it has steps, seconds, mean_reward, success"):
        plots.learning_curves([tmp_path / "s0"], tmp_path / "b.svg", "reward")


@pytest.mark.parametrize("suffix", [pytest.param("pdf", marks=pytest.mark.slow), "png", "svg"])
def test_the_same_figure_has_the_same_bytes(suffix, made, tmp_path):
    one, two = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    for out in (one, two):
        plots.success_over_time([made / "orca-5"], out)
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["success", "orca-5", "--out", "a.gif"], "with the ending .pdf, .png or .svg, not a.gif"),
        (["success", "nothing"], "nothing"),
        (["metric", "orca-5"], "needs --metric NAME"),
        (["training", "orca-5"], "orca-5 is no directory of a training: it has no curve.csv"),
        (
            ["success", *[f"orca-{n}" for n in (3, 5)] * 5],
            "are both of orca and circle_crossing_5, pedestrians.number=3",
        ),
    ],
)
def test_what_cannot_be_drawn_gets_one_sentence_and_leaves_no_file(arguments, sentence, made, monkeypatch):
    monkeypatch.chdir(made)
    before = sorted(made.iterdir())
    with pytest.raises(InputError, match=sentence):
        raise CliRunner().invoke(app, ["plot", *arguments]).exception
    assert sorted(made.iterdir()) == before


def printed(*arguments):
    done = CliRunner().invoke(app, ["table", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    return done.stdout


def test_a_table_has_a_row_for_each_run(made):
    head, _, *rows, _, note = printed(
        made / "orca-5", made / "straight-5", "--metric", "success_rate", "--metric", "jerk"
    ).splitlines()
    assert note == "Cases test:0:30, n = 30."
    assert head == "| planner | success, % | jerk, m/s^3 |"
    found = {cells[0]: cells[1:] for cells in ([cell.strip() for cell in row.strip("|").split("|")] for row in rows)}
    result = json.loads((made / "orca-5" / "result.json").read_text())["metrics"]["success_rate"]
    mean, low, high = (f"{100 * result[key]:.1f}" for key in ("mean", "low", "high"))
    assert found["orca"][0] == f"{mean} ({low} to {high})"
    assert found.keys() == {"orca", "straight"}


def test_a_table_in_latex_is_escaped_and_has_rules(made):
    text = printed(made / "orca-5", made / "straight-5", "--format", "latex")
    lines = text.splitlines()
    heads = [("success", "\\%"), ("collisions", "\\%"), ("time", "s"), ("jerk", "m/s$^3$")]
    stacks = [rf"\shortstack{{{title}\\{unit}}}" for title, unit in heads]
    assert lines[1:4] == [r"\begin{tabular}{lrrrr}", r"\toprule", " & ".join(["planner", *stacks]) + r" \\"]
    assert sum(line.endswith(r"\\") for line in lines) == 3
    assert re.fullmatch(r"orca & [\d.]+\$_{[\d.]+}\^{[\d.]+}\$ & .*", lines[5])
    assert not re.search(r"(?<!\\)%", text)


def test_csv_and_json_have_the_same_numbers(made):
    head, row = csv.reader(printed(made / "orca-5", "--metric", "jerk", "--format", "csv").splitlines())
    (found,) = json.loads(printed(made / "orca-5", "--metric", "jerk", "--format", "json"))
    assert found["planner"] == row[0] == "orca"
    assert head == ["planner", *(f"jerk.{name}" for name in found["jerk"]), "cases"]
    assert [float(value) for value in row[1:-1]] == list(found["jerk"].values())
    assert found["cases"] == row[-1] == "test:0:30"


@pytest.mark.slow
def test_runs_are_compared_with_one_and_corrected_for_their_number(made, tmp_path):
    runs = [made / "orca-5", made / "straight-5", tmp_path / "force"]
    given = ["--planner", "social_force", "--cases", "30", "--record", "none", "--out", str(runs[2])]
    assert CliRunner().invoke(app, ["run", *given]).exit_code == 0
    alone = {other.name: compare(runs[0], other).rows["success_rate"].p for other in runs[1:]}
    assert len(set(alone.values())) == 2
    done = CliRunner().invoke(app, ["compare", *map(str, runs), "--metric", "success_rate", "--format", "json"])
    found = json.loads(done.stdout)
    assert [row["p"] for row in found] == list(alone.values())
    np.testing.assert_allclose([row["corrected"] for row in found], holm(np.array(list(alone.values()))))
    shown = CliRunner().invoke(app, ["compare", *map(str, runs)]).stdout
    assert "p corrected: for the number of tests of a metric (Holm 1979)" in shown
    assert re.search(r"jerk, m/s\^3 +social_force +[\d.]+ +[\d.]+ +-?[\d.]+ \(", shown)


@pytest.fixture(scope="module")
def in_two_scenarios(tmp_path_factory):
    """Runs of ORCA, the straight line and the social force in two scenarios, by planner and scenario."""
    folder, runs = tmp_path_factory.mktemp("two"), {}
    for planner in ("orca", "straight", "social_force"):
        for scenario in ("circle_crossing_5", "square_crossing_5"):
            out = runs[planner, scenario] = str(folder / f"{planner}-{scenario}")
            given = ["--scenario", scenario, "--cases", "25", "--record", "none", "--out", out]
            assert CliRunner().invoke(app, ["run", "--planner", planner, *given]).exit_code == 0
    return runs


@pytest.mark.slow
def test_runs_of_several_scenarios_are_compared_in_each_and_in_all(in_two_scenarios):
    given = ["compare", *in_two_scenarios.values(), "--metric", "success_rate", "--format", "json"]
    found = {(row["scenario"], row["run"]): row for row in json.loads(CliRunner().invoke(app, given).stdout)}
    names = ["circle_crossing_5", "square_crossing_5"]
    assert list(found) == [(name, run) for name in [*names, "all 2 scenarios"] for run in ("straight", "social_force")]
    for run in ("straight", "social_force"):
        single = [
            compare(Path(in_two_scenarios["orca", name]), Path(in_two_scenarios[run, name])).rows["success_rate"]
            for name in names
        ]
        for name, alone in zip(names, single, strict=True):
            assert found[name, run]["difference"] == pytest.approx(vars(alone.difference))
        pooled = found["all 2 scenarios", run]
        assert pooled["cases"] == 50
        assert pooled["difference"]["mean"] == pytest.approx(np.mean([each.difference.mean for each in single]))
        width = [each["high"] - each["low"] for each in (pooled["difference"], vars(single[0].difference))]
        assert 0.4 < width[0] / width[1] < 1.0
        assert pooled["p"] < min(each.p for each in single)
    for rows in (list(found.values())[:4], list(found.values())[4:]):
        np.testing.assert_allclose([row["corrected"] for row in rows], holm(np.array([row["p"] for row in rows])))


@pytest.mark.slow
def test_each_planner_must_have_a_run_in_each_scenario(in_two_scenarios):
    *runs, last = in_two_scenarios.values()
    lacking = CliRunner().invoke(app, ["compare", *runs])
    assert "there is no run of social_force in square_crossing_5" in str(lacking.exception)
    twice = CliRunner().invoke(app, ["compare", *runs, last, last])
    assert "are both of social_force in square_crossing_5: give one of them" in str(twice.exception)


def test_an_interval_holds_0_where_the_test_finds_no_difference():
    for only_a in range(11):
        for only_b in range(only_a):
            case = np.arange(40)
            one, two = (case < only_a) | (case >= 25), ((case >= 12) & (case < 12 + only_b)) | (case >= 25)
            columns = {"success_rate": one}, {"success_rate": two}
            paired = Paired(*(Episodes(case, case, case, each) for each in columns))
            row = compare_metric("success_rate", [paired])
            assert (row.p < 0.05) == (row.difference.high < 0.0)


def test_a_comparison_refuses_a_metric_that_there_is_not(made):
    given = ["compare", str(made / "orca-5"), str(made / "straight-5"), "--metric", "jerkk"]
    with pytest.raises(InputError, match="not all runs have a metric jerkk; they have success_rate"):
        raise CliRunner().invoke(app, given).exception


def test_a_metric_may_be_meant_by_a_word_of_its_name(made):
    with pytest.raises(InputError, match=r"has no metric gap \(did you mean minimum_gap\?\); it has"):
        raise CliRunner().invoke(app, ["table", str(made / "orca-5"), "--metric", "gap"]).exception


def test_all_metrics_have_a_row_each(made):
    head, _, *rows, _, note = printed(made / "orca-5", made / "straight-5", "--all-metrics").splitlines()
    assert head == "| metric | orca | straight |"
    assert len(rows) == len(METRICS)
    stored = json.loads((made / "straight-5" / "result.json").read_text())["metrics"]
    fewer = {name: found for name, found in stored.items() if 0 < found["n"] < 30}
    assert fewer
    for row, (name, found) in zip(rows, stored.items(), strict=True):
        title, _, cell = row.strip("| ").split(" | ")
        assert title == info_of(name, name in ("success_rate", "collision_rate")).heading or name.endswith("_rate")
        assert cell.endswith(f" [{found['n']}]") == (name in fewer)
    assert note.endswith("[n]: a mean over n cases only, those in which it is defined.")
    for more in (["--metric", "jerk"], ["--columns", "scenario"]):
        refused = CliRunner().invoke(app, ["table", str(made / "orca-5"), "--all-metrics", *more])
        assert "--all-metrics shows all metrics in rows" in str(refused.exception)


def test_names_are_those_of_the_runs_in_their_order(made):
    runs = made / "orca-5", made / "straight-5"
    rows = printed(*runs, "--names", "a,b", "--metric", "jerk").splitlines()[2:4]
    assert [row.split(" | ")[0] for row in rows] == ["| a", "| b"]
    with pytest.raises(InputError, match="there are 1 names of 2 runs: give one for each"):
        raise CliRunner().invoke(app, ["table", *map(str, runs), "--names", "a"]).exception


def test_zero_has_no_sign():
    assert info_of("minimum_gap").number(-0.0001) == "0.000"
    assert info_of("success_rate", is_rate=True).number(-1e-9) == "0.0"


def test_a_table_refuses_a_metric_that_there_is_not(made):
    with pytest.raises(InputError, match=r"the run of orca has no metric jerkk \(did you mean jerk\?\); it has"):
        raise CliRunner().invoke(app, ["table", str(made / "orca-5"), "--metric", "jerkk"]).exception
