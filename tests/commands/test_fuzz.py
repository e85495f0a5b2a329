"""Files that are edited at random, given to every command that reads them: one sentence, no traceback, no long wait.

`CROWDBENCH_FUZZ=2000 pytest -n 0 tests/commands/test_fuzz.py` tries 2000 random examples of each kind, else there are
a few, which are always the same.
"""

import contextlib
import io
import json
import os
import re
import shutil
import sys
import time
from unittest import mock

import pytest
import recordings
from helpers import make, reseal
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crowdbench.catalog import load_planner, load_scenario, scenario_path
from crowdbench.cli import app as cli
from crowdbench.metrics.registry import METRICS

FUZZ = int(os.environ.get("CROWDBENCH_FUZZ", "0"))
LONGEST = 10.0
"""Seconds of processor time that an answer may take."""

fuzz = settings(
    max_examples=FUZZ or 5,
    derandomize=not FUZZ,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
)

TOKENS = [
    *("", "0", "-1", "1", "2", "1e309", "-1e308", "1e-320", "nan", "inf", "9" * 30, "4611686018427387904", "0.25"),
    *("true", "null", "[]", "{}", "[[]]", '""', '"x"', "[0.0, 0.0]", "[" * 300, "é", "\0", "\ud7ff", "../x"),
    *("/dev/zero", ",", "\n", "orca", '"recorded"', "straight", "{ a = 1 }", "[x]", "a = 1", "=", ".", '"', "-"),
    *("test:0:1000000000000", "1_0"),
]
VALUES = st.recursive(
    st.sampled_from(
        [None, True, 0, -1, 3, 10**9, 2**63, 10**30, 1e300, -0.5, 1e-320, "", "x", "test:0:9", "é\0", "all"]
    ),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["x", "", "low", "n"]), inner, max_size=2)
    ),
    max_leaves=4,
)
EDITS = st.lists(st.tuples(st.floats(0, 0.999), st.sampled_from(TOKENS) | st.text(max_size=3)), min_size=1, max_size=3)
FIELDS = st.lists(st.tuples(st.floats(0, 0.999), st.none() | VALUES, st.booleans()), min_size=1, max_size=3)
BYTES = st.lists(st.tuples(st.floats(0, 0.999), st.binary(max_size=8)), min_size=1, max_size=3)


def edit_text(text, edits):
    """Put other words into a text."""
    for where, word in edits:
        spans = [match.span() for match in re.finditer(r"[\w.+-]+|[^\s\w]", text)] or [(0, 0)]
        start, stop = spans[int(where * len(spans))]
        text = text[:start] + word + text[stop:]
    return text


def edit_bytes(content, edits):
    for where, other in edits:
        at = int(where * len(content))
        content = content[:at] + other + content[at + len(other) + (not other) :]
    return content


def edit_json(table, edits):
    """Put other values into tables within tables, or remove some."""
    for where, value, is_removed in edits:
        places = list(places_in(table))
        inside, key = places[int(where * len(places))]
        if is_removed:
            del inside[key]
        else:
            inside[key] = value
        if not table:
            break
    return table


def places_in(table):
    for key in list(table) if isinstance(table, dict) else range(len(table)):
        yield table, key
        if isinstance(table[key], dict | list):
            yield from places_in(table[key])


def answer(*arguments):
    """Run a command in this process: its exit status. Fail where it needs a report, or takes long."""

    def run(*given):
        with (
            mock.patch.object(sys, "argv", ["crowdbench", *map(str, given)]),
            mock.patch.object(cli.interrupts, "handle"),
            contextlib.redirect_stdout(io.StringIO()) as out,
            contextlib.redirect_stderr(out),
            pytest.raises(SystemExit) as stop,
        ):
            cli.main()
        return stop.value.code or 0, out.getvalue()

    start = time.process_time()
    status, said = run(*arguments)
    took = time.process_time() - start
    if status == 3:
        run("--debug", *arguments)  # raises what it was
    assert status in (0, 1, 2), said
    assert took < LONGEST, arguments
    return status


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


@fuzz
@given(st.sampled_from(["run.rrd", "commands.parquet"]), BYTES)
def test_recordings_and_commands(runs, edited, name, edits):
    reseal(edited(name, lambda content: edit_bytes(content, edits)))
    ask_about_runs(runs)
    answer("render", runs / "edited", "--case", "1", "--out", runs / "x.svg")


SCENARIOS = ("circle_crossing_5", "groups_12", "office_8", "car_12", "crowdnav_plus_20", "restless_20")


@fuzz
@given(st.sampled_from(SCENARIOS), EDITS)
def test_scenarios(folder, name, edits):
    source = scenario_path(name)
    for path in source.parent.glob("office.*"):
        shutil.copy(path, folder)
    (folder / "mine.toml").write_text(edit_text(source.read_text(), edits), errors="replace")
    answer("list", "scenarios", folder / "mine.toml")
    answer("render", folder / "mine.toml", "--out", folder / "x.svg")


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
