import json
import shutil
import subprocess
import sys

import pytest
from helpers import Still, make

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.cli import app
from crowdbench.metrics import METRICS
from crowdbench.runs.compare import compare
from crowdbench.runs.manifest import check_files, code, doubts, write_manifest
from crowdbench.runs.store import RunResult
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import sha256


def go(out, planner, record="all"):
    return make(
        out,
        planner,
        load_scenario("circle_crossing_5"),
        "12",
        options={"pace": 1.0},
        details={"planner_files": {"planner": {"mine.py": "ab"}}},
        origin={"planner": "./mine.py"},
        record=record,
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs of the same cases: `a`, in which some succeed, and `b`, which never moves."""
    folder = tmp_path_factory.mktemp("runs")
    go(folder / "a", load_planner("orca")[1])
    go(folder / "b", Still(), record="none")
    return folder


@pytest.fixture
def a(runs, tmp_path):
    """A copy of `a`, to be forged."""
    shutil.copytree(runs / "a", tmp_path / "a")
    return tmp_path / "a"


def test_a_manifest_says_what_was_asked_and_what_every_file_is(runs):
    manifest = json.loads((runs / "a" / "manifest.json").read_text())
    names = {path.name for path in (runs / "a").iterdir()} - {"manifest.json"}
    assert manifest["files"] == {name: sha256(runs / "a" / name) for name in names}
    assert manifest["interrupted"] is False
    asked = manifest["asked"]
    assert (asked["planner"], asked["options"], asked["cases"]) == ("./mine.py", {"pace": 1.0}, "test:0:12")
    assert (asked["record"], asked["replan_every"], asked["decision_limit"]) == ("all", 1, 60.0)
    assert asked["metrics"] == list(METRICS)
    assert manifest["planner_files"] == {"planner": {"mine.py": "ab"}}
    assert {"python", "crowdbench", "numpy", "numba", "scipy"} <= set(manifest["versions"])


def test_a_run_that_nobody_touched_is_read(runs):
    assert len(RunResult.read(runs / "a").episodes) == 12
    assert compare(runs / "a", runs / "b").doubts == []
    assert doubts(runs / "a", ("run.rrd",)) == []


@pytest.mark.parametrize("name", ["result.json", "episodes.csv", "run.rrd", "commands.parquet"])
def test_an_edited_file_is_named_and_so_is_a_missing_one(a, runs, name):
    content = (a / name).read_bytes()
    (a / name).write_bytes(content + b"\n")
    with pytest.raises(
        InputError, match=rf"{name} is not the file that the run wrote: its sha256 differs from manifest"
    ):
        compare(a, runs / "b")
    (a / name).unlink()
    with pytest.raises(InputError, match=rf"{name}.* cannot be read"):
        compare(a, runs / "b")


def test_another_runs_recording_is_not_taken_for_the_own(runs, tmp_path):
    shutil.copytree(runs / "b", tmp_path / "b")
    shutil.copy(runs / "a" / "run.rrd", tmp_path / "b")
    with pytest.raises(InputError, match=r"run\.rrd is not a file of this run"):
        doubts(tmp_path / "b", ("run.rrd",))


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

    def forge(directory):
        table = json.loads((directory / "result.json").read_text())
        change(table)
        (directory / "result.json").write_text(json.dumps(table))

    return forge


def failed(row):
    return row[1] != "success"


def another_runs(directory):
    text = (directory / "episodes.csv").read_text().replace("collision,", "timeout,").replace("success,", "timeout,")
    (directory / "episodes.csv").write_text(text)


FORGERIES = {
    "deleted failures": (
        rows(lambda header, table: [row for row in table if not failed(row)]),
        "rows, but result.json",
    ),
    "half the rows": (rows(lambda header, table: table[:6]), "has 6 rows, but result.json says cases test:0:12"),
    "doubled rows": (rows(lambda header, table: table * 2), "has 24 rows"),
    "a row twice": (rows(lambda header, table: [table[0], *table[:11]]), "has case 0 in the place of case 1"),
    "other cases": (cells("case", "7"), "has case 7 in the place of case 0"),
    "no steps": (cells("steps", "0"), "has 0 steps in case 0, which must be 1 to 97"),
    "negative steps": (cells("steps", "-3"), "has -3 steps"),
    "endless steps": (cells("steps", "98"), "has 98 steps"),
    "another outcome": (cells("outcome", "success", failed), "episodes with the outcome success, but result.json says"),
    "a running episode": (cells("outcome", "running", failed), "with the outcome running, but result.json says 0"),
    "another run's outcomes": (another_runs, "with the outcome"),
    "a rate against its outcome": (cells("success_rate", "true", failed), "has another success_rate than the outcome"),
    "a rate that is a number": (cells("success_rate", "1.0"), "column success_rate that are not true or false"),
    "faster": (
        cells("navigation_time", "5.0", lambda row: not failed(row)),
        "values of navigation_time with the mean 5",
    ),
    "an undefined value": (cells("spl", "", failed), "values of spl with the mean"),
    "a better mean": (
        result(lambda table: table["metrics"]["spl"].update(mean=0.99)),
        "but result.json says 12 with 0.99",
    ),
    "a metric less": (result(lambda table: table["metrics"].pop("spl")), r"not the same metrics \(spl\)"),
    "fewer cases": (result(lambda table: table.update(cases="test:0:11")), "has 12 rows"),
}


@pytest.mark.parametrize("kind", FORGERIES)
def test_without_a_manifest_a_table_that_contradicts_its_result_is_refused(a, kind):
    forge, expected = FORGERIES[kind]
    (a / "manifest.json").unlink()
    assert len(RunResult.read(a).episodes) == 12
    forge(a)
    with pytest.raises(InputError, match=expected) as error:
        RunResult.read(a)
    assert str(error.value).startswith(f"{a / 'episodes.csv'} ")
    assert str(error.value).endswith("; make the run again")


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.pop("outcomes"),
        lambda table: table["outcomes"].update(success="all"),
        lambda table: table["scenario"].update(dt=0),
        lambda table: table["scenario"].update(time_limit="long"),
        lambda table: table["metrics"].update(spl=1.0),
        lambda table: table["metrics"]["spl"].update(mean="high"),
        lambda table: table.update(cases="all"),
    ],
)
def test_a_result_of_other_types_is_none(a, change):
    (a / "manifest.json").unlink()
    result(change)(a)
    with pytest.raises(InputError, match=r"result\.json"):
        RunResult.read(a)


REST = '"code": "a", "versions": {}, "interrupted": false}'
"""The end of a manifest without its files."""


@pytest.mark.parametrize(
    ("manifest", "expected"),
    [
        ("[" * 100_000, "is not valid JSON: it is nested too deeply"),
        ("{", "is not valid JSON"),
        ("[]", "is not a manifest"),
        ('{"format": 2}', "has the format 2, but this version reads format 1"),
        ('{"format": 1, "files": {"episodes.csv": 1}, ' + REST, "must hold files, code, versions"),
        ('{"format": 1, "files": {}, "code": "a", "versions": {}}', "must hold files, code, versions, interrupted"),
        ('{"format": 1, "files": {"../b": "ab"}, ' + REST, "lists '../b'"),
        ('{"format": 1, "files": {}, ' + REST, "result.json is not a file of this run"),
    ],
)
def test_a_manifest_that_is_none_gets_one_sentence(a, manifest, expected):
    (a / "manifest.json").write_text(manifest)
    with pytest.raises(InputError, match=expected) as error:
        RunResult.read(a)
    assert "\n" not in str(error.value)


def test_a_run_without_a_manifest_and_one_by_other_code_are_told(a, runs, capsys):
    manifest = json.loads((a / "manifest.json").read_text()) | {"code": "another"}
    (a / "manifest.json").write_text(json.dumps(manifest))
    for command in (["compare", str(a), str(runs / "b")], ["score", str(a)]):
        app(command, standalone_mode=False)
        assert "other code of crowdbench" in capsys.readouterr().err.replace("different code", "other code")
    (a / "manifest.json").unlink()
    for command in (["compare", str(a), str(runs / "b")], ["score", str(a)]):
        app(command, standalone_mode=False)
        assert f"{a} has no manifest.json" in capsys.readouterr().err
    app(["score", str(a / "run.rrd")], standalone_mode=False)
    assert capsys.readouterr().err == ""


def test_a_run_that_was_interrupted_is_told(a, runs):
    manifest = json.loads((a / "manifest.json").read_text()) | {"interrupted": True}
    (a / "manifest.json").write_text(json.dumps(manifest))
    assert compare(runs / "b", a).doubts == [f"{a} was interrupted: only the cases that it finished are compared"]


def test_large_files_are_sealed_too(tmp_path):
    (tmp_path / "large").write_bytes(b"0123456789" * 100_000)
    write_manifest(tmp_path, {"versions": {}, "interrupted": False})
    manifest = check_files(tmp_path, ())
    assert list(manifest["files"]) == ["large"]
    assert manifest["code"] == code()


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [("sarl_cvm", "--record", "all"), ("orca", "--isolated")])
def test_what_does_not_count_as_the_code_of_a_run_does_not_run_in_one(arguments, tmp_path):
    watch = (
        "import sys\n"
        "from pathlib import Path\n"
        "entered = set()\n"
        "def profile(frame, event, argument):\n"
        "    entered.add(frame.f_code.co_filename)\n"
        "import crowdbench.cli as cli\n"
        "from crowdbench.runs.manifest import APART\n"
        "app = cli.build_app(['run'])\n"
        "sys.setprofile(profile)\n"
        f"app(['run', '--planner', *{arguments!r}, '--cases', '1', '--out', 'run'], standalone_mode=False)\n"
        "sys.setprofile(None)\n"
        "apart = [name for name in entered if any(Path(name).is_relative_to(place) for place in APART)]\n"
        "print([name for name in apart if 'cli' not in Path(name).parts and 'agents' not in Path(name).parts])\n"
    )
    done = subprocess.run([sys.executable, "-c", watch], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr
