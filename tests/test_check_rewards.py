"""`crowdbench check` on rewards, scenarios and planners with a filter."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.check import check_reward, check_scenario
from crowdbench.cli import app
from crowdbench.envs.rewards import REWARDS
from crowdbench.scenario.cases import Cases

PLACE = load_scenario("circle_crossing_mixed", {"vehicle.visible": True, "time_limit": 6.0})
CASES = Cases.parse("val:4")


def broken(points):
    return {point.name for point in points if not point.kept}


def examine(reward):
    return check_reward(lambda: reward, "mine", PLACE, CASES)


@pytest.mark.parametrize("name", REWARDS.functions)
def test_rewards_that_ship_keep_their_contract(name):
    assert not broken(examine(REWARDS.find(name)[1]))


def write(step):
    step.gap[:] = 0.0
    return step.progress


def remember(step, calls=[]):  # noqa: B006
    calls.append(step)
    return step.progress + len(calls)


@pytest.mark.parametrize(
    ("reward", "points"),
    [
        (lambda step: 1 / 0, {"exceptions"}),
        (lambda step: step.progress[:-1], {"one number"}),
        (lambda step: np.full(len(step), np.nan), {"one number"}),
        (write, {"step"}),
        (remember, {"deterministic", "batch"}),
        (lambda step: step.progress - step.progress.mean(), {"batch"}),
    ],
)
def test_each_point_has_a_reward_that_breaks_it(reward, points):
    assert points <= broken(examine(reward))


@pytest.mark.slow
def test_a_scenario_is_started_and_driven(tmp_path):
    points = {point.name: point for point in check_scenario(load_scenario("circle_crossing_5"), Cases.parse("val:2"))}
    assert points["episodes"].seen.startswith("driven by ORCA: ")
    assert points["batch"].kept
    text = Path("scenarios/suite/corridor_8.toml").read_text()
    (tmp_path / "full.toml").write_text(text.replace("number = 8", "number = 40"))
    found = CliRunner().invoke(app, ["check", str(tmp_path / "full.toml"), "--cases", "val:2"])
    assert found.exit_code == 1
    assert "finds no room" in found.output


def test_a_scenario_is_checked_as_its_file_says(tmp_path):
    failed = CliRunner().invoke(app, ["check", "./mine.toml", "--scenario", "doorway_8"])
    assert "leave out --option and --scenario" in str(failed.exception)
    missing = CliRunner().invoke(app, ["check", str(tmp_path / "mine.toml")])
    assert "mine.toml" in str(missing.exception)


def test_a_planner_is_checked_with_its_filter():
    found = CliRunner().invoke(app, ["check", "orca", "--option", "filter=kalman", "--cases", "val:2"])
    assert found.exit_code == 0
    assert "broken" not in found.output
