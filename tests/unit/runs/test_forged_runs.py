"""Every field of a run that somebody edits, with an id and digests that fit, is refused or is said to be stated."""

import copy
import json
import re
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import recordings
from helpers import Still, make, reseal

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.metrics.registry import METRICS
from crowdbench.results.episodes import Episodes
from crowdbench.results.result_file import read_result
from crowdbench.results.run_result import RunResult, summary_of
from crowdbench.runs.loading import load_stored_scenario
from crowdbench.runs.merge import merge
from crowdbench.runs.score import replay_run
from crowdbench.utils.errors import InputError

SOME = {name: METRICS[name] for name in ("success_rate", "timeout_rate", "navigation_time", "path_length", "jerk")}
OVERRIDES = {"vehicle.visible": True}


def go(out, record="all", cases="4", **options):
    scenario = load_scenario("circle_crossing_5", OVERRIDES)
    make(out, load_planner("orca"), scenario, cases, metrics=SOME, record=record, options=options, overrides=OVERRIDES)
    return out


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    """A run with a recording and a run without one."""
    folder = tmp_path_factory.mktemp("runs")
    return {"all": go(folder / "all", pace=1.0), "commands": go(folder / "commands", "commands", pace=1.0)}


@pytest.fixture(params=["all", "commands"])
def forged(honest, request, tmp_path):
    return shutil.copytree(honest[request.param], tmp_path / request.param)


@pytest.fixture
def run(honest, tmp_path):
    return shutil.copytree(honest["all"], tmp_path / "run")


STATED_FIELDS = re.compile(
    r"run\.planner\.(code|facts|files|key|name|options).*|run\.(batch|decision_limit|code|simulator|metrics\..*)"
    r"|run\.replanning.*|scenario\.(name|description)"
    r"|stated\.(privileged|raw|timing|versions|isolation).*"
)
"""What no other file of a run tells."""


