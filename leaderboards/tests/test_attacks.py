"""What a planner can try against a board, by the way in: each attempt gains nothing, and honest ones pass."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from board_entries import PLANNER, seal, submitted
from small_boards import BOARD, SEASON, not_timed, write_board
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli.app import app
from crowdbench.isolation import limits, sandbox
from crowdbench.planners.driver import Driver
from crowdbench.results.stored_commands import read_commands
from crowdbench.runs.rollout import rollout
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.board_runs import EntryPlanner
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.verdict import Verdict
from crowdbench_leaderboards.verification import verify

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]


@pytest.fixture
def _few_timed(monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.calibrated_time.TIMED", 3)


# A1: the season's seed in the sandbox


@pytest.mark.nightly
def test_a_planner_finds_no_season_no_board_and_no_entry(root, tmp_path, monkeypatch):
    not_timed(monkeypatch)
    names = "season.toml", "frozen.json", "board.toml", "entry.json", "maintainers"
    looks = f"""
def think(obs, commands):
    found = [os.path.join(place, name) for place, _, files in os.walk('/') for name in files
             if name in {names!r} and not place.startswith(('/proc', '/sys')) and '/rules/' not in place]
    for path in {[str(root / "season.toml"), str(Path(__file__).parents[1] / "season.toml")]!r}:
        try:
            found.append(open(path).read())
        except FileNotFoundError:
            pass
    if found:
        raise SystemExit(str(found))
    return commands
"""
    entry, board = submitted(tmp_path, PLANNER + looks)
    shutil.copy(root / "season.toml", tmp_path / "boards")
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN, found.reason


def test_a_board_in_a_folder_of_python_is_hidden_from_its_entries(tmp_path, monkeypatch):
    place = Path(sandbox.__file__).parent / "boards_of_a_test"  # in the package, which the sandbox shows
    try:
        board = write_board(place)
        (place / "season.toml").write_text(SEASON)
        folder = place / board.name / "entries" / "mine"
        (folder / "planner").mkdir(parents=True)
        opens = f"def think(obs, commands):\n    open({str(place / 'season.toml')!r})\n"
        (folder / "planner" / "mine.py").write_text(PLANNER + opens)
        scenario = load_scenario("circle_crossing_5")
        started = EntryPlanner(folder, "planner/mine.py", {}).start(scenario)
        with started as planner, pytest.raises(InputError, match="raised FileNotFoundError"):
            rollout(Driver(planner, "mine"), scenario, board.public_cases)
    finally:
        shutil.rmtree(place)


def test_the_wheel_has_the_rules_of_boards_and_no_season_or_entry():
    from hatchling.builders.wheel import WheelBuilder

    root = Path(__file__).parents[1]
    files = [file.distribution_path for file in WheelBuilder(str(root)).recurse_included_files()]
    of_boards = {path for path in files if "/rules/" in path}
    assert {Path(path).suffix for path in files} == {".py", ".html", ".md", ".toml"}
    assert {Path(path).name for path in files if path.endswith("toml")} == {"board.toml"}
    assert "crowdbench_leaderboards/rules/five/board.toml" in of_boards


# A2: slow on public cases only


@pytest.mark.usefixtures("_few_timed")
def test_the_board_fixes_the_cases_and_the_pace_is_that_of_drawn_ones(tmp_path):
    slow = "def think(obs, commands):\n    time.sleep(0.9 * (len(obs) == 8 and obs.step[0] < 3))\n    return commands\n"
    entry, board = submitted(tmp_path, PLANNER + slow)  # there are 8 public cases, and 10 others
    found = verify(entry, board, work=tmp_path / "work")
    assert found.figures["circle_crossing_5"]["success_rate"].n == board.spec.cases
    assert found.decision_time is not None
    assert found.decision_time.p99_ms < 800.0


# A3: the next command in the low digits of a velocity


def test_commands_are_rounded_before_they_are_driven(tmp_path, monkeypatch):
    not_timed(monkeypatch)
    hides = "def think(obs, commands):\n    return commands * 0.999999 + 1.23456e-6\n"
    entry, _ = submitted(tmp_path, PLANNER + hides)
    commands = read_commands(entry.public / "circle_crossing_5" / "commands.parquet").command
    np.testing.assert_array_equal(commands, np.round(commands, 4))
    assert np.hypot(*commands.T).max() <= 1.0


@pytest.mark.usefixtures("_few_timed")
@pytest.mark.parametrize(("unit", "offset"), [(1e-8, 0.0), (1e-3, 1e-4)])
def test_a_planner_cannot_send_its_decisions_to_the_process_that_is_timed(unit, offset, tmp_path):
    # In many worlds it thinks, and adds a trace of the next command to each. Alone it only goes on with the last one.
    decodes = f"""
def think(obs, commands):
    if len(obs.row) > 1:
        return np.round(commands / {unit}) * {unit} + {offset}
    velocity = obs.vehicle.velocity
    return velocity
"""
    entry, board = submitted(tmp_path, PLANNER + decodes)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.decision_time is None
    assert "of its decisions are within" in found.untimed


@pytest.mark.usefixtures("_few_timed")
def test_the_planner_that_is_timed_is_shown_nothing_of_its_earlier_commands(tmp_path):
    # In many worlds the speed tells what comes next; alone it follows what it sees, a step later.
    wanders = """
turn = 0.0
def think(obs, commands):
    global turn
    angle = 0.3 * np.sin(1e3 * obs.vehicle.position[:, 0] * len(obs.row) ** 9)
    if len(obs.row) == 1 and obs.step[0] > 0:
        return obs.vehicle.velocity
    turned = np.stack([commands[:, 0] * np.cos(angle) - commands[:, 1] * np.sin(angle),
                       commands[:, 0] * np.sin(angle) + commands[:, 1] * np.cos(angle)], axis=1)
    return turned
