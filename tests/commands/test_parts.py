"""Runs that are made part by part: whoever makes the parts, and however often it is stopped, the run is the same."""

import hashlib
import json
import re
import signal
import subprocess
import sys
import threading
import time

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


@pytest.mark.slow
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