def edits(value):
    """Other values for a field."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int):
        return [value + 1]
    if isinstance(value, float):
        return [value * (1.0 + 1e-6) if value else 1e-6]
    if isinstance(value, str):
        return [f"{value}x"]
    if isinstance(value, list):
        return [value[:-1] if value else [1.0]]
    return [1.0]


def set_value(table, path, value):
    *keys, last = path
    for key in keys:
        table = table[key]
    if value is REMOVED:
        del table[last]
    else:
        table[last] = value


def refusal(run, **files):
    """The sentence with which a run is refused when it is read, or computed again; None where all agrees."""
    try:
        stored = RunResult.read(run)
        replay = replay_run(stored, load_stored_scenario(stored, **files), {})
        return str(replay.differences[0]) if replay.differences else None
    except InputError as error:
        return str(error)


REMOVED = object()


def leaves(table, path=()):
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, (*path, key))
        elif isinstance(value, dict):
            yield (*path, key, "new"), 1.0
        else:
            yield (*path, key), value


def fields(run):
    """The paths of all fields of a result with other values; of some tables also new fields."""
    result = json.loads((run / "result.json").read_text())
    del result["files"], result["id"], result["format"]
    table = copy.deepcopy(result)
    for path, value in leaves(table):
        for other in [value] if path[-1] == "new" else edits(value):
            yield path, other
        if path[-1] != "new" and not (path[0] == "scenario" and value is None):
            yield path, REMOVED
    for path in [("rank",), ("run", "verified"), ("stated", "verified"), ("metrics", "jerk", "p"), ("scenario", "x")]:
        yield path, 1.0
    yield ("metrics", "new"), {"mean": 1.0, "low": 1.0, "high": 1.0, "n": 4, "max": 1.0}
    yield ("blocks",), 2


@pytest.mark.slow
def test_every_edited_field_is_refused_or_stated(forged):
    """Fields of a forged result, one after the other: those that are read need to be stated ones."""
    kept, accepted, tried = (forged / "result.json").read_text(), [], 0
    for path, value in fields(forged):
        (forged / "result.json").write_text(kept)
        reseal(forged, lambda table, path=path, value=value: set_value(table, path, value))
        tried += 1
        sentence = refusal(forged)
        if sentence is None:
            accepted.append((".".join(path), value))
        else:
            assert re.fullmatch(r".*(result\.json|run\.rrd).*", sentence), path
    assert tried > 100
    wrong = [field for field in accepted if not STATED_FIELDS.fullmatch(field[0])]
    assert [field for field in wrong if field != ("stated.overrides.vehicle.visible", REMOVED)] == []


@pytest.mark.parametrize("column", ["navigation_time", "path_length", "jerk", "success_rate", "timeout_rate", "steps"])
def test_every_edited_column_is_refused(forged, column):
    lines = [line.split(",") for line in (forged / "episodes.csv").read_text().splitlines()]
    at = lines[0].index(column)
    row = next(line for line in lines[1:] if line[at])
    row[at] = {"true": "false", "false": "true"}.get(row[at]) or str(float(row[at]) + 1)[
        : 99 if column != "steps" else -2
    ]
    (forged / "episodes.csv").write_text("".join(",".join(line) + "\n" for line in lines))
    reseal(forged)
    with pytest.raises(InputError, match=column if column != "steps" else "steps differ from"):
        RunResult.read(forged)


def test_values_exchanged_between_cases_are_found_by_a_replay(forged, call):
    lines = (forged / "episodes.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    at = lines[0].split(",").index("jerk")
    rows[0][at], rows[1][at] = rows[1][at], rows[0][at]
    (forged / "episodes.csv").write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")
    episodes = Episodes.read(forged / "episodes.csv")
    reseal(forged, lambda table: table.update(summary_of(episodes)))
    done = call("score", str(forged))
    assert done.returncode == 1
    assert "2 of 4 cases have other figures in episodes.csv: test/0 (jerk" in done.stdout


def commands_of(run, change):
    table = pq.read_table(run / "commands.parquet")
    case, command = change(table["case"].to_pylist(), table["command"].to_pylist())
    columns = [pa.array(case, pa.int64()), pa.array(command, pa.list_(pa.float64()))]
    pq.write_table(pa.table(columns, table.schema), run / "commands.parquet")


def write(name, content):
    return lambda run, other: (run / name).write_bytes(content)


RANDOM = np.random.default_rng(0).bytes(10_000)

FILES = {
    "random commands": write("commands.parquet", RANDOM),
    "random commands between marks": write("commands.parquet", b"PAR1" + RANDOM + b"PAR1"),
    "empty commands": write("commands.parquet", b""),
    "random recording": write("run.rrd", RANDOM),
    "random recording between marks": write("run.rrd", b"RRF2" + RANDOM + b"RRF2FOOT" + bytes([1, 0, 0, 0])),
    "empty recording": write("run.rrd", b""),
    "random episodes": write("episodes.csv", RANDOM),
    "empty episodes": write("episodes.csv", b""),
    "no episodes": lambda run, other: (run / "episodes.csv").unlink(),
    "recording cut": lambda run, other: (run / "run.rrd").write_bytes((run / "run.rrd").read_bytes()[:-5000]),
    "recording removed": lambda run, other: (run / "run.rrd").unlink(),
    "commands removed": lambda run, other: (run / "commands.parquet").unlink(),
    "recording of another run": lambda run, other: shutil.copy(other / "run.rrd", run),
    "commands of another run": lambda run, other: shutil.copy(other / "commands.parquet", run),
    "a case less": lambda run, other: commands_of(run, lambda case, command: (case[1:], command[1:])),
    "cases of another number": lambda run, other: commands_of(run, lambda case, command: (case[::-1], command)),
    "a command less": lambda run, other: commands_of(run, lambda case, command: (case, [row[2:] for row in command])),
}


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A run of other options and cases."""
    return go(tmp_path_factory.mktemp("other") / "other", cases="1:5", pace=2.0)


@pytest.mark.parametrize("kind", FILES)
def test_exchanged_and_broken_files_are_refused(run, other, kind):
    FILES[kind](run, other)
    reseal(run)
    assert re.search(r"run\.rrd|commands\.parquet|episodes\.csv", refusal(run))


