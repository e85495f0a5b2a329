"""What nobody should give gets one sentence: no traceback, no wait without an end, no wrong reason."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from crowdbench.api import run
from crowdbench.cli import app as cli
from crowdbench.cli import console
from crowdbench.cli.options import assignments
from crowdbench.results.result_file import read_result
from crowdbench.scenario.cases import Cases, parse_case
from crowdbench.utils.errors import InputError, Interrupted
from crowdbench.utils.files import new_directory
from crowdbench.utils.toml import DEEPEST

DEEP = "[" * 5000 + "]" * 5000
DIGITS = "9" * 5000


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def crowdbench(call):
    """Runs a command: its exit status, what it prints, and its sentence about an error."""

    def run(*arguments):
        done = call(*arguments)
        errors = [line for line in done.stderr.splitlines() if not line.startswith("compiling")]
        return done.returncode, done.stdout, errors

    return run


def test_a_model_that_holds_code_and_a_file_of_no_network_are_refused(crowdbench):
    for name in ("model.zip", "model.pt", "model.pth", "broken.onnx"):
        Path(name).write_text("network")
    for name in ("./model.zip", "model.pt", "model.pth"):
        for command in (["run", "--planner", name], ["check", name]):
            status, _, errors = crowdbench(*command)
            assert (status, len(errors)) == (1, 1)
            assert "holds code, which crowdbench does not run" in errors[0]
            assert "crowdbench.export_policy(" in errors[0]
    for option in ("--pedestrians", "--metric"):
        status, _, errors = crowdbench("run", "--planner", "orca", option, "model.zip")
        assert (status, len(errors)) == (1, 1)
        assert "model.zip is not a Python file" in errors[0]
    pytest.importorskip("onnxruntime", reason="ONNX Runtime is not installed: pip install 'crowdbench[onnx]'")
    status, _, errors = crowdbench("run", "--planner", "broken.onnx")
    assert (status, len(errors)) == (1, 1)
    assert "broken.onnx cannot be read as an ONNX file" in errors[0]


@pytest.mark.parametrize(
    ("value", "right"),
    [(DEEP, f"can be nested {DEEPEST} deep"), (DIGITS, "must fit into 64 bits")],
)
def test_toml_that_nobody_means_is_refused_in_files_and_options(crowdbench, value, right):
    Path("mine.toml").write_text(f"seed = {value}\n")
    status, _, errors = crowdbench("run", "--planner", "orca", "--scenario", "./mine.toml")
    assert (status, len(errors)) == (1, 1)
    assert "mine.toml cannot be used: " in errors[0]
    assert right in errors[0]
    for flag in ("--set", "--option"):
        with pytest.raises(InputError, match=right):
            assignments([f"seed={value}"], flag)


@pytest.mark.parametrize("text", ["٣", DIGITS, "1_000"])
def test_cases_are_ascii_digits_of_a_number_that_there_can_be(text):
    with pytest.raises(InputError, match="not a range of cases"):
        Cases.parse(text)
    with pytest.raises(InputError, match="not the name of a case"):
        parse_case(f"test/{text}")


def test_a_range_of_more_cases_than_a_run_can_have_is_refused_at_once(crowdbench):
    status, _, errors = crowdbench("run", "--planner", "orca", "--cases", "0:99999999999")
    assert status == 1
    assert errors == ["crowdbench: cases test:0:99999999999 are 99999999999 cases, but must be at most 1000000"]
    with pytest.raises(InputError, match="but must be at most 1000000"):
        run("orca", cases=10**12)


@pytest.mark.parametrize(
    "arguments",
    [("exam", 0, 3), ("val", 3, 2), ("val", -1, 2), ("val", "0", 2), (3, 0, 2), ("val", 0, 2.5), ("val", 0, 2**62 + 1)],
)
def test_cases_that_are_no_range_are_refused(arguments):
    with pytest.raises(InputError, match=r"(split|start|stop) is .*, but must be"):
        Cases(*arguments)


def special(path, kind):
    """Make a path that is no file: reading some of them would never end."""
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir(parents=True)
    else:
        path.symlink_to(f"/dev/{kind}")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs devices")
@pytest.mark.parametrize("kind", ["fifo", "zero"])
@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("x.toml", ["run", "--planner", "orca", "--scenario", "x.toml"]),
        ("x.py", ["run", "--planner", "x.py"]),
        ("x.py", ["run", "--planner", "orca", "--metric", "x.py"]),
        ("result.json", ["compare", ".", "."]),
        ("x.rrd", ["view", "x.rrd"]),
    ],
)
def test_pipes_devices_and_folders_are_not_read(crowdbench, tmp_path, name, command, kind):
    special(tmp_path / name, kind)
    status, out, _ = crowdbench(*command)
    assert (status, out) == (1, "")
    assert not [path for path in tmp_path.iterdir() if path.name != name]


@pytest.mark.parametrize(
    "command",
    [
        *(
            ["view"],
            ["table"],
            ["score"],
            ["plot", "success"],
            ["export", "--out", "x"],
        ),
        *(["merge", "--out", "x"], ["compare", "loop"], ["render"], ["check"], ["list", "scenarios"]),
        ["run", "--planner", "straight", "--cases", "1", "--out"],
    ],
    ids=" ".join,
)
def test_links_in_a_loop_end_in_a_sentence(crowdbench, command):
    Path("loop").symlink_to("loop")
    status, out, errors = crowdbench(*command, "loop")
    assert (status, out) == (1, "")
    assert errors
    assert "crowdbench itself" not in errors[-1]


@pytest.mark.parametrize(
    "content", [b"'''\xe9'''\n", "x = 1".encode("utf-16"), b"x = 1\0"], ids=["latin1", "utf16", "nul"]
)
@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("x.toml", ["run", "--planner", "orca", "--scenario", "x.toml"]),
        ("x.py", ["run", "--planner", "x.py"]),
        ("x.py", ["run", "--planner", "orca", "--metric", "x.py"]),
    ],
)
def test_files_that_are_no_text_are_named(crowdbench, name, command, content):
    Path(name).write_bytes(content)
    status, out, errors = crowdbench(*command)
    assert (status, out, len(errors)) == (1, "", 1)
    assert name in errors[0]


def test_a_planner_of_a_taken_name_is_not_made(crowdbench):
    status, _, errors = crowdbench("new-planner", "orca")
    assert (status, errors) == (1, ["crowdbench: a planner that ships is called 'orca': take another name"])
    assert crowdbench("new-planner", "swift_heron")[0] == 0


@pytest.mark.parametrize("text", ["[" * 100_000, f'{{"x": {DIGITS}}}'])
def test_a_result_that_no_run_writes_is_told(tmp_path, text):
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(InputError, match="not valid JSON"):
        read_result(tmp_path)


@pytest.mark.parametrize(
    ("error", "status", "expected"),
    [
        (InputError("bad\nthing"), 1, "bad thing"),
        (InputError("x" * 5000), 1, "x ... x"),
        (MemoryError(), 1, "not enough memory"),
        (OSError(24, "Too many open files", "/a/b"), 1, "/a/b cannot be written or read: Too many open files"),
        (Interrupted(), 130, "interrupted: nothing was kept"),
        (ZeroDivisionError("by zero"), 3, "an error in crowdbench itself, ZeroDivisionError: by zero"),
    ],
)
def test_whatever_a_command_raises_ends_in_one_sentence(crowdbench, monkeypatch, error, status, expected):
    def broken(*arguments, **settings):
        raise error

    monkeypatch.setattr(cli, "build_app", lambda names: broken)
    found, out, errors = crowdbench("list")
    assert (found, out, len(errors)) == (status, "", 1)
    assert expected in errors[0]
    assert len(errors[0]) < 1200


@pytest.mark.slow
def test_a_run_without_standard_streams_keeps_its_result(tmp_path):
    command = f"{sys.executable} -m crowdbench run --planner orca --cases 2 --record none --out kept <&- >&- 2>&-"
    assert subprocess.run(["sh", "-c", command], timeout=120).returncode == 0
    assert read_result(tmp_path / "kept")["run"]["cases"] == "test:0:2"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_output_is_told_once():
    command = [sys.executable, "-m", "crowdbench", "list", "metrics"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr == "crowdbench: the output cannot be written or read: No space left on device\n"


def test_what_a_killed_process_left_is_cleared_by_the_next_one_in_the_folder(tmp_path):
    for name in ("a", "b"):
        (tmp_path / f".{name}.partial-0123abcd" / "inside").mkdir(parents=True)
        (tmp_path / f".{name}.lock-0123abcd").touch()
    (tmp_path / ".c.lock-0123abcd").touch()
    (tmp_path / ".mine.lock").touch()
    with new_directory(tmp_path / "e", False) as living:
        (living / "result.json").write_text("{}")
        with new_directory(tmp_path / "a", False) as partial:
            (partial / "result.json").write_text("{}")
    assert {path.name for path in tmp_path.iterdir()} == {"a", "e", ".mine.lock"}


POLICY = """
import numpy as np
from crowdbench import PedestrianPolicy

