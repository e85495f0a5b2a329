"""The command line from its arguments to its exit status; in a process of its own where that makes a difference."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from crowdbench import InputError
from crowdbench.cli.app import COMMANDS, app, build_app
from crowdbench.cli.listing import LISTED

SLOW_PLANNER = """
import time
import numpy as np
from crowdbench import Planner

class Slow(Planner):
    batches = 0

    def reset(self, rows):
        self.batches += 1

    def plan(self, obs):
        if self.batches >= 2:
            open("reached", "w").close()
            time.sleep(1000)
        return np.zeros((len(obs), 2))

def planner():
    return Slow()
"""


def wait_for(path):
    """Until a slow planner has come to its second batch."""
    deadline = time.monotonic() + 100
    while not path.exists():
        assert time.monotonic() < deadline, f"{path} never came"
        time.sleep(0.05)


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_run_leaves_a_table_a_result_its_episodes_and_a_recording(call, tmp_path):
    done = call("run", "--planner", "orca", "--cases", "12", "--record", "all")
    assert done.returncode == 0, done.stderr
    assert "success  " in done.stdout
    run = tmp_path / "runs" / "orca-circle_crossing_5-12"
    files = {"result.json", "episodes.csv", "commands.parquet", "run.rrd"}
    assert {path.name for path in run.iterdir()} == files
    again = call("run", "--planner", "orca", "--cases", "12")
    assert again.returncode == 1
    assert again.stderr.startswith("crowdbench: ")
    assert "--overwrite" in again.stderr
    scored = json.loads(call("score", str(run), "--json").stdout)
    assert scored["comparison"]["agrees"]
    assert [episode["case"] for episode in scored["episodes"]] == list(range(12))
    result = json.loads((run / "result.json").read_text())
    for name, estimate in scored["metrics"].items():
        assert estimate == pytest.approx(result["metrics"][name], abs=1e-9, nan_ok=True), name


@pytest.mark.nightly
def test_json_is_all_that_json_prints(call):
    done = call("run", "--planner", "orca", "--cases", "3", "--json", "--set", "collision=crowdnav")
    result = json.loads(done.stdout)
    assert result["stated"]["overrides"] == {"collision": "crowdnav"}
    assert result["scenario"]["collision"] == "crowdnav"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["run", "--planner", "orka"], "no planner is called 'orka' (did you mean orca"),
        (["run", "--planner", "orca", "--scenario", "cornr"], "no scenario is called 'cornr' (did you mean "),
        (["run", "--planner", "orca", "--cases", "many"], "write 500"),
        (["run", "--planner", "orca", "--set", "vehicle.visable=true"], "vehicle.visable (did you mean visible?); the"),
        (["run", "--planner", "orca", "--record", "some"], "failures, all, commands, none"),
        (["run", "--planner", "orca", "--nonsense"], "--nonsense"),
        (["run", "--planner", sys.executable], "a planner that is a program needs --isolated"),
        (["plot", "sucess", "a"], "Invalid value for 'kind': 'sucess' is not one of 'success'"),
        (["list", "cars"], "nothing is listed as 'cars'"),
        (["compare", "a", "b"], "not the directory of a run"),
        (["run", "--planner", "orca", "--decision-limit", "-1"], "decision limit of -1 s"),
        (["run", "--planner", "orca", "--data", "."], "--data does not go with circle_crossing_5"),
        (["run-board", "five"], "No such command 'run-board'"),
    ],
)
def test_bad_input_gets_one_sentence_and_a_non_zero_exit(call, tmp_path, arguments, expected):
    said = call(*arguments)
    assert said.returncode != 0
    assert said.stdout == ""
    assert said.stderr.startswith("crowdbench: ")
    assert said.stderr.count("\n") == 1
    assert expected in said.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_replay_refuses_tracks_that_its_scenario_does_not_need(call, tmp_path):
    call("run", "--planner", "straight", "--cases", "1", "--out", str(tmp_path / "run"))
    done = CliRunner().invoke(app, ["score", str(tmp_path / "run"), "--data", "."])
    assert "--data does not go with circle_crossing_5" in str(done.exception)


@pytest.mark.slow
def test_a_planner_of_single_steps_does_not_run_ahead(call, tmp_path):
    done = call("run", "--planner", "orca", "--cases", "2", "--replan-every", "8")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        "crowdbench: planner orca has no plan_ahead: it runs with replan_every = 1 only"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_debug_shows_the_traceback():
    command = [sys.executable, "-m", "crowdbench", "run", "--planner", "orka", "--debug"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    assert "Traceback" in done.stderr


@pytest.mark.parametrize("kind", ["planners", "pedestrians", "scenarios", "metrics"])
def test_everything_is_listed(kind):
    done = CliRunner().invoke(app, ["list", kind])
    assert done.exit_code == 0
    assert len(done.stdout.splitlines()) >= 4


@pytest.mark.slow
def test_check_tells_by_its_exit_status(call, tmp_path):
    good = call("check", "orca", "--cases", "val:3")
    assert good.returncode == 0, good.stderr
    (tmp_path / "mine.py").write_text(SLOW_PLANNER)
    bad = call("check", "./mine.py", "--cases", "val:10:12", "--decision-limit", "0.2")
    assert bad.returncode == 1
    assert "took longer" in " ".join(bad.stdout.split())


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_keeps_its_finished_batches(call, tmp_path, number):
    (tmp_path / "slow.py").write_text(SLOW_PLANNER)
    command = ["run", "--planner", "./slow.py", "--cases", "30", "--batch", "10", "--record", "none", "--out", "kept"]
    # A process started in the background ignores SIGINT unless told otherwise.
    process = subprocess.Popen(
        [sys.executable, "-m", "crowdbench", *command],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    wait_for(tmp_path / "reached")
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "crowdbench: interrupted: 10 of 30 cases are kept in kept.parts-" in errors
    assert not (tmp_path / "kept").exists()
    [folder] = tmp_path.glob("kept.parts-*")
    merged = call("merge", *map(str, folder.glob("*")), "--out", "some")
    assert merged.returncode == 0, merged.stderr
    assert json.loads((tmp_path / "some" / "result.json").read_text())["run"]["cases"] == "test:0:10"


@pytest.mark.slow
def test_a_killed_run_leaves_nothing_under_its_name(call, tmp_path):
    (tmp_path / "slow.py").write_text(SLOW_PLANNER)
    process = subprocess.Popen(
        [sys.executable, "-m", "crowdbench", "run", "--planner", "./slow.py", "--cases", "20", "--batch", "10"]
    )
    wait_for(tmp_path / "reached")
    process.kill()
    process.wait()
    (partial,) = (tmp_path / "runs").glob("*.parts-*/.*.partial-*")
    name = partial.parent.name.partition(".parts-")[0]
    assert not (tmp_path / "runs" / name).exists()
    done = call("run", "--planner", "orca", "--cases", "20", "--batch", "10", "--out", f"runs/{name}")
    assert done.returncode == 0, done.stderr
    shown = sorted(path.name for path in (tmp_path / "runs").glob("[!.]*"))
    assert shown == [name, partial.parent.name]  # a part is kept, and its lock, for the same command to go on


def test_the_command_line_starts_without_what_it_does_not_need():
    code = "import sys, crowdbench.cli; print(sorted({'torch', 'rerun', 'numba'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"
    code = (
        "import sys; sys.argv = ['crowdbench', 'run', '--planner', 'orca', '--cases', '1', '--record', 'none']\n"
        "from crowdbench.cli.app import main\n"
        "try: main()\n"
        "except SystemExit as stop: assert not stop.code\n"
        "print('left out:', not {'torch', 'rerun'} & set(sys.modules))"
    )
    assert "left out: True" in subprocess.check_output([sys.executable, "-c", code], text=True)


@pytest.mark.slow
def test_a_full_disk_is_told_and_leaves_nothing(call, tmp_path):
    if os.geteuid() != 0:
        pytest.skip("needs root to mount a small disk")
    (tmp_path / "disk").mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", "disk"], capture_output=True).returncode:
        pytest.skip("cannot mount a small disk here")
    try:
        for record in ("none", "all"):
            done = call("run", "--planner", "orca", "--cases", "400", "--record", record, "--out", "disk/run")
            assert done.returncode == 1
            *before, last = done.stderr.splitlines()
            assert "No space left on device" in last or "disk full" in last
            assert not [line for line in before if not line.startswith("compiling") and " of 400 cases" not in line]
            assert list((tmp_path / "disk").iterdir()) == []
    finally:
        subprocess.run(["umount", "disk"], check=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["mlp"], "no network is called 'mlp'; there are cadrl, lstm_rl, ppo, ppo_attention, ppo_lidar, sarl"),
        (["cadrl", "--episodes", "9", "--minutes", "1"], "--minutes and --episodes both set the length of a training"),
        (["cadrl", "--device", "abacus"], "nothing can be trained on the device 'abacus'"),
        (["cadrl", "--set", "pedestrians.number=-1"], "pedestrians.number is -1, but must be"),
    ],
)
def test_a_training_that_cannot_start_says_why_in_one_sentence(arguments, message, tmp_path):
    # In this process, because importing torch takes longer than all of these together.
    with pytest.raises(InputError, match=re.escape(message)):
        CliRunner().invoke(app, ["train", *arguments], catch_exceptions=False)
    assert not list(tmp_path.iterdir())


def test_weights_that_do_not_exist_are_refused_in_one_sentence(tmp_path):
    (tmp_path / "mine.safetensors").write_bytes(b"nothing")
    for weights, message in (("mine", "no file of weights is called 'mine'"), ("mine.safetensors", "need their card")):
        arguments = ["run", "--planner", "sarl_cvm", "--option", f"weights={weights}", "--cases", "1"]
        with pytest.raises(InputError, match=message):
            CliRunner().invoke(app, arguments, catch_exceptions=False)


def test_commands_import_neither_numba_nor_torch_before_they_set_the_number_of_threads():
    code = (
        "import importlib, pkgutil, sys, crowdbench.cli\n"
        "for module in pkgutil.iter_modules(crowdbench.cli.__path__, 'crowdbench.cli.'):\n"
        "    importlib.import_module(module.name)\n"
        "print([name for name in ('numba', 'torch', 'scipy') if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


@pytest.mark.slow
def test_one_thread_is_one_thread_for_simulator_and_networks():
    code = (
        "import crowdbench.cli.options as options; options.use_threads(1); import numba, torch\n"
        "from crowdbench import load_planner, rollout\n"
        "rollout(load_planner('cadrl'), 'circle_crossing_5', 20)\n"
        "print(numba.get_num_threads(), torch.get_num_threads())"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "1 1\n"


@pytest.mark.parametrize("command", sorted({*COMMANDS} - {"list"}))
def test_a_command_alone_shows_an_example_that_needs_nothing_else(call, command):
    done = call(command)
    assert done.returncode == 2
    assert done.stderr.startswith("crowdbench: Missing ")
    example = done.stderr.strip().rpartition(f": crowdbench {command} ")[2].split()
    found = get_command(build_app(command)).commands[command]
    assert found.make_context(command, example).params


def test_list_alone_shows_its_kinds(call):
    done = call("list")
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.split()[0] for line in done.stdout.splitlines()[2:]] == [*LISTED]
    assert "did you mean planners" in call("list", "planner").stderr