COMMANDS = {
    "table": ["table", "RUN", "--metric", "jerk"],
    "compare": ["compare", "RUN", "RUN"],
    "score": ["score", "RUN"],
    "merge": ["merge", "RUN", "--out", "OUT"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_refuses_an_edited_interval_and_score_says_what_is_stated(call, run, tmp_path, command):
    places = {"RUN": str(run), "OUT": str(tmp_path / "out")}
    arguments = [places.get(argument, argument) for argument in COMMANDS[command]]
    done = call(*arguments)
    assert done.returncode == 0
    assert ("tated by the run" in done.stdout + done.stderr) == (command == "score")
    shutil.rmtree(tmp_path / "out", ignore_errors=True)
    reseal(run, lambda table: table["metrics"]["jerk"].update(high=9.0))
    done = call(*arguments)
    assert done.returncode == 1
    assert "metrics.jerk.high is 9.0, but episodes.csv gives" in done.stdout + done.stderr
    for change in (lambda table: table["stated"].pop("timing"), lambda table: table["stated"].pop("versions")):
        reseal(run, change)
        done = call(*arguments)
        assert done.returncode == 1
        assert "Field required" in done.stderr


def test_a_score_of_states_is_that_of_the_episodes(run, call):
    """A forger who rewrites episodes.csv and the summary, and leaves the recording alone."""
    episodes = Episodes.read(run / "episodes.csv")
    episodes.columns["jerk"][:] /= 2.0
    episodes.write(run / "episodes.csv")
    reseal(run, lambda table: table.update(summary_of(episodes)))
    RunResult.read(run)
    done = call("score", str(run))
    assert done.returncode == 1
    assert "4 of 4 cases have other figures in episodes.csv: test/0 (jerk" in done.stdout


def test_what_parts_state_of_their_isolation_is_joined(tmp_path):
    a, b = go(tmp_path / "a", "commands", "2"), go(tmp_path / "b", "commands", "2:4")
    reseal(a, lambda table: table["stated"].update(isolation={"level": "a", "peak": 1}))
    reseal(b, lambda table: table["stated"].update(isolation={"level": "b", "peak": "much"}))
    result = merge([a, b], tmp_path / "c")
    assert result["stated"]["isolation"] == {"level": "a, b", "peak": "1, much"}


STROLL = """
import numpy as np
from crowdbench import PedestrianPolicy

class Stroll(PedestrianPolicy):
    parameters = {"pace": 0.5, "turns": 3}

    def velocities(self, world, parameters):
        return np.zeros_like(world.position[:, 1:])

def policy():
    return Stroll()
"""

SPREAD = """
import numpy as np

from crowdbench.scenario.placement import Placement

def layout(rng, radius, preferred_speed, *, width=5.0, rows=2, name="x"):
    starts = np.stack([np.linspace(-width, width, len(radius)), np.zeros(len(radius))], 1)
    return Placement(starts, starts + np.array([0.0, 4.0]))
"""


@pytest.mark.parametrize("kind", ["own files", "recorded people"])
def test_an_edited_scenario_is_refused_when_it_is_loaded(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if kind == "own files":
        (tmp_path / "stroll.py").write_text(STROLL)
        (tmp_path / "spread.py").write_text(SPREAD)
        overrides = {
            "layout.generator": "spread.py",
            "layout.width": 6,
            "pedestrians.policy": {"orca": 1, "stroll.py": 2.0},
            "pedestrians.stroll.pace": {"low": 0.2, "high": 0.8},
            "pedestrians.number": 3,
        }
        (tmp_path / "mine.toml").write_text("")
        scenario = load_scenario("mine.toml", overrides)
        field, wrong = ("layout", "width"), 7.0
        files = {"pedestrians": ["stroll.py"], "layout": "spread.py"}
    else:
        overrides = {"tracks.distance": 3.0}
        scenario = recordings.scenario(tmp_path, tracks__distance=3.0)
        field, wrong = ("tracks", "distance"), 4.0
        files = {"data": tmp_path}
    make(tmp_path / "run", Still(), scenario, "4", metrics=SOME, record="commands", overrides=overrides)
    table = json.loads((tmp_path / "run" / "result.json").read_text())["scenario"]
    assert RunResult.read(tmp_path / "run").result["scenario"] == table
    for change, said in (
        (lambda result: set_value(result["scenario"], field, wrong), "run.scenario is"),
        (lambda result: result["stated"]["overrides"].update({".".join(field): wrong}), "stated.overrides differ"),
    ):
        forged = shutil.copytree(tmp_path / "run", tmp_path / "forged", dirs_exist_ok=True)
        reseal(forged, change)
        assert said in str(refusal(forged, **files))


def test_a_billion_pedestrians_are_refused_whatever_the_digest(run):
    reseal(run, lambda result: result["scenario"]["pedestrians"].update(number=[5, 10**9]))
    sentence = r"pedestrians.number is \[5, 1000000000\], but must be a whole number from 0 to"
    with pytest.raises(InputError, match=sentence):
        load_stored_scenario(RunResult(run, read_result(run), Episodes.read(run / "episodes.csv")))
