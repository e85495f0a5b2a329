"""What an author can try against a board, by the way in: each attempt is refused, or gains nothing."""

import dataclasses
import io
import json
import marshal
import shutil
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from boards import BOARD, SEASON, card, not_timed, write_board
from standings import standings
from typer.testing import CliRunner

from crowdbench.boards.board import read_board
from crowdbench.boards.board_runs import EntryPlanner
from crowdbench.boards.entry import EntrySpec, check_submitter, read_entries, read_entry
from crowdbench.boards.planner_files import check_files
from crowdbench.boards.season import read_season
from crowdbench.boards.submission import Submission, rehearse, submit
from crowdbench.boards.verdict import Verdict, read_verification
from crowdbench.boards.verification import verify
from crowdbench.catalog import load_scenario
from crowdbench.cli import app
from crowdbench.isolation import limits, sandbox
from crowdbench.planners.driver import Driver
from crowdbench.runs.recording import read_commands
from crowdbench.runs.rollout import rollout
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import sha256

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]

PLANNER = """
import os, time
import crowdbench, numpy as np

class Mine(crowdbench.Planner):
    def plan(self, obs):
        way = obs.vehicle.goal - obs.vehicle.position
        near = np.linalg.norm(obs.pedestrians.position - obs.vehicle.position[:, None], axis=2).min(axis=1) < 1.2
        return think(obs, way * (np.where(near, 0.3, 0.9) / np.hypot(*way.T))[:, None])

def think(obs, commands):
    return commands

def planner(weights="", seed=0):
    return Mine()
"""


@pytest.fixture
def folder(root):
    """The folder of an entry in a folder of boards, which a test may change."""
    return root / "small" / "entries" / "careful"


@pytest.fixture
def _few_timed(monkeypatch):
    monkeypatch.setattr("crowdbench.boards.decision_time.TIMED", 3)


def seal(folder, **changes):
    """Write what an entry says, with the digests of its files as they are now."""
    table = json.loads((folder / "entry.json").read_text()) | changes
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name != "entry.json"]
    table["files"] = {path.relative_to(folder).as_posix(): sha256(path) for path in paths}
    (folder / "entry.json").write_text(json.dumps(table))


def entered(tmp_path, text, options=None, networks=(), name="mine", root=None, **fields):
    """What is submitted with a planner of this text."""
    root = root or tmp_path / "boards"
    board = read_board(root / "small") if (root / "small").exists() else write_board(root)
    (tmp_path / "mine.py").write_text(text)
    (tmp_path / "card.toml").write_text(card(**fields))
    return Submission(
        board, name, str(tmp_path / "mine.py"), options or {}, list(networks), tmp_path / "card.toml", "Ada"
    )


def submitted(tmp_path, text, **given):
    """An entry with a planner of this text, and its board."""
    wanted = entered(tmp_path, text, **given)
    return submit(wanted, tmp_path / "boards", tmp_path / "work")[0], wanted.board


# A1: the season's seed in the sandbox


