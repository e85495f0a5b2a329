"""Results that a late fault must not cost: a metric that fails, a recording that does not fit."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from crowdbench.results.result_file import read_result

LATE = '''
def late(trace):
    """The first gap [m]."""
    return trace.gap[:, 0] if 7 not in trace.case else trace.nothing
'''


@pytest.fixture
def run(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("late.py").write_text(LATE)

    def run(out, *options):
        command = ("run", "--planner", "straight", "--cases", "val:12", "--batch", "4", "--record", "commands")
        return call(*command, "--out", out, *options)

    return run


def test_a_metric_that_fails_at_once_is_named_before_the_run(run, tmp_path):
    Path("late.py").write_text(LATE.replace("7", "0"))
    done = run("a", "--metric", "./late.py:late")
    assert done.returncode == 1
    assert done.stderr.startswith("crowdbench: metric late raised AttributeError: 'Trace' object has no attribute")
    assert [path.name for path in tmp_path.iterdir()] == ["late.py"]


def test_a_metric_that_fails_late_is_computed_afterwards(run, call):
    done = run("a", "--metric", "./late.py:late")
    assert done.returncode == 1
    assert "metric late raised AttributeError" in done.stderr.splitlines()[-1]
    assert "crowdbench score a --metric ./late.py:late --out a-scored" in done.stderr.splitlines()[-1]
    assert "late" not in read_result(Path("a"))["metrics"]
    again = run("a", "--metric", "./late.py:late")
    assert "it is this run without metric late" in again.stderr

    Path("late.py").write_text(LATE.replace("7", "-1"))
    scored = call("score", "a", "--metric", "./late.py:late", "--out", "a-scored")
    assert scored.returncode == 0, scored.stderr
    assert call("score", "a", "--metric", "./late.py:late", "--out", "a-scored").returncode == 0
    assert run("b", "--metric", "./late.py:late").returncode == 0
    for name in ("episodes.csv", "commands.parquet"):
        assert Path("a-scored", name).read_bytes() == Path("b", name).read_bytes()
    assert read_result(Path("a-scored"))["id"] == read_result(Path("b"))["id"]
    assert "complete" in run("a-scored", "--metric", "./late.py:late").stderr


def test_a_run_that_differs_from_its_replay_is_not_scored_into_a_directory(run, call):
    run("a")
    shutil.copytree("a", "forged")
    table = Path("forged", "episodes.csv")
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0], lines[1].replace(",", ",", 1), *lines[2:-1]]) + "\n")
    refused = call("score", "forged", "--out", "scored")
    assert refused.returncode == 1
    assert not Path("scored").exists()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="bash counts the limit in kilobytes there")
def test_a_limit_of_the_size_of_files_costs_the_recording_alone(tmp_path):
    command = f"{sys.executable} -m crowdbench run --planner orca --cases val:50 --out"
    subprocess.run(["bash", "-c", f"{command} whole"], cwd=tmp_path, check=True, capture_output=True)
    limited = subprocess.run(["bash", "-c", f"ulimit -f 40; {command} a"], cwd=tmp_path, capture_output=True, text=True)
    assert limited.returncode == 1
    assert "run.rrd could not be written" in limited.stderr.splitlines()[-1]
    assert "the results are kept" in limited.stderr.splitlines()[-1]
    for name in ("episodes.csv", "commands.parquet"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert not (tmp_path / "a" / "run.rrd").exists()
