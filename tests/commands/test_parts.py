"""Runs that are made part by part: whoever makes the parts, and however often it is stopped, the run is the same."""

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from helpers import make, run_of

from crowdbench.catalog import load_scenario
from crowdbench.planners.planner import Planner
from crowdbench.record.recorded_cases import read_recorded, recorded_outcomes
from crowdbench.runs import parts as parts_module
from crowdbench.runs.make import make_run
from crowdbench.runs.merge import merge
from crowdbench.runs.parts import Parts
from crowdbench.runs.shards import Shard
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError, Interrupted

SAME = ("episodes.csv", "commands.parquet")


def go(out, cases="12", planner=None, scenario="circle_crossing_5", **settings):
    return make(out, planner or "orca", load_scenario(scenario), cases, **{"record": "commands"} | settings)


def digests(directory):
    return [hashlib.md5((directory / name).read_bytes()).hexdigest() for name in SAME]


@pytest.fixture
def whole(tmp_path):
    go(tmp_path / "whole")
    return tmp_path / "whole"


@pytest.mark.parametrize("batch", [1, 5])
def test_a_run_in_parts_is_that_in_one_go(batch, whole, tmp_path):
    go(tmp_path / "a", batch=batch)
    assert digests(tmp_path / "a") == digests(whole)
    one, parts = (json.loads((path / "result.json").read_text()) for path in (whole, tmp_path / "a"))
    for result in (one, parts):
        del result["stated"]["timing"], result["files"], result["id"], result["run"]["batch"]
    assert one == parts
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "whole"]


def test_shards_make_the_whole_in_any_order(whole, tmp_path):
    for number in (3, 1, 2):
        is_whole = go(tmp_path / "a", batch=4, shard=Shard(number, 3))
        assert is_whole == (number == 2)
        assert (tmp_path / "a").exists() == (number == 2)
    assert digests(tmp_path / "a") == digests(whole)


def make_shard(out, shard, **settings):
    """The folder with the parts of a shard of a run."""
    assert not go(out, batch=4, shard=shard, **settings)
    [folder] = out.parent.glob(f"{out.name}.parts-*")
    return folder


def test_shards_of_several_machines_are_merged(whole, tmp_path):
    folders = [
        make_shard(tmp_path / f"machine{number}" / "a", Shard(number, 2)).rename(tmp_path / str(number))
        for number in (1, 2)
    ]
    parts = [part for folder in folders for part in folder.iterdir()]
    for _ in range(2):  # a repeated command finds the merged run
        merge(parts, tmp_path / "a")
        assert digests(tmp_path / "a") == digests(whole)
    with pytest.raises(InputError, match="must follow each other without a gap and without an overlap"):
        merge([parts[0], parts[0]], tmp_path / "b")


class Stops(Planner):
    """Drives nowhere, and raises when it has started so many batches."""

    def __init__(self, batches):
        self.left = batches

    def reset(self, rows):
        self.left -= 1
        if self.left < 0:
            raise Interrupted

    def plan(self, obs):
        return np.zeros((len(obs), 2))


@pytest.mark.slow
def test_what_was_interrupted_goes_on(tmp_path):
    go(tmp_path / "whole", planner=Stops(99))
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            go(tmp_path / "a", planner=Stops(2), batch=2)
    [folder] = tmp_path.glob("a.parts-*")
    assert {path.name for path in folder.iterdir()} == {f"test-{start}-{start + 2}" for start in range(0, 8, 2)}
    told = []
    go(tmp_path / "a", planner=Stops(2), batch=2, progress=told.append)
    assert sum(told) == pytest.approx(12.0)
    assert digests(tmp_path / "a") == digests(tmp_path / "whole")