def test_a_planner_finds_no_season_no_board_and_no_entry(root, tmp_path, monkeypatch):
    not_timed(monkeypatch)
    names = "season.toml", "frozen.json", "board.toml", "entry.json", "maintainers"
    looks = f"""
def think(obs, commands):
    found = [os.path.join(place, name) for place, _, files in os.walk('/') for name in files
             if name in {names!r} and not place.startswith(('/proc', '/sys'))]
    for path in {[str(root / "season.toml"), str(Path(__file__).parents[3] / "leaderboards" / "season.toml")]!r}:
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

    root = Path(__file__).parents[3]
    files = [file.distribution_path for file in WheelBuilder(str(root)).recurse_included_files()]
    of_boards = {path for path in files if "leaderboards" in path}
    assert {Path(path).name for path in of_boards} == {"board.toml"}
    assert "crowdbench/leaderboards/five/board.toml" in of_boards


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


@pytest.mark.usefixtures("_few_timed")
@pytest.mark.parametrize("wait", ["pass", "time.sleep(0.1)"])
def test_the_time_of_short_lived_children_is_that_of_the_decision(wait, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.boards.decision_time.TIMED", 2)
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


# A6: names


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("sarl_cvm", "Mine"),
        ("or_ca", "Mine"),
        ("orca_", "Mine"),
        ("mine", "O R C A"),
        ("mine", "sarl-lin"),
        ("0rca", "Mine"),
        ("mine", "SAR1"),
    ],
)
def test_an_entry_is_not_called_as_a_planner_that_ships(name, title, tmp_path):
    wanted = entered(tmp_path, PLANNER, name=name, title=f'"{title}"')
    for make in (rehearse, lambda *given: submit(*given, tmp_path / "work")):
        with pytest.raises(InputError, match="is the name of a planner that ships, or looks like it"):
            make(wanted, tmp_path / "boards")


def test_titles_are_ascii(tmp_path):
    with pytest.raises(InputError, match="must have letters of ASCII: others can look like these"):
        rehearse(entered(tmp_path, PLANNER, title='"\u041eRCA"'), tmp_path / "boards")


def test_a_name_of_a_card_that_ships_and_of_another_entry_is_taken(root, tmp_path):
    (root / "cards").mkdir()
    (root / "cards" / "strange.toml").write_text("")
    with pytest.raises(InputError, match=r"'strange', .* is the name of a planner that ships"):
        rehearse(entered(tmp_path, PLANNER, root=root, name="strange", title='"Mine"'), root)
    (root / "cards" / "social_force.toml").write_text("")
    baseline = entered(tmp_path, PLANNER, root=root, name="social_force", title='"Mine"')
    with pytest.raises(InputError, match=r"'social_force', .* is the name of a planner that ships"):
        rehearse(dataclasses.replace(baseline, planner="social_force"), root)
    taken = "is the name of the entry careful"
    with pytest.raises(InputError, match=taken):
        rehearse(entered(tmp_path, PLANNER, root=root, name="care_ful", title='"Mine"'), root)


def test_a_forged_name_is_refused_by_those_who_verify_and_show_it(root, tmp_path):
    shutil.copytree(root / "small" / "entries" / "careful", root / "small" / "entries" / "sarl_cvm")
    board = read_board(root / "small")
    with pytest.raises(InputError, match=r"'sarl_cvm', .* is the name of a planner that ships"):
        verify(read_entry(root / "small" / "entries" / "sarl_cvm"), board, work=tmp_path / "work")
    with pytest.raises(InputError, match=r"'sarl_cvm', .* is the name of a planner that ships"):
        read_entries(board, root)


# A8: compiled files, links, archives, large files


def zipped(*names):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in names:
            archive.writestr(name, b"1")
    return buffer.getvalue()


def tarred():
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("a"))
    return buffer.getvalue()


def bytecode():
    import importlib.util

    return importlib.util.MAGIC_NUMBER + bytes(12) + marshal.dumps(compile("1", "a", "exec"))


REFUSED = {
    "__pycache__/careful.cpython-311.pyc": bytecode(),
    "__pycache__/note.txt": b"text",
    "helper.pyc": bytecode(),
    "helper.PYC": b"anything",
    "weights.bin": bytecode(),
    "old.bin": (3394).to_bytes(2, "little") + b"\r\n" + bytes(20),
    "helper.so": b"anything",
    "helper.cpython-311-x86_64-linux-gnu.so": b"anything",
    "program": b"\x7fELF" + bytes(99),
    "a.zip": zipped("a.npy"),
    "a.whl": zipped("a.py"),
    "weights.npz": zipped("a.npy", "b.py"),
    "more.npz": zipped("a.npz"),
    "weights.pt": zipped("w/data.pkl", "w/code.py"),
    "hidden.bin": b"#" * 999 + zipped("a.pyc"),
    "a.tar": tarred(),
    "a.txt": tarred(),
    "a.gz": b"\x1f\x8b\x08" + bytes(20),
    "a.xz": b"\xfd7zXZ\0" + bytes(20),
    "large.bin": bytes(10_000_001),
}


@pytest.mark.parametrize("name", REFUSED)
def test_files_that_nobody_can_read_are_refused(name, folder):
    path = folder / "planner" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(REFUSED[name])
    seal(folder)
    with pytest.raises(InputError, match=r"is compiled: |is an archive|has more than 10 MB, which"):
        read_entry(folder)


@pytest.mark.parametrize("name", ["planner/\u0430.py", "planner/::error::.py", "planner/a\nb.py", "planner/.hidden"])
def test_names_of_files_are_plain(name, folder):
    (folder / name).write_text("")
    seal(folder)
    with pytest.raises(InputError, match="is none of the files that an entry may have"):
        read_entry(folder)


def test_weights_are_no_archives(tmp_path):
    np.savez_compressed(tmp_path / "weights.npz", a=np.ones(9))
    np.save(tmp_path / "weights.npy", np.ones(9))
    safetensors.numpy.save_file({"a": np.ones(9)}, tmp_path / "weights.safetensors")
    import torch

    torch.save({"a": torch.ones(9)}, tmp_path / "weights.pt")
    (tmp_path / "table.csv").write_bytes(b"ab\r\n1,2\r\n")
    check_files(tmp_path)


@pytest.mark.parametrize("name", ["helper.pyc", "helper.so", "link.py", "large.py"])
def test_submit_refuses_the_same_files(name, tmp_path):
    (tmp_path / "other.py").write_text("")
    path = tmp_path / name
    if name == "link.py":
        path.symlink_to("other.py")
    else:
        path.write_bytes(REFUSED.get(name, b"#" * 10_000_001))
    wanted = entered(tmp_path, f"import {path.stem}\n{PLANNER}")
    with pytest.raises(InputError, match=r"is compiled: |is a link: |has more than 10 MB"):
        rehearse(wanted, tmp_path / "boards")


def test_bytecode_beside_a_planner_is_never_run(tmp_path):
    import importlib.util
    import py_compile

    from crowdbench.plugins.load import load_module

    for name in ("shown", "helper"):
        path = tmp_path / f"{name}.py"
        path.write_text("value = 'hidden'\n")
        py_compile.compile(str(path), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
        assert Path(importlib.util.cache_from_source(str(path))).exists()
        path.write_text("value = 'shown'\n" + ("import helper\n" if name == "shown" else ""))
    module = load_module(tmp_path / "shown.py")
    assert (module.value, module.helper.value) == ("shown", "shown")


# A9: five equal networks


def weights(path, seed, **metadata):
    values = np.random.default_rng(seed).normal(size=9)
    safetensors.numpy.save_file({"b": values, "a": values[:4]}, path, metadata=metadata or None)
    return str(path)


@pytest.mark.parametrize("metadata", [{}, {"note": "other"}])
def test_networks_with_equal_tensors_are_refused(metadata, tmp_path):
    own = weights(tmp_path / "0.safetensors", 0)
    others = [{"weights": weights(tmp_path / f"{number}.safetensors", 0, **metadata)} for number in range(1, 5)]
    with pytest.raises(InputError, match="two networks of the entry are the same"):
        rehearse(entered(tmp_path, PLANNER, options={"weights": own}, networks=others), tmp_path / "boards")


def test_networks_that_drive_alike_are_refused(tmp_path, monkeypatch):
    not_timed(monkeypatch)
    own = weights(tmp_path / "0.safetensors", 0)
    others = [{"weights": weights(tmp_path / f"{seed}.safetensors", seed)} for seed in range(1, 5)]
    entry, board = submitted(tmp_path, PLANNER, options={"weights": own}, networks=others)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.REFUSED
    assert found.reason == "networks 1 and 2 of its method drive 10 of 10 cases alike"


# A10: names of submitters


@pytest.mark.parametrize(
    "name", ["\u0410da", "\uff21da", "Ada\u200b", "Łukasz", "\u0391da", ".Ada", " Ada", "", " ", "-", "A\u0308"]
)
def test_names_of_submitters_are_ascii(name, folder, tmp_path):
    with pytest.raises(InputError, match="cannot submit an entry"):
        check_submitter(name, "")
    seal(folder, submitted_by=name)
    with pytest.raises(InputError, match=r"submitted_by: |cannot submit an entry"):
        read_entry(folder)


@pytest.mark.parametrize("name", ["crowdbench", "CrowdBench", "crowd-bench", "Crowd Bench.", "crowd_bench"])
def test_nobody_is_called_as_the_maintainers(name):
    with pytest.raises(InputError, match="must be of a planner that ships"):
        check_submitter(name, "")


def test_submitters_differ_by_letters_and_digits(folder):
    own = read_entry(folder)
    for name in ("ADA", "Ada.", "A-d-a", "a d a"):
        spec = own.spec.model_copy(update={"submitted_by": name})
        assert type(own)(folder, EntrySpec(**spec.model_dump()), own.card).submitter == own.submitter


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


# A13: empty names


@pytest.mark.parametrize("arguments", [["--name", ""], ["--name", " "]])
def test_an_empty_name_is_refused(arguments, tmp_path):
    (tmp_path / "mine.py").write_text(PLANNER)
    (tmp_path / "card.toml").write_text(card())
    command = ["submit", str(tmp_path / "mine.py"), "--board", "five", "--dry-run", *arguments]
    done = CliRunner().invoke(app, command)
    assert done.exit_code != 0
    assert "cannot be an entry: its name must be" in str(done.exception)


@pytest.mark.parametrize("authors", ['[""]', '[" "]', "[]", '["Łukasz"]'])
def test_an_empty_submitter_is_refused(authors, tmp_path):
    (tmp_path / "mine.py").write_text(PLANNER)
    (tmp_path / "card.toml").write_text(card(authors=authors))
    done = CliRunner().invoke(app, ["submit", str(tmp_path / "mine.py"), "--board", "five", "--dry-run"])
    assert done.exit_code != 0
    assert "authors" in str(done.exception) or "cannot submit an entry" in str(done.exception)


# Without a sandbox


@pytest.mark.parametrize("name", ["careful", "orca"])
def test_nothing_is_verified_without_a_sandbox(name, root, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.isolation.sandbox.level", lambda: sandbox.PROCESS)
    with pytest.raises(InputError, match="an entry is verified in a sandbox, for which bubblewrap is needed"):
        verify(read_entry(root / "small" / "entries" / name), read_board(root / "small"), work=tmp_path)


def test_a_verdict_says_what_has_limited_the_planner(root, tmp_path, monkeypatch):
    not_timed(monkeypatch)
    found = verify(read_entry(root / "small" / "entries" / "orca"), read_board(root / "small"), work=tmp_path)
    assert "limited in memory" in found.reason


# A11: a worse copy of oneself


def outcomes(root, name, successes):
    """Write the outcomes of an entry in the season."""
    path = root / "small" / "verifications" / name / "first" / "circle_crossing_5" / "episodes.csv"
    header, *rows = path.read_text().splitlines()
    columns = [row.split(",") for row in rows]
    for number, row in enumerate(columns):
        row[1] = "success" if number in successes else "timeout"
    path.write_text("\n".join([header, *map(",".join, columns)]) + "\n")


@pytest.mark.parametrize("copied", [range(10), range(9), range(5), range(0)])
@pytest.mark.parametrize("rival", [range(10), range(0)])
def test_a_copy_of_oneself_changes_the_rank_and_the_tier_of_nobody_else(rival, copied, root, monkeypatch):
    board, season = read_board(root / "small"), read_season(root)
    verification = read_verification(read_entry(root / "small" / "entries" / "careful"), board, season)
    monkeypatch.setattr("standings.read_verification", lambda *_: verification)
    outcomes(root, "careful", range(10))
    outcomes(root, "orca", rival)
    before = standings(board, read_entries(board, root), season)
    for folder in ("entries", "verifications"):
        shutil.copytree(root / "small" / folder / "careful", root / "small" / folder / "a_copy")
    outcomes(root, "a_copy", copied)
    after = standings(board, read_entries(board, root), season)
    ranks = [{one.name: str(one.rank) for one in found.ranked} for found in (before, after)]
    assert ranks[1].pop("a_copy")
    assert ranks[0] == ranks[1]
    starts = [dict(zip([one.name for one in found.ranked], found.tiers, strict=True)) for found in (before, after)]
    assert starts[0]["orca"] == starts[1]["orca"]
    assert sum(starts[0].values()) == sum(starts[1].values())


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