class Mine(PedestrianPolicy):
    parameters = PARAMETERS

    def velocities(self, world, parameters):
        return np.zeros_like(world.velocity[:, 1:])

def policy():
    return Mine()
"""


@pytest.mark.parametrize("parameters", ["None", "{'a': float('nan')}"])
@pytest.mark.parametrize(
    "command", [["list", "pedestrians", "p.py"], ["run", "--planner", "orca", "--pedestrians", "p.py"]]
)
def test_parameters_of_a_policy_are_numbers_by_name(crowdbench, command, parameters):
    Path("p.py").write_text(POLICY.replace("PARAMETERS", parameters))
    status, out, errors = crowdbench(*command)
    assert (status, out, len(errors)) == (1, "", 1)
    assert "parameter" in errors[0]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_forked_workers_end_by_signals_and_quietly():
    code = (
        "import os, signal, time\n"
        "from crowdbench.utils import interrupts\n"
        "interrupts.handle()\n"
        "with interrupts.Interrupts():\n"
        "    worker = os.fork()\n"
        "    if worker == 0: time.sleep(30); os._exit(0)\n"
        "    os.kill(worker, signal.SIGTERM)\n"
        "    print(os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("-15\n", "")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize(
    ("ends", "status", "told"), [("pass", 1, "has forked"), ("raise ValueError", 1, "has forked"), ("exit(3)", 3, "")]
)
def test_a_forked_process_does_not_go_on_with_the_run(ends, status, told):
    code = (
        "import os\n"
        "from crowdbench.utils.fork_guard import ForkGuard\n"
        "with ForkGuard('planner p'):\n"
        "    child = os.fork()\n"
        f"    if child == 0: {ends}\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == f"{status}\n"
    assert told in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs names of files that are any bytes")
def test_a_folder_whose_name_is_not_utf_8_works_or_is_named(crowdbench, tmp_path, monkeypatch):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9"))
    folder.mkdir()
    monkeypatch.chdir(folder)
    Path("mine.py").write_text("from crowdbench.planners.reactive import ORCAPlanner as planner\n")
    arguments = ["run", "--cases", "2", "--planner", "./mine.py"]
    assert not crowdbench(*arguments, "--record", "none", "--out", "a")[0]
    status, _, sentences = crowdbench(*arguments, "--out", "b")
    assert status == 1
    assert "run.rrd could not be written: its path is not UTF-8" in sentences[-1]
    assert Path("b", "commands.parquet").exists()  # without the recording
    error = UnicodeEncodeError("utf-8", str(folder), 1, 2, "surrogates not allowed")
    assert "caf\\udce9' is not UTF-8, as this command needs it" in console.failure(error)[0]