@pytest.mark.slow
def test_processes_that_are_given_the_same_command_share_the_work(whole, tmp_path):
    out = tmp_path / "shared"
    command = [sys.executable, "-m", "crowdbench", "run", "--planner", "orca", "--cases", "12", "--batch", "1"]
    command += ["--record", "commands", "--out", str(out)]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    ended = [process.communicate(timeout=120) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ended
    for printed, told in ended:
        assert "success" in printed or "the last process to finish merges the run" in told
    assert digests(out) == digests(whole)
    assert [path.name for path in tmp_path.glob("shared*")] == ["shared"]


def test_parts_that_vanish_while_they_are_read_have_been_merged(tmp_path, monkeypatch):
    run = run_of("orca", load_scenario("circle_crossing_5"), "4", batch=2)
    parts = Parts.of(run, tmp_path / "a")

    def vanish(directory):
        if directory.parent.exists():
            directory.parent.rename(tmp_path / "gone")  # as another process does after it has merged them
        raise InputError("commands.parquet cannot be read")

    with parts.open():
        parts.directory(Cases.parse("2")).mkdir()
        monkeypatch.setattr(parts_module, "is_finished", vanish)
        assert not parts.make(Cases.parse("2"), drive=None)
        assert parts.count_finished() == 4
    parts.directory(Cases.parse("2")).mkdir(parents=True)
    monkeypatch.setattr(parts_module, "is_finished", lambda directory: vanish(tmp_path / "nothing" / "there"))
    with pytest.raises(InputError):  # a damaged part is an error
        parts.count_finished()


def test_a_part_that_another_process_makes_is_left_to_it(tmp_path):
    driven, begun, go_on = [], threading.Event(), threading.Event()

    def slow(part, directory):
        begun.set()
        assert go_on.wait(30.0)
        go(directory, str(part), overwrite=True)
        driven.append(("slow", part.start))

    def quick(part, directory):
        go(directory, str(part), overwrite=True)
        driven.append(("quick", part.start))

    run = run_of("orca", load_scenario("circle_crossing_5"), "4", batch=2)
    ends = []
    other = threading.Thread(target=lambda: ends.append(make_run(run, tmp_path / "a", drive=slow)))
    other.start()
    assert begun.wait(30.0)
    assert not make_run(run, tmp_path / "a", drive=quick)
    go_on.set()
    other.join()
    assert ends == [True]
    assert sorted(driven) == [("quick", 2), ("slow", 0)]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.nightly
def test_a_run_that_is_killed_again_and_again_is_the_whole_in_the_end(whole, tmp_path):
    (tmp_path / "slow.py").write_text(
        "import time\nfrom crowdbench.planners.reactive import ORCAPlanner\n"
        "class Slow(ORCAPlanner):\n    def reset(self, rows):\n        time.sleep(0.05)\n"
        "def planner():\n    return Slow()\n"
    )
    command = [sys.executable, "-m", "crowdbench", "run", "--planner", str(tmp_path / "slow.py"), "--cases", "12"]
    command += ["--batch", "1", "--record", "commands", "--out", str(tmp_path / "killed")]
    before = 0
    for _ in range(3):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 60.0
        while len(made := list(tmp_path.glob("killed.parts-*/test-*/result.json"))) < before + 2:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()
        before = len(made)
    assert not (tmp_path / "killed").exists()
    subprocess.run(command, check=True, capture_output=True)
    assert digests(tmp_path / "killed") == digests(whole)
    assert list(tmp_path.glob("*killed*")) == [tmp_path / "killed"]


@pytest.mark.slow
def test_recordings_are_merged_too(tmp_path):
    go(tmp_path / "one", record="failures")
    go(tmp_path / "a", record="failures", batch=5)
    one, merged = (tmp_path / name / "run.rrd" for name in ("one", "a"))
    assert recorded_outcomes(merged) == recorded_outcomes(one)
    for case in (0, 7):
        found, expected = (read_recorded(path, case).properties for path in (merged, one))
        assert [found[name] for name in ("outcome", "extent", "verdict") if name in expected] == [
            expected[name] for name in ("outcome", "extent", "verdict") if name in expected
        ]


def test_of_very_many_failures_only_the_first_parts_are_recorded(tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.runs.recording.MOST_FAILURES", 6)
    go(tmp_path / "a", record="failures", batch=4, planner=Stops(99))
    assert [*recorded_outcomes(tmp_path / "a" / "run.rrd")] == list(range(8))
    assert json.loads((tmp_path / "a" / "result.json").read_text())["recorded"] == 8


@pytest.mark.parametrize("text", ["", "1", "0/2", "3/2", "1/0", "a/b", "-1/2", "1/2/3"])
def test_a_text_that_is_no_shard_is_refused(text):
    with pytest.raises(InputError, match=rf"^{re.escape(repr(text))} is no shard: write 2/8 for the second of eight$"):
        Shard.parse(text)


def test_runs_that_do_not_fit_together_are_refused(tmp_path):
    runs = {"a": "0:5", "b": "5:9", "gap": "10:12", "over": "8:12"}
    for name, cases in runs.items():
        go(tmp_path / name, cases)
    go(tmp_path / "other", "9:12", scenario="circle_crossing_10")
    go(tmp_path / "silent", "9:12", record="none")
    merge([tmp_path / "b", tmp_path / "a"], tmp_path / "merged")
    assert json.loads((tmp_path / "merged" / "result.json").read_text())["run"]["cases"] == "test:0:9"
    for name, sentence in {
        "gap": r"has cases test:5:9 and .*gap has test:10:12, but the cases of runs that are merged must follow",
        "over": r"has cases test:5:9 and .*over has test:8:12, but",
        "other": r"are not of one run: they differ in scenario$",
        "silent": r"are not of one run: they differ in record$",
    }.items():
        with pytest.raises(InputError, match=sentence):
            merge([tmp_path / "a", tmp_path / "b", tmp_path / name], tmp_path / "c")
    with pytest.raises(InputError, match=r"^there is no run to merge"):
        merge([], tmp_path / "c")
    (tmp_path / "a" / "episodes.csv").write_text("")
    with pytest.raises(InputError, match=r"episodes\.csv is not the file that the run wrote"):
        merge([tmp_path / "a", tmp_path / "b"], tmp_path / "c")
    assert not (tmp_path / "c").exists()


@pytest.mark.slow
def test_the_command_line_merges_what_an_interrupt_has_kept(call, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "a", planner=Stops(2), batch=4)
    [folder] = tmp_path.glob("a.parts-*")
    done = call("merge", *map(str, folder.iterdir()), "--out", str(tmp_path / "b"))
    assert done.returncode == 0, done.stderr
    assert "mine on circle_crossing_5, cases test:0:8" in done.stdout
    refused = call("merge", str(folder), "--out", str(tmp_path / "c"))
    assert refused.returncode == 1
    assert refused.stderr.endswith(f"give those in it: {folder}/*\n")


def test_shards_share_out_the_cases_of_one_batch(whole, tmp_path):
    assert [len(Shard(number, 5).share(Cases.parse("val:12"))) for number in range(1, 6)] == [2, 2, 3, 2, 3]
    for number in range(1, 6):
        assert go(tmp_path / "a", shard=Shard(number, 5)) == (number == 5)
    assert digests(tmp_path / "a") == digests(whole)
    for number in range(1, 6):  # each says that the run is complete
        assert go(tmp_path / "a", shard=Shard(number, 5))


def test_a_shard_says_what_it_did(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def shard(text, cases="val:3"):
        done = call("run", "--planner", "orca", "--cases", cases, "--record", "none", "--out", "a", "--shard", text)
        assert done.returncode == 0, done.stderr
        return done.stderr

    assert "shard 1/5 has no case, because there are 3 in all; 0 of 3 cases are finished" in shard("1/5")
    assert list(tmp_path.glob("a*")) == []
    assert re.search(
        r"the cases val:0:1 of shard 1/2 are finished; 1 of 3 cases are finished in a\.parts-", shard("1/2")
    )
    assert "the cases val:0:1 of shard 1/2 are finished; 1 of 3" in shard("1/2")
    assert "complete" not in shard("2/2")
    assert (tmp_path / "a" / "result.json").exists()
    for text in ("1/2", "2/2", "3/7"):
        assert "crowdbench: a is complete, and nothing is driven again" in shard(text)


def test_other_parts_fill_the_gaps(whole, tmp_path):
    """Parts of another number of shards, which overlap with those of the first, are completed and merged."""
    assert not go(tmp_path / "a", shard=Shard(2, 3))
    assert not go(tmp_path / "a", shard=Shard(1, 2))
    [folder] = tmp_path.glob("a.parts-*")
    assert sorted(path.name for path in folder.iterdir()) == ["test-0-4", "test-4-8"]
    assert go(tmp_path / "a")
    assert digests(tmp_path / "a") == digests(whole)


def test_of_overlapping_parts_some_make_the_run(whole, tmp_path):
    run = run_of("orca", load_scenario("circle_crossing_5"), "12", record="commands")
    parts = Parts.of(run, tmp_path / "a")
    with parts.open():
        for text in ("0:5", "3:9", "5:8", "9:12"):
            run.drive(Cases.parse(text), parts.directory(Cases.parse(text)))
        assert list(map(str, parts.finished())) == ["test:0:5", "test:5:8", "test:9:12"]
        assert list(map(str, parts.missing(Cases.parse("7:12")))) == ["test:8:9"]
    assert make_run(run, tmp_path / "a")
    assert digests(tmp_path / "a") == digests(whole)


def test_the_rest_of_a_merge_that_was_killed_is_removed(tmp_path):
    run = run_of("orca", load_scenario("circle_crossing_5"), "2", record="commands")
    make_run(run, tmp_path / "a")
    parts = Parts.of(run, tmp_path / "a")
    parts.folder.mkdir()
    (tmp_path / f".{parts.folder.name}.merged-0").mkdir()
    assert make_run(run, tmp_path / "a")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def recipe():
    """The command of the SLURM recipe, with another planner and fewer cases."""
    page = (Path(__file__).parents[2] / "docs" / "long_runs.md").read_text()
    [command] = re.findall(r"^#SBATCH --time=.*\n(crowdbench run [^`]*)", page, re.MULTILINE)
    for old, new in (("sarl_sgan_kce", "./slow.py"), ("--cases 10000", "--cases 24"), ("--threads 2 ", "")):
        assert old in command
        command = command.replace(old, new)
    return command.replace("crowdbench run", f"{sys.executable} -m crowdbench run --record commands")


@pytest.mark.nightly
def test_tasks_of_the_slurm_recipe_are_killed_and_submitted_again(tmp_path):
    (tmp_path / "slow.py").write_text(
        "import time\nfrom crowdbench.planners.reactive import ORCAPlanner\n"
        "class Slow(ORCAPlanner):\n    def reset(self, rows):\n        time.sleep(1.0)\n"
        "def planner():\n    return Slow()\n"
    )
    (tmp_path / "whole").mkdir()
    go(tmp_path / "whole" / "run", cases="24")

    def submit(number, count):
        # SLURM counts the tasks of this submission.
        variables = {"SLURM_ARRAY_TASK_ID": str(number), "SLURM_ARRAY_TASK_COUNT": str(count)}
        return subprocess.Popen(
            ["bash", "-c", f"exec {recipe()}"], cwd=tmp_path, env={**os.environ, **variables}, stdout=-3, stderr=-3
        )

    tasks = [submit(number, 8) for number in range(1, 9)]
    while not list(tmp_path.glob("runs/*.parts-*/test-*")):
        time.sleep(0.1)
    killed = [number for number, task in enumerate(tasks, 1) if number % 3 == 0 and task.poll() is None]
    for number in killed:
        tasks[number - 1].kill()
        tasks[number - 1].wait(120)
    assert [task.wait(120) for number, task in enumerate(tasks, 1) if number not in killed] == [0] * (8 - len(killed))
    again = [submit(number, len(killed)) for number in killed]
    assert [task.wait(120) for task in again] == [0] * len(killed)
    assert digests(tmp_path / "runs" / "kce-10000") == digests(tmp_path / "whole" / "run")
    assert submit(5, 1).wait(120) == 0
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["kce-10000"]
