"""Runs that workers make: processes of this machine, two Ray nodes, or two Dask workers give the same bytes as one."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from crowdbench.utils.errors import MachineFault
from crowdbench.utils.executors import open_executor

DIES_ONCE = """
import os, signal
from pathlib import Path
from crowdbench.planners.reactive import ORCAPlanner

class DiesOnce(ORCAPlanner):
    def plan(self, obs):
        if (obs.step == 5).all() and not (here := Path(__file__).with_name("died")).exists():
            here.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().plan(obs)

def planner():
    return DiesOnce()
"""


def digests(directory):
    return [hashlib.md5((directory / name).read_bytes()).hexdigest() for name in ("episodes.csv", "commands.parquet")]


def run_command(folder, out, *options, command=("run", "--planner", "./dies.py", "--cases", "val:24"), **variables):
    """Run a command in a folder, and return its directory."""
    done = subprocess.run(
        [sys.executable, "-m", "crowdbench", *command, "--record", "commands", "--out", out, *options],
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    return folder / out


@pytest.fixture
def folder(tmp_path):
    """A folder with a planner whose worker is killed once, and the run of one process."""
    (tmp_path / "dies.py").write_text(DIES_ONCE)
    (tmp_path / "died").touch()
    run_command(tmp_path, "whole")
    (tmp_path / "died").unlink()
    return tmp_path


@pytest.mark.nightly
def test_processes_of_this_machine_make_the_whole_also_if_one_is_killed(folder):
    made = run_command(folder, "a", "--workers", "2", "--batch", "6")
    assert (folder / "died").exists()
    assert digests(made) == digests(folder / "whole")
    assert sorted(path.name for path in folder.glob("*a*")) == ["a"]
    again = run_command(folder, "a", "--workers", "2", "--batch", "6")
    assert digests(again) == digests(folder / "whole")


@pytest.mark.nightly
def test_two_ray_nodes_make_the_whole_also_if_a_worker_is_killed(folder, monkeypatch):
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    node = {"num_cpus": 1, "include_dashboard": False, "object_store_memory": 80_000_000}
    cluster = Cluster(initialize_head=True, head_node_args=node)
    try:
        cluster.add_node(num_cpus=1, object_store_memory=80_000_000)
        made = run_command(folder, "a", "--engine", "ray", "--batch", "6", RAY_ADDRESS=cluster.address)
    finally:
        cluster.shutdown()
    assert (folder / "died").exists()
    assert digests(made) == digests(folder / "whole")


@pytest.mark.nightly
def test_two_dask_workers_make_the_whole_also_if_one_is_killed(folder):
    pytest.importorskip("distributed")
    script = (
        "import sys\nfrom distributed import LocalCluster\n"
        "if __name__ == '__main__':\n"
        "    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:\n"
        "        print(cluster.scheduler_address, flush=True)\n        sys.stdin.read()\n"
    )
    (folder / "cluster.py").write_text(script)
    command = [sys.executable, "cluster.py"]
    with subprocess.Popen(command, cwd=folder, stdin=-1, stdout=-1, stderr=-3, text=True) as cluster:
        address = cluster.stdout.readline().strip()
        made = run_command(folder, "a", "--engine", "dask", "--batch", "6", DASK_SCHEDULER_ADDRESS=address)
        cluster.stdin.close()
    assert (folder / "died").exists()
    assert digests(made) == digests(folder / "whole")


@pytest.mark.nightly
def test_a_suite_and_a_search_are_shared_out(tmp_path):
    for out, options in (("one", ()), ("two", ("--workers", "2"))):
        command = [sys.executable, "-m", "crowdbench", "suite", "straight", "--cases", "2", "--out", out, *options]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stderr
    one, two = ({path.parent.name: path.read_bytes() for path in tmp_path.glob(f"{n}/*/*.csv")} for n in ("one", "two"))
    assert one == two
    assert len(one) > 10


def die():
    os.kill(os.getpid(), 9)


@pytest.mark.slow
def test_a_task_that_always_kills_its_worker_is_named_as_such():
    with open_executor(None, 1, None) as executor, pytest.raises(MachineFault, match="4 workers were killed with the"):
        executor.submit(die).result(timeout=120)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--engine", "slurm"), "no engine is called 'slurm'; there are ray and dask"),
        (("--workers", "0"), "Invalid value for '--workers': Input should be greater than or equal to 1"),
    ],
)
def test_wrong_options_get_one_sentence(call, options, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = call("run", "--planner", "orca", "--cases", "2", *options)
    assert done.returncode != 0
    assert done.stderr.startswith(f"crowdbench: {sentence}")
    assert list(Path().iterdir()) == []


@pytest.mark.nightly
def test_an_error_of_the_planner_on_a_worker_is_the_error_of_the_run(tmp_path):
    (tmp_path / "bad.py").write_text(DIES_ONCE.replace("os.kill(os.getpid(), signal.SIGKILL)", "raise KeyError(7)"))
    command = ["run", "--planner", "./bad.py", "--cases", "val:8", "--workers", "2", "--batch", "2", "--out", "a"]
    done = subprocess.run(
        [sys.executable, "-m", "crowdbench", *command], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 1
    assert "crowdbench: planner bad raised KeyError" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
