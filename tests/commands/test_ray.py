"""Runs whose batches the workers of a Ray cluster make. The cluster is this machine."""

import hashlib
import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from study_folders import CROWDS

from crowdbench.cli import app
from crowdbench.runs import on_ray as cluster
from crowdbench.runs.load import load_run
from crowdbench.runs.result_file import read_result
from crowdbench.runs.shards import Parts, Shard, make_run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

SAME = ("episodes.csv", "commands.parquet")


def test_without_ray_or_a_cluster_one_sentence_says_what_is_missing(tmp_path, monkeypatch):
    def init(address, **settings):
        raise ConnectionError("nobody answers")

    command = ["run", "--planner", "orca", "--cases", "2", "--on", "ray", "--out", str(tmp_path / "a")]
    for found, sentence in [
        (None, r"--on ray needs Ray: pip install 'crowdbench\[ray\]'"),
        (
            SimpleNamespace(init=init, is_initialized=bool),
            "no Ray cluster can be reached or started: .* nobody answers, in line .*",
        ),
    ]:
        monkeypatch.setitem(sys.modules, "ray", found)
        with pytest.raises(InputError, match=f"^{sentence}$"):
            app(command, standalone_mode=False)
    assert list(tmp_path.iterdir()) == []


def test_there_is_nothing_but_ray():
    with pytest.raises(InputError, match=r"^--on slurm is not known: write --on ray, or leave it out$"):
        app(["study", "tiny.toml", "--on", "slurm"], standalone_mode=False)


@pytest.fixture(scope="module")
def ray():
    """Ray with two workers, which serves all tests of this file."""
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'crowdbench[ray]'")
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    yield ray
    ray.shutdown()


def go(out, **settings):
    command = ["run", "--planner", "orca", "--cases", "12", "--record", "commands", "--out", str(out)]
    for name, value in settings.items():
        command += [f"--{name}", *([] if value is True else [str(value)])]
    app(command, standalone_mode=False)
    return digests(out)


def digests(directory):
    return [hashlib.md5((directory / name).read_bytes()).hexdigest() for name in SAME]


@pytest.mark.usefixtures("ray")
def test_a_run_on_ray_is_that_on_this_machine(tmp_path):
    whole = go(tmp_path / "whole")
    assert go(tmp_path / "a", on="ray", batch=5) == whole
    assert go(tmp_path / "b", on="ray", isolated=True) == whole
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "whole"]
    results = [json.loads((tmp_path / name / "result.json").read_text()) for name in ("whole", "b")]
    assert [result["run"]["planner"] for result in results] == [results[0]["run"]["planner"]] * 2
    assert results[1]["stated"]["isolation"]["peak_memory_mb"] > 0


@pytest.mark.usefixtures("ray")
def test_a_worker_that_is_killed_loses_nothing(tmp_path):
    (tmp_path / "dies.py").write_text(
        "import os, signal\nfrom pathlib import Path\nfrom crowdbench.planners.reactive import ORCAPlanner\n"
        f"MARK = Path({str(tmp_path / 'died')!r})\n"
        "class Dies(ORCAPlanner):\n    def plan(self, obs):\n        if not MARK.exists():\n"
        "            MARK.touch()\n            os.kill(os.getpid(), signal.SIGKILL)\n        return super().plan(obs)\n"
        "def planner():\n    return Dies()\n"
    )
    died = go(tmp_path / "a", on="ray", batch=4, planner=tmp_path / "dies.py")
    assert (tmp_path / "died").exists()
    assert died == go(tmp_path / "whole", planner=tmp_path / "dies.py")


@pytest.mark.usefixtures("ray")
def test_a_shard_on_ray_makes_its_batches_only(tmp_path):
    spec = RunSpec("orca", "circle_crossing_5", Cases.parse("12"), record="commands", batch=4)
    run = load_run(spec)
    parts = Parts.of(run, tmp_path / "a")
    cases = []
    cluster.make_parts([Parts.of(run, tmp_path / "a", Shard(2, 3))], progress=cases.append)
    assert cases == [4]
    assert [part for part in parts.cases if parts.is_finished(part)] == [Cases("test", 4, 8)]
    make_run(run, tmp_path / "a")
    assert read_result(tmp_path / "a")["run"]["cases"] == "test:0:12"


@pytest.mark.usefixtures("ray")
def test_what_is_wrong_on_a_worker_is_told_in_one_sentence(tmp_path, monkeypatch):
    (tmp_path / "broken.py").write_text(
        "import numpy as np\nfrom crowdbench import Planner\n"
        "class Broken(Planner):\n    def plan(self, obs):\n        return np.zeros(obs.row[obs.row > 3].sum() + 1)\n"
        "def planner():\n    return Broken()\n"
    )
    with pytest.raises(InputError, match=r"^planner broken "):
        go(tmp_path / "a", on="ray", planner=tmp_path / "broken.py")
    with pytest.raises(InputError, match=r"^--threads 99 is more than any machine of the Ray cluster has$"):
        go(tmp_path / "a", on="ray", threads=99)
    monkeypatch.setattr("crowdbench.runs.run.code", lambda: "other code")
    with pytest.raises(InputError, match=r"^the Ray worker on .* has another code of crowdbench than"):
        go(tmp_path / "a", on="ray")
    assert [path.name for path in tmp_path.iterdir()] == ["broken.py"]


@pytest.mark.usefixtures("ray", "study_folder")
def test_a_study_on_ray_prints_what_it_prints_here(capsys):
    Path("tiny.toml").write_text(CROWDS)
    app(["study", "tiny.toml", "--on", "ray", "--out", "a"], standalone_mode=False)
    printed = capsys.readouterr().out
    app(["study", "tiny.toml", "--out", "b"], standalone_mode=False)
    assert capsys.readouterr().out == printed
    assert sorted(os.listdir("a")) == sorted(os.listdir("b"))
