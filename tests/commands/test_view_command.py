"""`crowdbench view`: which case it shows."""

import numpy as np
import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from crowdbench.cli import app
from crowdbench.record import rrd, viewer
from crowdbench.record.cases import recorded_cases
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
def test_the_worst_recorded_case_is_shown(metric, sign, run, shown):
    assert CliRunner().invoke(app, ["view", str(run), "--worst", metric, "--time", "2"]).exit_code == 0
    recorded = recorded_cases(run / "run.rrd")
    assert 10 <= len(recorded) < 20
    values = sign * Episodes.read(run / EPISODES).columns[metric][recorded]
    assert shown == [(recorded[int(np.nanargmax(values))], {"seconds": 2.0, "web": False})]


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
        (["--worst", "imposed_delay"], "imposed_delay is not defined in any recorded case"),
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
    assert name == f"test-{int(done.stdout.removeprefix('case ')):04d}"
    assert (title, seconds, web) == (f"case {int(name[5:])} of 2 planners", 2.0, False)
    assert {"/0/world/agents", "/1/world/agents", "/0/plots/speed", "/1/plots/speed"} <= paths
    assert all(path.startswith(("/0/", "/1/")) for path in paths)


def test_runs_that_are_not_of_one_case_are_not_shown_side_by_side(run, other, tmp_path):
    elsewhere = tmp_path / "run"
    given = ["run", "--planner", "orca", "--scenario", "square_crossing_5", "--cases", "12", "--out", str(elsewhere)]
    assert CliRunner().invoke(app, given).exit_code == 0
    for arguments, sentence in (
        ([run, other], "give --case 37 or --worst METRIC"),
        ([run, elsewhere, "--case", "1"], r"case 1 starts otherwise in .* give runs of one scenario"),
        ([run, other, "--case", "300"], "case test/300 is not recorded"),
    ):
        with pytest.raises(InputError, match=sentence):
            raise CliRunner().invoke(app, ["view", *map(str, arguments)]).exception
