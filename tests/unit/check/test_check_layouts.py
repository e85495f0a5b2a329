"""`crowdbench check` on layouts, rewards and scenarios: each fault is found, and the kind of a file."""

import dataclasses
import functools
import random
from pathlib import Path

import numpy as np
import pytest
from checks import CASES, PLACE, broken, results_of
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.check.checks import Subject
from crowdbench.check.drives import REWARD, SCENARIO
from crowdbench.cli.app import app
from crowdbench.envs.rewards import REWARDS
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.layouts.floor_plan import floor_plan
from crowdbench.scenario.placement import LayoutCall, Placement


def row_of_people(rng, radius, preferred_speed):
    """Everybody in a row, one metre apart, with a goal somewhere ahead."""
    start = np.stack([np.arange(len(radius)), np.zeros(len(radius))], axis=1).astype(float)
    return Placement(start, start + np.array([0.0, 5.0 + rng.random()]))


def changed_row(**changes):
    """A layout as `row_of_people`, with other parts: functions of the placement."""

    def layout(rng, radius, preferred_speed):
        placement = row_of_people(rng, radius, preferred_speed)
        return dataclasses.replace(placement, **{name: change(placement) for name, change in changes.items()})

    return layout


def box(middle, half):
    """Four walls around a point."""
    corners = middle + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


LATER = np.random.default_rng(0)

LAYOUTS_THAT_OFFEND = {
    "an exception": (lambda rng, radius, speed: radius[99], "answers", "in case val/0, the layout raised IndexError"),
    "a pair": (lambda rng, radius, speed: (radius, radius), "answers", "a tuple instead of a Placement"),
    "too few": (changed_row(goal=lambda one: one.goal[1:]), "answers", "the layout returned goal of shape"),
    "a flat wall": (
        changed_row(obstacles=lambda one: np.zeros((2, 2))),
        "answers",
        "obstacles of shape [2, 2] instead of [any number, any number, 2]",
    ),
    "nowhere": (changed_row(goal=lambda one: one.goal * np.nan), "answers", "the vehicle the goal [nan, nan]"),
    "a heap": (changed_row(start=lambda one: one.start * 0.5), "answers", "agents 0 and 1 overlap by 0.1 m"),
    "nothing to do": (
        changed_row(goal=lambda one: one.start + 0.1),
        "answers",
        "the vehicle starts 0.141 m from its goal",
    ),
    "a pedestrian with nothing to do": (
        changed_row(goal=lambda one: np.vstack([one.goal[:1], one.start[1:]])),
        "answers",
        "in case val/0, pedestrian 1 starts at its goal",
    ),
    "a wall through people": (
        changed_row(obstacles=lambda one: np.array([[[-1.0, 0.2], [9.0, 0.2]]])),
        "answers",
        "the start of the vehicle, [0.0, 0.0], is 0.2 m from obstacles[0]",
    ),
    "a box around a goal": (
        changed_row(obstacles=lambda one: box(one.goal[0], 0.5)),
        "answers",
        "no way leads the vehicle from (0, 0) to its goal",
    ),
    "a route through a wall": (
        changed_row(
            obstacles=lambda one: np.array([[[-3.0, 3.0], [0.5, 3.0]]]),
            route=lambda one: np.full((len(one.start), 1, 2), np.nan),
        ),
        "answers",
        "the route of the vehicle leads 0 m past an obstacle",
    ),
    "NumPy's dice": (
        changed_row(goal=lambda one: one.goal + np.random.rand()),  # noqa: NPY002 (the fault)
        "repeatable",
        "draw random numbers only from the stream of the case",
    ),
    "Python's dice": (changed_row(goal=lambda one: one.goal + random.random()), "repeatable", "first in case 0"),
    "dice of its own": (
        changed_row(goal=lambda one: one.goal + LATER.random()),
        "repeatable",
        "differ when repeated",
    ),
}


def plain(self, start, goal, route=None, obstacles=None):
    for name, value in (("start", start), ("goal", goal), ("route", route), ("obstacles", obstacles)):
        object.__setattr__(self, name, value)


def layout_faults(layout, place=PLACE, cases=CASES):
    starts = dataclasses.replace(place.starts, layout=LayoutCall(layout))
    changed = dataclasses.replace(place, starts=starts)
    faults = broken(results_of(Subject(SCENARIO, lambda: changed, "mine", {"": changed}, neural=False), cases))
    faults.pop("arrivals", None)  # the episodes are too short for anybody to arrive
    return faults


def test_what_groups_make_of_a_layout_is_examined_by_what_a_run_does():
    def alley(rng, radius, preferred_speed):
        """A lane of 1.2 m, in which there is no room for two abreast."""
        place = np.arange(len(radius)) * 2.0
        start, goal = np.stack([place, 0.0 * place], axis=1), np.stack([place + 60.0, 0.0 * place], axis=1)
        sides = [[[-5.0, side], [80.0, side]] for side in (-0.6, 0.6)]
        walls = np.array([*sides, *([[end, -0.6], [end, 0.6]] for end in (-5.0, 80.0))])
        return Placement(start, goal, obstacles=walls)

    def faults(groups):
        place = load_scenario("circle_crossing_5", {"time_limit": 3.5, **groups})
        return layout_faults(alley, place, Cases.parse("val:2"))

    assert not faults({})
    said = faults({"pedestrians.groups": {"2": 1.0}})["answers"]
    assert "the start of pedestrian" in said
    assert "the layout placed its group; members stand side by side around that place" in said


