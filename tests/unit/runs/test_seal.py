import functools
import json
import re
import shutil

import pytest
from helpers import Still, make, reseal

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.cli.app import app
from crowdbench.metrics.registry import METRICS
from crowdbench.results.compare import compare
from crowdbench.results.result_file import check_result, write_result
from crowdbench.results.run_result import RunResult
from crowdbench.runs.identity import code
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import sha256


def go(out, planner, record="all"):
    return make(
        out,
        planner,
        load_scenario("circle_crossing_5"),
        "12",
        options={"pace": 1.0},
        record=record,
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs of the same cases: `a`, in which some succeed, and `b`, which never moves."""
    folder = tmp_path_factory.mktemp("runs")
    go(folder / "a", load_planner("orca"))
    go(folder / "b", Still(), record="none")
    return folder


@pytest.fixture
def a(runs, tmp_path):
    """A copy of `a`, to be forged."""
    shutil.copytree(runs / "a", tmp_path / "a")
    return tmp_path / "a"


def test_a_result_says_what_the_run_is_and_what_every_file_is(runs):
    result = json.loads((runs / "a" / "result.json").read_text())
    names = {path.name for path in (runs / "a").iterdir()} - {"result.json"}
    assert {name: result["files"].get(name) for name in names} == {name: sha256(runs / "a" / name) for name in names}
    run, stated = result["run"], result["stated"]
    assert (run["planner"]["name"], run["planner"]["options"], run["cases"]) == ("mine", {"pace": 1.0}, "test:0:12")
    assert (run["replanning"], run["decision_limit"], run["code"]) == ({}, 60.0, code())
    assert list(run["metrics"]) == list(METRICS)
    assert (stated["record"], stated["privileged"]) == ("all", False)
    assert {"python", "crowdbench", "numpy", "numba", "scipy"} <= set(stated["versions"])


def test_a_run_that_nobody_touched_is_read(runs):
    assert len(RunResult.read(runs / "a").episodes) == 12
    assert compare(runs / "a", runs / "b").warnings == []
    assert RunResult.read(runs / "a").warnings == []


@pytest.mark.parametrize("name", ["result.json", "episodes.csv", "run.rrd", "commands.parquet"])
def test_an_edited_file_is_named_and_so_is_a_missing_one(a, runs, name):
    content = (a / name).read_bytes()
    edited = (
        content.replace(b'"privileged": false', b'"privileged": true') if name == "result.json" else content + b"\n"
    )
    (a / name).write_bytes(edited)
    with pytest.raises(InputError, match=rf"{name} is not the file that the run wrote: its sha256 differs"):
        RunResult.read(a)
    (a / name).unlink()
    with pytest.raises(InputError, match=rf"{name}.* cannot be read"):
        RunResult.read(a)


@pytest.mark.parametrize("name", ["result.json", "episodes.csv", "run.rrd", "commands.parquet"])
def test_a_comparison_needs_the_result_and_the_episodes_alone(a, runs, name):
    (a / name).unlink()
    if name in ("result.json", "episodes.csv"):
        with pytest.raises(InputError, match=rf"{name}.* cannot be read"):
            compare(a, runs / "b")
    else:
        assert compare(a, runs / "b").cases == 12


def test_another_runs_recording_is_not_taken_for_the_own(runs, tmp_path):
    shutil.copytree(runs / "b", tmp_path / "b")
    shutil.copy(runs / "a" / "run.rrd", tmp_path / "b")
    with pytest.raises(InputError, match=r"run\.rrd is not a file of this run"):
        check_result(tmp_path / "b")


def rows(change):
    """A forgery of the rows of episodes.csv, each a list of texts; the header comes first."""

    def forge(directory):
        path = directory / "episodes.csv"
        header, *table = [line.split(",") for line in path.read_text().splitlines()]
        table = change(header, table)
        path.write_text("".join(",".join(row) + "\n" for row in [header, *table]))

    return forge


def cells(column, value, when=lambda row: True):
    """A forgery that writes a value into a column of the rows for which `when` holds."""

    def change(header, table):
        place = header.index(column)
        return [[*row[:place], value, *row[place + 1 :]] if when(row) else row for row in table]

    return rows(change)


def result(change):
    """A forgery of result.json."""

    return functools.partial(reseal, change=change)


def failed(row):
    return row[1] != "success"


def another_runs(directory):
    text = (directory / "episodes.csv").read_text().replace("collision,", "timeout,").replace("success,", "timeout,")
    (directory / "episodes.csv").write_text(text)


FORGERIES = {
    "deleted failures": (
        rows(lambda header, table: [row for row in table if not failed(row)]),
        "episodes.csv: its cases differ from test:0:12, as in result.json",
    ),
    "half the rows": (
        rows(lambda header, table: table[:6]),
        "episodes.csv: its cases differ from test:0:12, as in result.json",
    ),
    "doubled rows": (
        rows(lambda header, table: table * 2),
        "episodes.csv: its cases differ from test:0:12, as in result.json",
    ),
    "a row twice": (
        rows(lambda header, table: [table[0], *table[:11]]),
        "episodes.csv: its cases differ from test:0:12, as in result.json",
    ),
    "other cases": (cells("case", "7"), "episodes.csv: its cases differ from test:0:12, as in result.json"),
    "fewer cases": (
        result(lambda table: table["run"].update(cases="test:0:11")),
        "episodes.csv: its cases differ from test:0:11, as in result.json",
    ),
    "another outcome": (
        cells("outcome", "success", failed),
        "episodes.csv: (success|collision|timeout|person_collision)_rate contradicts the outcomes",
    ),
    "a running episode": (
        cells("outcome", "running", failed),
        "episodes.csv: (success|collision|timeout|person_collision)_rate contradicts the outcomes",
    ),
    "another run's outcomes": (
        another_runs,
        "result.json: run.metrics are not the columns of episodes.csv",
    ),
    "a rate that is a number": (cells("success_rate", "1.0"), "episodes.csv: success_rate contradicts the outcomes"),
    "no steps": (cells("steps", "0"), "episodes.csv: steps are not all from 1 to 97"),
    "endless steps": (cells("steps", "98"), "episodes.csv: steps are not all from 1 to 97"),
    "a rate against its outcome": (
        cells("success_rate", "true", failed),
        "episodes.csv: success_rate contradicts the outcomes",
    ),
    "faster": (
        cells("navigation_time", "5.0", lambda row: not failed(row)),
        "result.json: metrics.navigation_time.mean is [0-9.]+, but episodes.csv gives 5.0",
    ),
    "an undefined value": (
        cells("spl", "", failed),
        "result.json: metrics.spl.mean is [0-9.]+, but episodes.csv gives [0-9.]+",
    ),
    "a better mean": (
        result(lambda table: table["metrics"]["spl"].update(mean=0.99)),
        "result.json: metrics.spl.mean is 0.99, but episodes.csv gives [0-9.]+",
    ),
    "a metric less": (
        result(lambda table: table["metrics"].pop("spl")),
        "result.json: metrics.spl.mean is None, but episodes.csv gives [0-9.]+",
    ),
}


@pytest.mark.parametrize("kind", FORGERIES)
def test_a_table_that_contradicts_its_result_is_refused_also_with_fitting_digests(a, kind):
    forge, expected = FORGERIES[kind]
    forge(a)
    reseal(a)
    with pytest.raises(InputError) as error:
        RunResult.read(a)
    assert re.fullmatch(f"{a}/{expected}; make the run again", str(error.value))


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.pop("outcomes"),
        lambda table: table["outcomes"].update(success="all"),
        lambda table: table["scenario"].update(dt=0),
        lambda table: table["scenario"].update(time_limit="long"),
        lambda table: table["metrics"].update(spl=1.0),
        lambda table: table["metrics"]["spl"].update(mean="high"),
        lambda table: table["run"].update(cases="all"),
        lambda table: table["run"].update(planner="orca"),
        lambda table: table["stated"].pop("timing"),
        lambda table: table["stated"].update(versions=[]),
    ],
)
def test_a_result_of_other_types_is_none(a, change):
    reseal(a, change)
    with pytest.raises(InputError, match=r"result\.json"):
        RunResult.read(a)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda table: table["run"]["planner"].update(options={"pace": 2.0}), "has an id that is not that of its run"),
        (lambda table: table["run"].update(code="0"), "has an id that is not that of its run"),
        (lambda table: table.update(id="0"), "has an id that is not that of its run"),
    ],
)
def test_the_id_of_a_run_is_computed_again(a, runs, change, expected):
    table = json.loads((a / "result.json").read_text())
    change(table)
    write_result(a, table)
    for command in (["compare", str(a), str(runs / "b")], ["table", str(a)], ["merge", str(a)]):
        with pytest.raises(InputError, match=expected):
            app([*command, *(["--out", str(a / "out")] if command[0] == "merge" else [])], standalone_mode=False)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[" * 100_000, "is not valid JSON: it is nested too deeply"),
        ("{", "is not valid JSON"),
        ("[]", "is no result of crowdbench"),
        ('{"format": 2}', "has the format 2, but this version reads format 1"),
        ('{"format": 1, "files": {"episodes.csv": 1}}', "is no result of crowdbench: .*Field required"),
    ],
)
def test_a_result_that_is_none_gets_one_sentence(a, text, expected):
    (a / "result.json").write_text(text)
    with pytest.raises(InputError, match=expected) as error:
        RunResult.read(a)
    assert "\n" not in str(error.value)


def test_files_lie_beside_the_result(a):
    table = json.loads((a / "result.json").read_text())
    table["files"]["../b"] = "ab"
    (a / "result.json").write_text(json.dumps(table))
    with pytest.raises(InputError, match=r"lists '\.\./b', but the files of a run lie beside it"):
        RunResult.read(a)


def test_a_run_by_another_version_of_the_simulator_is_told(a, runs, capsys):
    reseal(a, lambda table: table["run"].update(simulator=0))
    for command in (["compare", str(a), str(runs / "b")], ["score", str(a)], ["table", str(a)]):
        app(command, standalone_mode=False)
        assert "was made by version 0 of the simulator, and this is version" in capsys.readouterr().err
