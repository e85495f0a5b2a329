"""Tables of planners by scenarios, or by the values of an option."""

import re

import pytest

from crowdbench.api import run
from crowdbench.cli.app import app
from crowdbench.results.compare import compare


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for planner in ("orca", "orca_margin", "straight"):
        for scenario in ("circle_crossing_5", "square_crossing_5"):
            run(planner, scenario, cases="40", record="none", out=folder / f"{planner}-{scenario}")
    return sorted(folder.iterdir())


def table(capsys, runs, *options):
    app(["table", *map(str, runs), *options], standalone_mode=False)
    return capsys.readouterr().out


def test_planners_stand_in_rows_and_scenarios_in_columns(runs, capsys):
    text = table(capsys, runs, "--columns", "scenario")
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[0:2] == "| "]
    assert lines[0] == ["success, %", "circle_crossing_5", "square_crossing_5"]
    assert [line[0] for line in lines[2:]] == ["orca", "orca_margin", "straight"]
    assert re.fullmatch(r"\*\*\d+\.\d\*\* \(\d+\.\d to \d+\.\d\)", lines[3][1])
    assert "McNemar" in text


def test_all_that_show_the_best_value_are_bold(tmp_path, capsys):
    for planner, width in (("orca", 0.3), ("straight", 0.3)):
        overrides = {"pedestrians.number": 0, "vehicle.radius": width}
        run(planner, cases="6", overrides=overrides, record="none", out=tmp_path / planner)
    text = table(capsys, sorted(tmp_path.iterdir()), "--columns", "scenario")
    assert text.count("**100.0**") == 2
    assert "†" not in text.splitlines()[2] + text.splitlines()[3]


def test_a_mark_says_that_a_planner_cannot_be_told_from_the_best(runs, capsys):
    lines = table(capsys, runs, "--columns", "scenario").splitlines()
    cells = next(line.split("|")[2:4] for line in lines if line.startswith("| orca |"))
    by_name = {path.name: path for path in runs}
    for cell, scenario in zip(cells, ("circle_crossing_5", "square_crossing_5"), strict=True):
        found = compare(by_name[f"orca_margin-{scenario}"], by_name[f"orca-{scenario}"]).rows["success_rate"]
        # Holm's method leaves the larger of the two p-values, and straight is worse beyond doubt.
        assert ("†" in cell) == (found.p >= 0.05)


def test_a_table_floats_where_it_has_a_caption(runs, capsys):
    text = table(
        capsys,
        runs,
        "--columns",
        "scenario",
        "--metric",
        "sct",
        "--format",
        "latex",
        "--caption",
        "SCT.",
        "--label",
        "tab:a",
    )
    head = [r"\begin{table}", r"\centering", r"\caption{SCT.}", r"\label{tab:a}"]
    assert text.splitlines()[:4] == head
    assert text.splitlines()[5] == r"\begin{tabular}{lrr}"
    assert "\\textbf{0." in text
    assert "holds 0" in text
    assert "SCT" in table(capsys, runs[:1], "--metric", "sct")


def test_an_option_can_be_the_columns(tmp_path, capsys):
    for space in (0.0, 0.2):
        run("orca", cases="6", options={"safety_space": space}, out=tmp_path / str(space))
    text = table(capsys, sorted(tmp_path.iterdir()), "--columns", "safety_space")
    assert "| success, % | safety_space=0.0 | safety_space=0.2 |" in text
    assert text.count("| orca |") == 1


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--columns", "weights"], "was made without weights: name an option or a key that all runs have set"),
        (["--columns", "scenario", "--metric", "sct", "--metric", "jerk"], "shows one metric: give --metric once"),
        (["--columns", "scenario", "--metric", "joy"], "has no metric joy; it has success_rate"),
        (["--caption", "A"], "--caption and --label go with --format latex"),
    ],
)
def test_what_does_not_go_gets_one_sentence(runs, options, sentence):
    with pytest.raises(Exception, match=re.escape(sentence)):
        app(["table", *map(str, runs), *options], standalone_mode=False)


def test_two_runs_of_one_place_are_refused(runs):
    with pytest.raises(Exception, match="are both of orca and circle_crossing_5: leave one of them out"):
        app(["table", str(runs[0]), str(runs[0]), "--columns", "scenario"], standalone_mode=False)
