"""`crowdbench view`: which case it shows."""

import shutil

import numpy as np
import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli import app
from crowdbench.metrics import METRICS
from crowdbench.record import rrd, viewer
from crowdbench.record.cases import read_case, recorded_cases
from crowdbench.runs.results import EPISODES, Episodes
from crowdbench.utils.errors import InputError


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of twenty cases, of which the failures and the first ten are recorded."""
    out = tmp_path_factory.mktemp("run") / "run"
    assert CliRunner().invoke(app, ["run", "--planner", "orca", "--cases", "20", "--out", str(out)]).exit_code == 0
    return out


@pytest.fixture
def shown(monkeypatch):
    """The cases and times that the viewer is asked to show."""
    asked = []
    monkeypatch.setattr(viewer, "view", lambda path, case, screenshot, **more: asked.append((case, more)))
    return asked


@pytest.mark.parametrize(("metric", "sign"), [("jerk", 1.0), ("minimum_gap", -1.0), ("navigation_time", 1.0)])
def test_the_worst_case_is_shown(metric, sign, run, shown):
    assert CliRunner().invoke(app, ["view", str(run), "--worst", metric, "--time", "2"]).exit_code == 0
    values = sign * Episodes.read(run / EPISODES).columns[metric]
    assert shown == [(int(np.nanargmax(values)), {"seconds": 2.0, "web": False})]


def test_the_first_failure_is_shown_and_the_cases_of_each_outcome_are_listed(run, shown):
    done = CliRunner().invoke(app, ["view", str(run)])
    episodes = Episodes.read(run / EPISODES)
    failed, solved = episodes.failures["collision"], episodes.case[episodes.columns["success_rate"]]
    assert shown == [(failed[0], {"seconds": None, "web": False})]
    lines = done.stdout.splitlines()
    assert lines[0].startswith(f"{len(failed)} collisions (cases {failed[0]}, {failed[1]}")
    assert lines[1].startswith(f"{len(solved)} successes (cases {solved[0]}, {solved[1]}")
    assert lines[2] == f"case test/{failed[0]}"


def test_a_case_that_is_not_recorded_is_simulated_again(run, monkeypatch, tmp_path):
    recorded, episodes = recorded_cases(run / "run.rrd"), Episodes.read(run / EPISODES)
    (case, *_) = [case for case in range(20) if case not in recorded]
    found = []
    monkeypatch.setattr(viewer, "view", lambda paths, number, *_, **__: found.append(read_case(paths[0], number)))
    assert CliRunner().invoke(app, ["view", str(run), "--case", str(case)]).exit_code == 0
    trace = found[0].trace
    assert (trace.case[0], trace.steps[0]) == (case, episodes.steps[case])
    assert METRICS["path_length"](trace)[0] == episodes.columns["path_length"][case]
    shutil.copytree(run, tmp_path / "run")
    monkeypatch.setattr("crowdbench.cli.cases.load_scenario", lambda *_: load_scenario("square_crossing_5"))
    with pytest.raises(InputError, match=f"case {case} of .* ends in another way when it is simulated again"):
        raise CliRunner().invoke(app, ["view", str(tmp_path / "run"), "--case", str(case)]).exception


def test_a_picture_is_drawn_without_the_viewer_where_that_does_not_start(run, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise viewer.NoViewer("it needs a Vulkan driver")

    monkeypatch.setattr(viewer, "view", fail)
    out = tmp_path / "case.png"
    done = CliRunner().invoke(app, ["view", str(run), "--case", "3", "--screenshot", str(out)])
    assert "it needs a Vulkan driver. This picture is one of `crowdbench render`" in done.output
    assert f"wrote {out}" in done.output
    assert out.read_bytes()[:4] == b"\x89PNG"
    assert CliRunner().invoke(app, ["view", str(run), "--case", "3"]).exit_code


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--worst", "jerk", "--case", "3"], "--worst chooses the case"),
        (["--worst", "jerkk"], "has no metric jerkk .did you mean jerk..; it has success_rate"),
        (["--worst", "imposed_delay"], "imposed_delay is not defined in any case"),
    ],
)
def test_a_case_that_cannot_be_chosen_gets_one_sentence(arguments, sentence, run, shown):
    with pytest.raises(InputError, match=sentence):
        raise CliRunner().invoke(app, ["view", str(run), *arguments]).exception
    assert not shown


def test_a_moment_after_the_end_of_a_case_is_refused(run):
    with pytest.raises(InputError, match=r"case 3 ends after [\d.]+ s: give --time [\d.]+ or less, not 1000"):
        raise CliRunner().invoke(app, ["view", str(run), "--case", "3", "--time", "1000"]).exception


def test_the_worst_of_a_file_alone_is_not_known(run, shown):
    with pytest.raises(InputError, match=r"--worst needs the directory of a run, whose episodes.csv has the metrics"):
        raise CliRunner().invoke(app, ["view", str(run / "run.rrd"), "--worst", "jerk"]).exception


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A run of another planner on the same cases."""
    out = tmp_path_factory.mktemp("other") / "run"
    given = ["run", "--planner", "straight", "--cases", "12", "--record", "all", "--out", str(out)]
    assert CliRunner().invoke(app, given).exit_code == 0
    return out


def test_two_runs_are_shown_side_by_side_in_one_case(run, other, monkeypatch):
    found = []

    def show(path, seconds, *, web):
        (entry,) = RrdReader(path).recordings()
        paths = {chunk.entity_path for chunk in rrd.chunks_of(RrdReader(path), entry, "/**")}
        found.append((entry.recording_id, entry.application_id, paths, seconds, web))

    monkeypatch.setattr(viewer, "show", show)
    done = CliRunner().invoke(app, ["view", str(run), str(other), "--worst", "jerk", "--time", "2"])
    assert done.exit_code == 0, done.output
    ((name, title, paths, seconds, web),) = found
    assert name == f"test-{int(done.stdout.removeprefix('case test/')):04d}"
    assert (title, seconds, web) == (f"case {int(name[5:])} of 2 planners", 2.0, False)
    assert {"/0/world/agents", "/1/world/agents", "/0/plots/speed", "/1/plots/speed"} <= paths
    assert all(path.startswith(("/0/", "/1/")) for path in paths)


def test_runs_that_are_not_of_one_case_are_not_shown_side_by_side(run, other, tmp_path):
    elsewhere = tmp_path / "run"
    given = ["run", "--planner", "orca", "--scenario", "square_crossing_5", "--cases", "12", "--out", str(elsewhere)]
    assert CliRunner().invoke(app, given).exit_code == 0
    for arguments, sentence in (
        ([run / "run.rrd", other], "give --case 37"),
        ([run, elsewhere, "--case", "1"], r"case 1 starts otherwise in .* give runs of one scenario"),
        ([run, other, "--case", "300"], "case 300 is none of the cases test:0:20"),
    ):
        with pytest.raises(InputError, match=sentence):
            raise CliRunner().invoke(app, ["view", *map(str, arguments)]).exception