@pytest.mark.parametrize("name", LAYOUTS_THAT_OFFEND)
def test_a_fault_of_a_layout_is_found(name, monkeypatch):
    # Without the checks of the tests, which would be an exception in the layout.
    monkeypatch.setattr(Placement, "__init__", plain)
    layout, check, expected = LAYOUTS_THAT_OFFEND[name]
    faults = layout_faults(layout)
    assert check in faults
    assert expected in faults[check]


def test_good_layouts_pass():
    regions = {"left": [[-9.0, -6.0], [-3.0, 6.0]], "right": [[3.0, -6.0], [9.0, 6.0]]}
    plan = functools.partial(floor_plan, regions=regions, vehicle=["left", "right"], ways=[["left", "right"]])
    for layout in [row_of_people, plan, *(layout for layout in LAYOUTS.values() if layout is not floor_plan)]:
        assert not layout_faults(layout, cases=Cases.parse("val:2"))


FILES = {
    "policy": "from crowdbench.sim.pedestrians import ORCA\ndef policy(): return ORCA()\n",
    "predictor": "from crowdbench.predict import Linear\ndef predictor(): return Linear()\n",
    "metric": "def metric(trace): return trace.steps / 2\n",
    "planner": "from crowdbench.planners.reactive import ORCAPlanner\ndef planner(): return ORCAPlanner()\n",
}


def command(*arguments):
    return CliRunner().invoke(app, ["check", *arguments, "--cases", "val:1"])


@pytest.mark.parametrize("function", FILES)
def test_the_kind_is_found_by_the_function_of_the_file(function, tmp_path):
    answers = {"policy": "velocities", "predictor": "predictions", "metric": "values", "planner": "commands"}
    (tmp_path / "mine.py").write_text(FILES[function])
    done = command(str(tmp_path / "mine.py"))
    assert done.exit_code == 0, done.output
    assert answers[function] in done.output


def test_a_file_of_two_kinds_or_of_none_is_told(tmp_path):
    both = tmp_path / "both.py"
    both.write_text(FILES["planner"] + FILES["policy"])
    message = str(command(str(both)).exception)
    assert "defines planner() and policy(): say which is meant, with --kind planners or --kind pedestrians" in message
    assert "velocities" in command(str(both), "--kind", "pedestrians").output
    both.write_text("")
    message = str(command(str(both)).exception)
    assert "defines no function planner(), policy(), predictor(), metric(), layout() or reward()" in message


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("orca", "--kind", "policies"),
            "--kind is planners, pedestrians, predictors, metrics, layouts, rewards or scenarios",
        ),
        (("star", "--kind", "layouts"), "no layout is called 'star'; there are circle_crossing, square_crossing"),
        (("circle_crossing", "--kind", "layouts", "--option", "radius=2"), "unknown key layout.radius"),
        (
            ("length", "--kind", "metrics"),
            "no metric is called 'length' (did you mean path_length?); see crowdbench list",
        ),
        (("orca", "--kind", "pedestrians", "--option", "a=1"), "a pedestrian policy, which has no options"),
    ],
)
def test_what_cannot_be_checked_is_told(arguments, message):
    assert message in str(command(*arguments).exception)


def reward_faults(reward):
    place = load_scenario("circle_crossing_mixed", {"vehicle.visible": True, "time_limit": 6.0})
    return broken(results_of(Subject(REWARD, lambda: reward, "mine", {"": place}, neural=False), Cases.parse("val:4")))


@pytest.mark.parametrize("name", REWARDS.functions)
def test_rewards_that_ship_keep_their_contract(name):
    assert not reward_faults(REWARDS.find(name)[1])


@pytest.mark.parametrize(
    ("reward", "checks"),
    [
        (lambda step: 1 / 0, {"answers"}),
        (lambda step: step.progress[:-1], {"answers"}),
        (lambda step: np.full(len(step), np.nan), {"answers"}),
        (lambda step: step.progress - step.progress.mean(), {"independent"}),
    ],
)
def test_a_fault_of_a_reward_is_found(reward, checks):
    assert checks <= set(reward_faults(reward))


@pytest.mark.slow
def test_a_scenario_is_started_and_driven(tmp_path):
    place = load_scenario("circle_crossing_5")
    results = results_of(Subject(SCENARIO, lambda: place, "mine", {"": place}), Cases.parse("val:2"))
    assert "driven by ORCA: " in results["answers"].observation
    assert not broken(results)
    text = Path("scenarios/suite/street_8.toml").read_text()
    (tmp_path / "full.toml").write_text(text.replace("number = 8", "number = 40"))
    found = CliRunner().invoke(app, ["check", str(tmp_path / "full.toml"), "--cases", "val:2"])
    assert found.exit_code == 1
    assert "finds no room" in found.output


def test_a_scenario_is_checked_as_its_file_says(tmp_path):
    failed = CliRunner().invoke(app, ["check", "./mine.toml", "--scenario", "door_10"])
    assert "leave out --option and --scenario" in str(failed.exception)
    missing = CliRunner().invoke(app, ["check", str(tmp_path / "mine.toml")])
    assert "mine.toml" in str(missing.exception)
