"""What a planner can try against a board, by the way in: each attempt gains nothing, and honest ones pass."""

import dataclasses
import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import safetensors.numpy
from board_entries import PLANNER, entered, seal, submitted
from commands.test_newcomer import export
from small_boards import BOARD, SEASON, verifier, verify, write_board
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli.app import app
from crowdbench.isolation import limits, sandbox
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.board_runs import CaseSet, EntryPlanner
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.ranked_run import drive_ranked, read_ranked
from crowdbench_leaderboards.submission import submit
from crowdbench_leaderboards.verdict import Verdict

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]


# A1: the season's seed in the sandbox


@pytest.mark.nightly
def test_a_planner_finds_no_season_no_board_and_no_entry(root, tmp_path):
    names = "season.toml", "frozen.json", "board.toml", "entry.json", "maintainers"
    looks = f"""
looked = []
def think(obs, commands):
    if looked:
        return commands
    looked.append(True)
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


def test_a_board_in_a_folder_of_python_is_hidden_from_its_entries(tmp_path):
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


# A2, B1, B2: slow, or thinking, only where it is not timed: every ranked decision is timed, in one world


def test_a_planner_that_is_slow_in_the_ranked_cases_alone_is_slow(tmp_path):
    # It is quick in its first cases, as if they alone were timed, and in every batch.
    waits = """
cases = 0
def think(obs, commands):
    global cases
    cases += obs.step[0] == 0
    time.sleep(0.3 * (len(obs) == 1 and cases > 3 and obs.step[0] < 3))
    return commands
"""
    entry, board = submitted(tmp_path, PLANNER + waits)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.decision_time.p99_ms > 300.0
    assert not found.decision_time.is_real_time


def test_every_decision_of_the_ranked_cases_is_timed(tmp_path):
    entry, board = submitted(tmp_path, PLANNER)
    task, *_ = verifier(tmp_path / "boards", tmp_path / "work").tasks(
        entry, CaseSet(board, board.cases, 7), tmp_path / "runs"
    )
    drive_ranked(task)
    run = read_ranked(task)
    assert len(run.seconds) == run.episodes.steps.sum()
    assert run.episodes.case.tolist() == list(range(10))
    assert task.order != sorted(task.order)
    assert sorted(task.order) == list(range(10))


def test_the_cases_of_a_ranked_run_come_one_at_a_time_and_in_a_drawn_order(tmp_path):
    alone = """
seen = [0]
def think(obs, commands):
    seen[0] += len(obs) == 1
    assert not seen[0] or len(obs.row) == 1
    return commands
"""
    entry, board = submitted(tmp_path, PLANNER + alone)
    orders = []
    for seed in (7, 8):
        (task,) = verifier(tmp_path / "boards", tmp_path / "work").tasks(
            entry, CaseSet(board, board.cases, seed), tmp_path / f"runs{seed}"
        )
        drive_ranked(task)
        orders.append([line["case"] for line in task.lines() if "case" in line])
        assert orders[-1] == task.order
    assert orders[0] != orders[1]


# A3: the next command in the low digits of a velocity


def test_commands_are_rounded_before_they_are_driven(tmp_path):
    hides = "def think(obs, commands):\n    return commands * 0.999999 + 1.23456e-6\n"
    entry, _ = submitted(tmp_path, PLANNER + hides)
    commands = np.concatenate(pq.read_table(entry.directory / "public.parquet")["command"].to_pylist()).reshape(-1, 2)
    np.testing.assert_array_equal(commands, np.round(commands, 4))
    assert np.hypot(*commands.T).max() <= 1.0


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
@pytest.mark.parametrize("wait", ["pass", "time.sleep(0.1)"])
def test_the_time_of_short_lived_children_is_that_of_the_decision(wait, tmp_path):
    entry, board = submitted(tmp_path, PLANNER + CHILDREN.replace("WAIT", wait))
    found = verify(entry, board, work=tmp_path / "work")
    assert found.decision_time.p99_ms > 60.0


# A5: the session keyring

KEYS = """
import ctypes
libc = ctypes.CDLL(None, use_errno=True)
if libc.syscall(248 if os.uname().machine == "x86_64" else 217, b"user", b"left", b"data", 4, -3) != -1:
    raise SystemExit("a key was left")
"""


def test_a_planner_leaves_no_key_for_the_next_one(tmp_path):
    entry, board = submitted(tmp_path, PLANNER + KEYS)
    assert verify(entry, board, work=tmp_path / "work").verdict == Verdict.RERUN


# A12: a planner that prints; tests/unit/isolation/test_limits.py has the rest


def test_a_planner_forges_no_verdict(root, tmp_path, capfd):
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


def test_a_verdict_says_what_has_limited_the_planner(root, tmp_path):
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


@pytest.mark.parametrize("groups", [pytest.param(True, marks=pytest.mark.nightly), False])
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


def test_an_honest_planner_with_a_lidar_is_verified(tmp_path):
    write_board(tmp_path / "boards", text=BOARD.replace("circle_crossing_5", "shop_10"))
    looks = "def think(obs, commands):\n    return commands * np.clip(obs.lidar.min(axis=1), 0.5, 1.0)[:, None]\n"
    entry, board = submitted(tmp_path, PLANNER + looks)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN, found.reason


PROGRAM = f"""#!{sys.executable}
import struct, sys
import numpy as np
from safetensors.numpy import load

def answer(kind, content=b""):
    sys.stdout.buffer.write(struct.pack("<IQ", kind, len(content)) + content)
    sys.stdout.buffer.flush()

while head := sys.stdin.buffer.read(12):
    kind, size = struct.unpack("<IQ", head)
    content = sys.stdin.buffer.read(size)
    if kind == 3:
        obs = load(content)
        way = obs["vehicle.goal"] - obs["vehicle.position"]
        answer(12, (0.9 * way / np.linalg.norm(way, axis=1, keepdims=True))[:, None].astype("<f8").tobytes())
    else:
        answer(11, b'{{"version": 1, "privileged": false}}' if kind == 1 else b"")
"""


def write_program(path):
    path.write_text(PROGRAM)
    path.chmod(0o755)


@pytest.mark.parametrize(
    ("file", "write"),
    [("program", write_program), pytest.param("policy.onnx", export, marks=pytest.mark.nightly)],
)
def test_honest_programs_and_onnx_files_are_verified(file, write, tmp_path):
    write(tmp_path / file)
    wanted = dataclasses.replace(entered(tmp_path, PLANNER), planner=str(tmp_path / file))
    entry, _ = submit(wanted, tmp_path / "boards", tmp_path / "work")
    assert entry.spec.planner == f"planner/{file}"
    found = verify(entry, wanted.board, work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN, found.reason
    assert found.decision_time.is_real_time
