"""Files that are edited at random, given to every command that reads them: one sentence, no traceback, no long wait.

See `fuzzing` for more examples.
"""

import contextlib
import json
import shutil

import pytest
import recordings
from fuzzing import BYTES, EDITS, FIELDS, answer, edit_bytes, edit_json, edit_text, fuzz
from helpers import make, reseal
from hypothesis import given
from hypothesis import strategies as st

from crowdbench.catalog import load_planner, load_scenario, scenario_path
from crowdbench.metrics.registry import METRICS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def runs(folder):
    """Two runs that follow each other."""
    some = {name: METRICS[name] for name in ("success_rate", "timeout_rate", "navigation_time", "jerk")}
    for name, cases in (("a", "2"), ("b", "2:4")):
        scenario = load_scenario("circle_crossing_5", {"vehicle.visible": True})
        asked = {"metrics": some, "record": "all", "overrides": {"vehicle.visible": True}}
        make(folder / name, load_planner("orca"), scenario, cases, **asked)
    return folder


def ask_about_runs(folder):
    run, other = folder / "edited", folder / "b"
    answer("table", run, "--all-metrics")
    answer("compare", run, run)
    answer("score", run)
    answer("merge", run, other, "--out", folder / "out", "--overwrite")
    answer("export", run, "--out", folder / "tracks", "--overwrite")
    answer("plot", "success", run, "--out", folder / "x.svg")


@pytest.fixture
def edited(runs):
    """Makes a copy of a run with other contents of some of its files."""

    def edit(name, change):
        shutil.rmtree(runs / "edited", ignore_errors=True)
        shutil.copytree(runs / "a", runs / "edited")
        path = runs / "edited" / name
        path.write_bytes(change(path.read_bytes()))
        return runs / "edited"

    return edit


@pytest.mark.slow
@fuzz
@given(FIELDS)
def test_results(runs, edited, edits):
    def change(content):
        return json.dumps(edit_json(json.loads(content), edits)).encode()

    directory = edited("result.json", change)
    with contextlib.suppress(KeyError, TypeError, AttributeError):  # what cannot be resealed
        reseal(directory)
    ask_about_runs(runs)


@fuzz
@given(EDITS)
def test_results_that_are_texts(runs, edited, edits):
    edited("result.json", lambda content: edit_text(content.decode(), edits).encode("utf-8", "replace"))
    ask_about_runs(runs)


@fuzz
@given(EDITS)
def test_episodes(runs, edited, edits):
    reseal(edited("episodes.csv", lambda content: edit_text(content.decode(), edits).encode("utf-8", "replace")))
    ask_about_runs(runs)


@pytest.mark.slow
@fuzz
@given(st.sampled_from(["run.rrd", "commands.parquet"]), BYTES)
def test_recordings_and_commands(runs, edited, name, edits):
    reseal(edited(name, lambda content: edit_bytes(content, edits)))
    ask_about_runs(runs)
    answer("render", runs / "edited", "--case", "1", "--out", runs / "x.svg")


SCENARIOS = ("circle_crossing_5", "groups_12", "office_8", "car_28", "crowdnav_plus_20", "mixed_20")


@fuzz
@given(st.sampled_from(SCENARIOS), EDITS)
def test_scenarios(folder, name, edits):
    source = scenario_path(name)
    for path in source.parent.glob("office.*"):
        shutil.copy(path, folder)
    (folder / "mine.toml").write_text(edit_text(source.read_text(), edits), errors="replace")
    answer("list", "scenarios", folder / "mine.toml")
    answer("render", folder / "mine.toml", "--out", folder / "x.svg")


@pytest.mark.slow
@fuzz
@given(EDITS, BYTES)
def test_maps(folder, edits, other):
    source = scenario_path("office_8")
    shutil.copy(source, folder / "mine.toml")
    (folder / "office.yaml").write_text(edit_text(source.with_name("office.yaml").read_text(), edits), errors="replace")
    for path in source.parent.glob("office.*"):
        if path.suffix not in (".yaml", ".toml"):
            (folder / path.name).write_bytes(edit_bytes(path.read_bytes(), other))
    answer("render", folder / "mine.toml", "--out", folder / "x.svg")


@fuzz
@given(EDITS, EDITS)
def test_tracks(folder, edits, others):
    recordings.write(folder)
    tracks = folder / "mine.txt"
    tracks.write_text(edit_text(tracks.read_text(), edits), errors="replace")
    answer("render", folder / "mine.toml", "--data", folder, "--out", folder / "x.svg")
    (folder / "mine.toml").write_text(edit_text(recordings.TOML, others), errors="replace")
    answer("render", folder / "mine.toml", "--data", folder, "--out", folder / "x.svg")
