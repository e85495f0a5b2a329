"""`crowdbench table`, `plot` and `render`: tables and figures of runs, trainings and cases."""

import csv
import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli import app
from crowdbench.core.types import Outcome
from crowdbench.drawing import DASHES, LIGHT, Disc, Line, Moment, Polygon, Text, burst, draw_moment
from crowdbench.figures import plots
from crowdbench.figures.episode import Episode
from crowdbench.figures.time_marks import mark_times
from crowdbench.metrics import METRICS, info_of
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.record.contents import read
from crowdbench.runs.compare import compare
from crowdbench.runs.paired import Paired, compare_metric, holm
from crowdbench.runs.results import Episodes
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
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


class Sideways(Planner):
    """Drives into the wall beside it."""

    def plan(self, obs):
        return np.tile([1.0, 0.0], (len(obs), 1))


def words(figure):
    """The texts of an SVG."""
    return re.findall(r"<text[^>]*>([^<]+)</text>", figure.read_text())


def test_success_over_time_ends_at_the_success_rate(made, tmp_path):
    plots.success_over_time([made / "orca-5", made / "straight-5"], tmp_path / "a.svg")
    said = set(words(tmp_path / "a.svg"))
    assert {"orca", "straight", "time, s", "cases solved, %", "cases test:0:30, n = 30"} <= said


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


