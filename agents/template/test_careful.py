"""The planner keeps its contract and drives. Run with pytest."""

import json
import subprocess
from pathlib import Path

PLANNER = Path(__file__).parent / "careful.py"


def crowdbench(*arguments):
    """Run a command of crowdbench."""
    return subprocess.run(["crowdbench", *map(str, arguments)], capture_output=True, text=True)


def test_it_keeps_its_contract():
    """`crowdbench check` has no objection."""
    done = crowdbench("check", PLANNER)
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_reaches_its_goal_without_pedestrians(tmp_path):
    """Drive cases without pedestrians: all succeed."""
    empty = ("--set", "pedestrians.number=0", "--cases", "val:10", "--out", tmp_path / "run", "--json")
    done = crowdbench("run", "--planner", PLANNER, *empty)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["metrics"]["success_rate"]["mean"] == 1.0
