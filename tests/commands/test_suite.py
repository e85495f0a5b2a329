"""`crowdbench suite`: one table of all scenarios of the suite in both tracks of sensing, resumable, with the mean."""

import json
from pathlib import Path

import numpy as np
import pytest

from crowdbench.catalog import Suite, load_scenario, read_suite
from crowdbench.metrics import Estimate, mean_over_scenarios, scenario_weights
from crowdbench.runs import folder

FAMILIES = {"circles": ["circle_crossing_5", "circle_crossing_5_visible"], "door": ["door_10"]}
SUITE = Suite("suite-0", ["circle_crossing_5_visible", "door_10"], ["circle_crossing_5"], [])

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
    monkeypatch.setattr("crowdbench.catalog.read_suite", lambda: SUITE)


@pytest.mark.slow
def test_there_is_a_row_for_each_scenario_and_a_column_for_each_track(call):
    done = call("suite", "orca", "--cases", "6")
    assert done.returncode == 0, done.stderr
    title, header, *lines = done.stdout.splitlines()
    assert title == "Score of orca on suite-0, 6 cases"
    assert header.split() == ["scenario", "perfect", "realistic", "loss"]
    assert [line.split()[0] for line in lines[:4]] == [
        "circle_crossing_5_visible",
        "door_10",
        "mean",
        "circle_crossing_5",
    ]
    assert "circle_crossing_5 (stress)" in lines[3]
    assert "Simulated pedestrians: no claim on robots or comfort." in done.stdout
    found = json.loads(call("suite", "orca", "--cases", "6", "--json").stdout)
    assert (found["version"], found["cases"]) == ("suite-0", 6)
    scores = found["scores"]
    for track in ("perfect", "realistic"):
        circle, door, mean = (scores[row][track] for row in ("circle_crossing_5_visible", "door_10", "mean"))
        assert mean["mean"] == pytest.approx((circle["mean"] + door["mean"]) / 2)
        assert mean["low"] < mean["mean"] < mean["high"]
    assert scores["door_10"]["perfect"] != scores["door_10"]["realistic"]
    loss = scores["door_10"]["perfect"]["mean"] - scores["door_10"]["realistic"]["mean"]
    assert float(lines[1].split()[-1]) == pytest.approx(loss, abs=1e-3)


@pytest.mark.slow
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
    assert len(list(Path("runs/suite").glob("*/result.json"))) == 6


@pytest.mark.slow
def test_a_scenario_that_cannot_be_driven_counts_0(call, monkeypatch):
    monkeypatch.setattr("crowdbench.utils.progress_bars.SLOW", 0.0)
    Path("stops.py").write_text(STOPS_AT_DOORS)
    done = call("suite", "stops.py", "--cases", "2", "--json")
    assert done.returncode == 0, done.stderr
    for track in ("perfect", "realistic"):
        assert f"door_10 ({track}) counts 0, because it cannot be driven" in done.stderr
    assert "100 % of the suite" in done.stderr
    scores = json.loads(done.stdout)["scores"]
    assert scores["door_10"]["perfect"]["mean"] == 0.0
    assert scores["mean"]["perfect"]["mean"] == scores["circle_crossing_5_visible"]["perfect"]["mean"] / 2 > 0.0
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


def test_the_suite_lists_scenarios_that_exist_once():
    found = read_suite()
    names = [*found.ranked, *found.stress, *found.held_out]
    assert len(names) == len(set(names)) == 13
    assert [load_scenario(name).name for name in names] == names


@pytest.mark.parametrize("name", read_suite().ranked)
def test_pedestrians_of_a_ranked_scenario_are_cooperative_and_its_sensing_has_no_errors(name):
    rules = load_scenario(name).rules
    assert rules.visible
    assert rules.attention.ignores == 0.1
    sensor = rules.sensor
    assert (sensor.noise.position, sensor.noise.velocity, sensor.missed, sensor.delay) == (0.0, 0.0, 0.0, 0.0)
    assert sensor.detector is None


def test_stress_scenarios_differ_from_ranked_ones_in_what_people_see():
    for name in read_suite().stress:
        changes = {"vehicle.visible": True, "pedestrians.attention": {"ignores": 0.1}}
        assert load_scenario(name, changes).digest == load_scenario(name.removesuffix("_blind")).digest
