"""`crowdbench run --board`: all scenarios of a board with one planner."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.boards.board import find_board
from crowdbench.cli.app import app

SMALL_CROWDS_ONLY = """
import numpy as np
from crowdbench import Planner

class Small(Planner):
    def reset(self, rows):
        pass

    def plan(self, obs):
        assert obs.pedestrians.position.shape[1] <= 5, "too many"
        return np.zeros((len(obs), 2))

def planner():
    return Small()
"""


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def run(*arguments):
    done = CliRunner().invoke(app, ["run", "--board", "suite", *arguments, "--json"])
    assert done.exit_code == 0, done.output
    return done


@pytest.mark.slow
def test_a_run_of_a_board_has_its_scenarios_and_their_mean(tmp_path):
    first = run("--planner", "straight", "--cases", "val:2")
    found = json.loads(first.stdout)["metrics"]
    board = found.pop("board suite")
    families = find_board("suite").spec.families
    assert list(found) == [name for names in families.values() for name in names]
    means = [np.mean([found[name]["success_rate"]["mean"] for name in names]) for names in families.values()]
    assert board["success_rate"]["mean"] == pytest.approx(np.mean(means))
    assert 0.0 < board["success_rate"]["mean"] < 1.0
    results = sorted(tmp_path.glob("runs/board-suite/*/result.json"))
    assert len(results) == len(found)
    written = [result.stat().st_mtime_ns for result in results]
    assert run("--planner", "straight", "--cases", "val:2").stdout == first.stdout
    assert [result.stat().st_mtime_ns for result in results] == written


@pytest.mark.slow
def test_a_scenario_that_a_planner_cannot_drive_counts_nothing(tmp_path):
    (tmp_path / "small.py").write_text(SMALL_CROWDS_ONLY)
    done = run("--planner", "./small.py", "--cases", "val:1")
    found = json.loads(done.stdout)["metrics"]
    assert found["circle_crossing_10"] == {}
    assert found["circle_crossing_5"]["timeout_rate"]["mean"] == 1.0
    assert found["board suite"]["success_rate"]["mean"] == 0.0
    assert "circle_crossing_10 counts 0, because it cannot be driven: " in done.stderr