"""
    entry, board = submitted(tmp_path, PLANNER + wanders)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.decision_time is None


# A4: children on other cores

CHILDREN = """
import signal
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
def think(obs, commands):
    if len(obs.row) == 1:
        for _ in range(4):
            if os.fork() == 0:
                try:
                    os.sched_setaffinity(0, range(64))
                except OSError:
                    pass
                end = time.process_time() + 0.02
                while time.process_time() < end:
                    pass
                os._exit(0)
        WAIT
    return commands
"""


@pytest.mark.nightly
@pytest.mark.usefixtures("_few_timed")
@pytest.mark.parametrize("wait", ["pass", "time.sleep(0.1)"])
def test_the_time_of_short_lived_children_is_that_of_the_decision(wait, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.calibrated_time.TIMED", 2)
    entry, board = submitted(tmp_path, PLANNER + CHILDREN.replace("WAIT", wait))
    found = verify(entry, board, work=tmp_path / "work")
    assert found.decision_time is not None, found.untimed
    assert found.decision_time.p99_ms > 60.0


# A5: the session keyring

KEYS = """
import ctypes
libc = ctypes.CDLL(None, use_errno=True)
if libc.syscall(248 if os.uname().machine == "x86_64" else 217, b"user", b"left", b"data", 4, -3) != -1:
    raise SystemExit("a key was left")
"""


def test_a_planner_leaves_no_key_for_the_next_one(tmp_path, monkeypatch):
    not_timed(monkeypatch)
    entry, board = submitted(tmp_path, PLANNER + KEYS)
    assert verify(entry, board, work=tmp_path / "work").verdict == Verdict.RERUN


# A12: a planner that prints; tests/unit/isolation/test_limits.py has the rest


def test_a_planner_forges_no_verdict(root, tmp_path, monkeypatch, capfd):
    not_timed(monkeypatch)
    forges = (
        "def think(obs, commands):\n    print('careful on small: passes, re-run')\n    raise ValueError('::error::x')\n"
    )
    (root / "small" / "entries" / "careful" / "planner" / "careful.py").write_text(PLANNER + forges)
    seal(root / "small" / "entries" / "careful")
    done = CliRunner().invoke(app, ["verify", str(root / "small" / "entries" / "careful"), "--work", str(tmp_path)])
    shown = done.output + capfd.readouterr().err
    assert done.exit_code == 1
    assert "\ncareful on small: passes" not in f"\n{shown}"
    assert "::error" not in shown


# Without a sandbox


@pytest.mark.parametrize("name", ["careful", "orca"])
def test_nothing_is_verified_without_a_sandbox(name, root, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.verification.level", lambda: sandbox.PROCESS)
    with pytest.raises(InputError, match="an entry is verified in a sandbox, for which bubblewrap is needed"):
        verify(read_entry(root / "small" / "entries" / name), read_board(root / "small"), work=tmp_path)


def test_a_verdict_says_what_has_limited_the_planner(root, tmp_path, monkeypatch):
    not_timed(monkeypatch)
    found = verify(read_entry(root / "small" / "entries" / "orca"), read_board(root / "small"), work=tmp_path)
    assert "limited in memory" in found.reason


# Honest entries

NEURAL = """
import crowdbench, numpy as np
from safetensors.numpy import load_file

class Neural(crowdbench.Planner):
    def __init__(self, weights):
        self.weights = load_file(weights)
    def plan(self, obs):
        way = obs.vehicle.goal - obs.vehicle.position
        near = (obs.pedestrians.position - obs.vehicle.position[:, None]).reshape(len(obs), -1)[:, :10] / 5.0
        hidden = np.tanh(near.astype("f4") @ self.weights["hidden"])
        turn = 0.6 * np.tanh(hidden @ self.weights["out"])[:, 0]
        cos, sin = 0.95 * np.cos(turn), 0.95 * np.sin(turn)
        x, y = (way / np.hypot(*way.T)[:, None]).T
        return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1).astype("f4")

def planner(weights):
    return Neural(weights)
"""


def layers(path, seed):
    generator = np.random.default_rng(seed)
    values = {"hidden": generator.normal(size=(10, 64)), "out": generator.normal(scale=0.05, size=(64, 1))}
    safetensors.numpy.save_file({name: value.astype("f4") for name, value in values.items()}, path)
    return str(path)


@pytest.mark.usefixtures("_few_timed")
@pytest.mark.parametrize("groups", [True, False])
def test_honest_networks_are_verified_and_timed(groups, tmp_path, monkeypatch):
    if not groups:
        monkeypatch.setattr(limits, "_home", lambda: None)
    own, *others = (layers(tmp_path / f"{seed}.safetensors", seed) for seed in range(5))
    networks = [{"weights": path} for path in others]
    entry, board = submitted(tmp_path, NEURAL, options={"weights": own}, networks=networks)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN, found.reason
    assert found.method is not None
    assert found.method.networks == 5
    assert found.untimed == ""


@pytest.mark.usefixtures("_few_timed")
def test_an_honest_planner_with_a_lidar_is_verified(tmp_path):
    write_board(tmp_path / "boards", text=BOARD.replace("circle_crossing_5", "shop_10"))
    looks = "def think(obs, commands):\n    return commands * np.clip(obs.lidar.min(axis=1), 0.5, 1.0)[:, None]\n"
    entry, board = submitted(tmp_path, PLANNER + looks)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN, found.reason
    assert found.untimed == ""
