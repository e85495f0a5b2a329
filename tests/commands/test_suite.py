"""`crowdbench suite`: one table of all scenarios of the suite, resumable, with means over families of scenarios."""

import json
from pathlib import Path

import numpy as np
import pytest

from crowdbench.catalog import load_scenario, suite_families
from crowdbench.metrics import Estimate, mean_over_scenarios, scenario_weights
from crowdbench.runs import folder

FAMILIES = {"circles": ["circle_crossing_5", "circle_crossing_5_visible"], "doorway": ["doorway_10"]}

STOPS_AT_DOORS = """
import crowdbench

class Stops(crowdbench.Planner):
    def plan(self, obs):
        if obs.obstacles is not None and len(obs.obstacles.shape) and obs.obstacles.shape[1]:
            raise ValueError("a wall")
        way = obs.vehicle.goal - obs.vehicle.position
        return 0.5 * way / (way**2).sum(axis=1, keepdims=True) ** 0.5

def planner():
    return Stops()
"""


@pytest.fixture(autouse=True)
def _three_scenarios(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("crowdbench.catalog.suite_families", lambda: FAMILIES)


def test_there_is_a_row_for_each_scenario_and_one_for_the_mean(call):
    done = call("suite", "orca", "--cases", "4")
    assert done.returncode == 0, done.stderr
    rows = [line.split()[0] for line in done.stdout.splitlines()[2:6]]
    assert rows == ["circle_crossing_5", "circle_crossing_5_visible", "doorway_10", "mean"]
    metrics = json.loads(call("suite", "orca", "--cases", "4", "--json").stdout)["metrics"]
    for metric in ("success_rate", "sct"):
        circle, visible, door, mean = (metrics[row][metric]["mean"] for row in rows)
        assert mean == pytest.approx((circle + visible) / 4 + door / 2)
        assert metrics["mean"][metric]["low"] <= mean <= metrics["mean"][metric]["high"]


def test_an_interrupted_command_goes_on_with_finished_scenarios(call, monkeypatch):
    made = []

    def interrupted(run, out, report):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(run.scenario.name)
        return make(run, out, report)

    make = folder.make_in_folder
    monkeypatch.setattr(folder, "make_in_folder", interrupted)
    done = call("suite", "straight", "--cases", "2")
    assert done.returncode == 130
    assert "finished batches are kept in runs/suite, with which the same command goes on" in done.stderr
    monkeypatch.setattr(folder, "make_in_folder", make)
    times = {path: path.stat().st_mtime_ns for path in Path("runs/suite").glob("*/result.json")}
    assert len(times) == 2
    assert call("suite", "straight", "--cases", "2").returncode == 0
    assert {path: path.stat().st_mtime_ns for path in times} == times
    assert len(list(Path("runs/suite").glob("*/result.json"))) == 3


def test_a_scenario_that_cannot_be_driven_counts_0(call, monkeypatch):
    monkeypatch.setattr("crowdbench.utils.progress_bars.SLOW", 0.0)
    Path("stops.py").write_text(STOPS_AT_DOORS)
    done = call("suite", "stops.py", "--cases", "2", "--json")
    assert done.returncode == 0, done.stderr
    assert "doorway_10 counts 0, because it cannot be driven" in done.stderr
    assert "100 % of the suite" in done.stderr
    metrics = json.loads(done.stdout)["metrics"]
    assert metrics["doorway_10"]["success_rate"]["mean"] == 0.0
    assert metrics["mean"]["success_rate"]["mean"] > 0.0
    refused = call("suite", "nobody")
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "no planner is called 'nobody'" in refused.stderr


def test_the_interval_of_a_mean_is_that_of_zou_and_donner():
    weights = scenario_weights(FAMILIES)
    assert weights.tolist() == [0.25, 0.25, 0.5]
    estimates = [Estimate(0.5, 0.3, 0.8, 10, 1.0), Estimate(0.7, 0.6, 0.9, 10, 1.0), None]
    mean = mean_over_scenarios(weights, estimates)
    assert mean.mean == pytest.approx(0.3)
    assert mean.low == pytest.approx(0.3 - np.hypot(0.25 * 0.2, 0.25 * 0.1))
    assert mean.high == pytest.approx(0.3 + np.hypot(0.25 * 0.3, 0.25 * 0.2))


def test_the_suite_lists_scenarios_that_exist_once(monkeypatch):
    names = [name for scenarios in suite_families().values() for name in scenarios]
    assert len(names) == len(set(names)) == 22
    assert [load_scenario(name).name for name in names] == names