@pytest.mark.parametrize("suffix", ["pdf", "png", "svg"])
def test_the_same_figure_has_the_same_bytes(suffix, made, tmp_path):
    one, two = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    for out in (one, two):
        plots.success_over_time([made / "orca-5"], out)
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["success", "orca-5", "--out", "a.gif"], "with the ending .pdf, .png or .svg, not a.gif"),
        (["success", "orca-5", "--out", "nowhere/a.pdf"], "in a folder that exists"),
        (["success", "nothing"], "nothing"),
        (["metric", "orca-5"], "needs --metric NAME"),
        (["success", "orca-5", "--metric", "jerk"], "success takes no --metric: only metric and training do"),
        (["metric", "orca-5", "--metric", "jerkk"], "has no metric jerkk .did you mean jerk..; it has success_rate"),
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


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A run with two recorded cases, in which the vehicle hits somebody."""
    out = tmp_path_factory.mktemp("driven") / "run"
    given = ["--planner", "straight", "--cases", "2", "--record", "all", "--out", str(out)]
    assert CliRunner().invoke(app, ["run", *given]).exit_code == 0
    return out


def test_a_case_is_drawn_with_the_times_along_its_way(driven, tmp_path):
    assert (
        CliRunner().invoke(app, ["render", str(driven), "--case", "1", "--out", str(tmp_path / "a.svg")]).exit_code == 0
    )
    assert {"0 s", "2 s", "1 m"} <= set(words(tmp_path / "a.svg"))


def test_a_vehicle_that_waits_is_marked_once(driven):
    trace = read(driven / "run.rrd").trace
    bounds = np.array([[-6.0, -6.0], [6.0, 6.0]])

    def texts(position):
        shapes = mark_times(dataclasses.replace(trace, position=position), 1, bounds, 3.0)
        return [shape for shape in shapes if isinstance(shape, Text)]

    assert [shape.text for shape in texts(trace.position)][:2] == ["0 s", "2 s"]
    waits = trace.position.copy()
    waits[1, :, 0] = waits[1, 0, 0]
    (once,) = texts(waits)
    last = (int(trace.steps[1]) - 1) // 8 * 2
    assert once.text == f"0 to {last} s"
    assert np.linalg.norm(once.at - waits[1, 0, 0]) > trace.radius[1, 0, 0]
    beside = waits.copy()
    beside[1, int(trace.steps[1]), 1] = once.at  # a pedestrian ends where the time was
    (moved,) = texts(beside)
    assert np.linalg.norm(moved.at - once.at) > trace.radius[1, 1, 0]


def test_a_vehicle_that_has_hit_an_obstacle_has_the_mark_of_a_contact():
    scenario = load_scenario("corridor_8", {"pedestrians.number": 1})
    trace = rollout(Driver(Sideways(), "sideways"), scenario, Cases("test", 0, 1))
    assert trace.outcome[0] == Outcome.WALL_COLLISION
    end = int(trace.steps[0])

    def colors(state):
        shapes = draw_moment(Moment.of_trace(trace, 0, state))
        return [shape.edge for shape in shapes if isinstance(shape, Disc | Polygon)]

    assert LIGHT.contact in colors(end)
    assert LIGHT.contact not in colors(end - 1)


def test_a_pedestrian_has_no_contact_that_takes_the_place_of_somebody_across_the_vehicle():
    scenario = load_scenario("circle_crossing_5", {"pedestrians.number": 1})
    trace = rollout(Driver(Sideways(), "sideways"), scenario, Cases("test", 0, 1))
    vehicle = trace.position[0, 3, 0]
    position, person = trace.position.copy(), trace.person.copy()
    position[0, 2:4, 1] = vehicle + np.array([[-5.0, 0.0], [5.0, 0.0]])
    moment = Moment.of_trace(dataclasses.replace(trace, position=position), 0, 3)
    assert moment.hit == [1]
    person[0, 3] += 1
    assert Moment.of_trace(dataclasses.replace(trace, position=position, person=person), 0, 3).hit == []


def test_a_picture_shows_what_is_around_the_vehicle(driven, tmp_path):
    episode = Episode(read(driven / "run.rrd").trace, 1, zoom=4.0)
    way = episode.trace.position[1, : episode.end + 1, 0]
    np.testing.assert_allclose(episode.bounds(way[3]), [way[3] - 2.0, way[3] + 2.0])
    np.testing.assert_allclose(episode.bounds(), [way.min(axis=0) - 2.0, way.max(axis=0) + 2.0])
    given = ["render", str(driven), "--case", "1", "--zoom", "4", "--strip", "2", "--out", str(tmp_path / "a.svg")]
    assert CliRunner().invoke(app, given).exit_code == 0
    refused = CliRunner().invoke(app, ["render", "blind_corner_5", "--case", "3", "--zoom", "4"])
    assert "--zoom is for a case of a run" in str(refused.exception)


def test_a_scenario_is_drawn_before_anything_is_run(tmp_path):
    out = tmp_path / "a.svg"
    assert CliRunner().invoke(app, ["render", "blind_corner_5", "--case", "3", "--out", str(out)]).exit_code == 0
    assert words(out) == ["1 m"]
    first = out.read_bytes()
    CliRunner().invoke(app, ["render", "blind_corner_5", "--case", "4", "--out", str(out)])
    assert out.read_bytes() != first


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["blind_corner_5", "--strip", "3"], "a scenario has its start alone"),
        (["eth_recorded"], "give the folder that holds them"),
        (["blind_corner_5", "--data", "."], "which has no table"),
        (["nowhere"], "no scenario is called 'nowhere'"),
    ],
)
def test_a_start_that_cannot_be_drawn_gets_one_sentence(arguments, sentence, tmp_path):
    given = ["render", *arguments, "--case", "1", "--out", str(tmp_path / "a.svg")]
    with pytest.raises(InputError, match=sentence):
        raise CliRunner().invoke(app, given).exception


def test_a_strip_shows_moments_up_to_the_end(driven, tmp_path):
    given = ["render", str(driven), "--case", "1", "--strip", "3", "--out", str(tmp_path / "a.svg")]
    assert CliRunner().invoke(app, given).exit_code == 0
    times = [float(found[1]) for word in words(tmp_path / "a.svg") if (found := re.search(r"([\d.]+) s$", word))]
    assert len(times) == 3
    assert times[0] < times[1] < times[2]


@pytest.mark.parametrize("suffix", ["gif", "webp"])
def test_a_film_has_20_pictures_a_second_and_ends_with_the_contact(suffix, driven, tmp_path):
    film = tmp_path / f"a.{suffix}"
    assert CliRunner().invoke(app, ["render", str(driven), "--case", "1", "--out", str(film)]).exit_code == 0
    trace = read(driven / "run.rrd").trace
    with Image.open(film) as shown:
        shown.seek(shown.n_frames - 1)
        shown.load()
        duration = shown.info["duration"]
        last = np.asarray(shown.convert("RGB"), int)
        # Pictures that are equal, at the end, may be one that is shown for longer.
        assert shown.n_frames >= 20 * trace.rules.dt * int(trace.steps[1])
    assert duration >= 50
    assert (np.abs(last - LIGHT.contact).sum(axis=2) < 60).any()


def test_between_two_states_agents_are_between_and_newcomers_are_where_they_come(driven):
    trace = read(driven / "run.rrd").trace
    before, between, after = (Moment.of_trace(trace, 1, *at) for at in ((3,), (3, 0.25), (4,)))
    expected = 0.75 * before.position[-1] + 0.25 * after.position[-1]
    np.testing.assert_allclose(between.position[-1], expected)
    assert between.step.tolist() == [0, 1, 2, 3, 3.25]
    assert between.hit == []
    person = trace.person.copy()
    person[1, 4:, 0] += 1
    other = Moment.of_trace(dataclasses.replace(trace, person=person), 1, 3, 0.25)
    np.testing.assert_array_equal(other.position[-1, 1], before.position[-1, 1])


def test_a_pedestrian_that_is_not_seen_has_a_dashed_outline_and_a_contact_a_star(driven):
    trace = read(driven / "run.rrd").trace
    moment = Moment.of_trace(trace, 1, int(trace.steps[1]))
    unseen = dataclasses.replace(moment, seen=np.arange(5) != 2)
    for each, dashes in ((moment, 0), (unseen, len(DASHES))):
        shapes = list(draw_moment(each))
        assert sum(isinstance(shape, Line) and shape.color == LIGHT.pedestrian for shape in shapes) == dashes
    contact = [0, *moment.hit]
    corners = burst(moment.position[-1, contact], moment.radius[contact])
    (found,) = [shape.corners for shape in draw_moment(moment) if isinstance(shape, Polygon) and shape.face is None]
    np.testing.assert_array_equal(found, corners)


def test_several_runs_are_drawn_side_by_side(driven, tmp_path):
    other = tmp_path / "orca"
    given = ["--planner", "orca", "--cases", "2", "--record", "all", "--out", str(other)]
    assert CliRunner().invoke(app, ["run", *given]).exit_code == 0
    runs, figure, film = [str(driven), str(other)], tmp_path / "a.svg", tmp_path / "a.gif"
    for out in (figure, film):
        assert CliRunner().invoke(app, ["render", *runs, "--case", "1", "--out", str(out)]).exit_code == 0
    said = words(figure)
    assert [word for word in said if word in ("orca", "straight")] == ["straight", "orca"]
    for run in (driven, other):
        trace = read(run / "run.rrd").trace
        mark = "\N{CHECK MARK}" if trace.outcome[1] == Outcome.SUCCESS else "\N{BALLOT X}"
        assert [word for word in said if word[0] == mark and word.endswith(f" {trace.steps[1] * trace.rules.dt:g} s")]
    assert said.count("1 m") == 2
    with Image.open(film) as shown:
        assert shown.width > shown.height
    elsewhere = ["--planner", "orca", "--cases", "2", "--set", "pedestrians.number=3", "--record", "all"]
    assert CliRunner().invoke(app, ["run", *elsewhere, "--out", str(tmp_path / "three")]).exit_code == 0
    for more, sentence in (
        ([str(tmp_path / "three")], "case 1 starts otherwise in"),
        (["corridor_8"], "are not all runs"),
        ([str(other), "--strip", "3"], "--strip draws a figure of one run"),
    ):
        with pytest.raises(InputError, match=sentence):
            raise CliRunner().invoke(app, ["render", str(driven), *more, "--case", "1"]).exception


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--case", "7"], "case 7 is none of the cases test:0:2 of"),
        (["--case", "1", "--strip", "3", "--out", "a.gif"], "--strip draws a figure"),
        (["--case", "1", "--out", "a.avi"], "with the ending .pdf, .png or .svg, not a.avi"),
        (
            ["--case", "1", "--out", "nowhere/a.gif"],
            "in a folder that exists, with the ending .gif, .webp or .mp4, not nowhere",
        ),
        (["--case", "1", "--out", "a.mp4"], "needs the program ffmpeg"),
    ],
)
def test_a_case_that_cannot_be_drawn_gets_one_sentence(arguments, sentence, driven, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(InputError, match=sentence):
        raise CliRunner().invoke(app, ["render", str(driven), *arguments]).exception
    assert not list(tmp_path.iterdir())
