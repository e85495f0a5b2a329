"""A planner that breaks its contract is told so in one sentence."""

import re
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from helpers import Still, drive, same

from crowdbench.catalog import load_scenario
from crowdbench.cli.run import warn_if_trained_otherwise
from crowdbench.core import rng
from crowdbench.planners.planner import OneWorldPlanner, Planner
from crowdbench.runs.loading import load_run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import InputError, plugin_errors


class Says(Planner):
    """Returns what it is given to return, from the third step on."""

    def __init__(self, answer):
        self.answer = answer

    def plan(self, obs):
        return self.answer(obs) if obs.step[0] >= 2 else np.zeros((len(obs), 2))


def nan_for_case_3(obs):
    command = np.zeros((len(obs), 2))
    command[obs.row == 3, 1] = np.nan
    return command


def fast_for_case_4(obs):
    command = np.zeros((len(obs), 2))
    command[obs.row == 4] = [1.0, 0.3]
    return command


def forever(obs):
    while True:
        try:
            time.sleep(0.001)
        except Exception:
            continue


def deaf(obs):
    """Catches what interrupts it, once."""
    try:
        time.sleep(0.5)
    except BaseException:
        time.sleep(0.1)
    return np.zeros((len(obs), 2))


def foreseeing(obs):
    """Is interrupted while it asks a pedestrian policy."""
    with plugin_errors("pedestrian policy slow raised"):
        forever(obs)


BROKEN = {
    "not a number": (nan_for_case_3, "returned [0.0, nan], but a command must be finite (case 3, step 2)"),
    "a world too few": (lambda obs: np.zeros((len(obs) - 1, 2)), "returned shape [4, 2] instead of [5, 2]"),
    "a string": (lambda obs: "north", "returned a str instead of a float array"),
    "too fast": (fast_for_case_4, "asked for 1.04403 m/s, but the vehicle's maximum is 1 m/s (case 4, step 2)"),
    "an exception": (lambda obs: 1 / 0, "raised ZeroDivisionError: division by zero, in line "),
    "peeking": (lambda obs: obs.true_next(), "raised PermissionError: true_next()"),
    "a way out": (lambda obs: sys.exit(0), "raised SystemExit: 0, in line "),
    "deaf": (deaf, "took longer than the limit of 0.2 s (step 2, one of 5 cases)"),
    "no end": (forever, "took longer than the limit of 0.2 s (step 2, one of 5 cases)"),
    "no end of a policy": (foreseeing, "took longer than the limit of 0.2 s (step 2, one of 5 cases)"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_planner_gets_one_sentence(name):
    answer, expected = BROKEN[name]
    with pytest.raises(InputError) as error:
        drive(Says(answer), "5", decision_limit=0.2)
    assert str(error.value).startswith("planner Says ")
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


def test_an_exception_is_told_with_the_line_of_the_planners_file():
    with pytest.raises(InputError, match=r"division by zero, in line \d+ of test_driver\.py \(step 2, ") as error:
        drive(Says(lambda obs: 1 / 0), "5")
    line = int(re.search(r"in line (\d+)", str(error.value))[1])
    assert "1 / 0" in Path(__file__).read_text().splitlines()[line - 1]
    with pytest.raises(InputError, match=r"operands .*, in line \d+ of test_driver\.py "):  # not that of a package
        drive(Says(lambda obs: np.add(np.zeros(2), np.zeros(3))), "5")


class SaysAhead(Still):
    """Returns what it is given to return for 8 steps, when it is asked for the second time."""

    def __init__(self, answer):
        self.answer = answer

    def plan_ahead(self, obs, steps):
        return self.answer(obs) if obs.step[0] else np.zeros((len(obs), steps, 2))


def ahead(case, step, command):
    """An answer that is nothing but zeros but for one command."""

    def answer(obs):
        commands = np.zeros((len(obs), 8, 2))
        commands[obs.row == case, step - obs.step[0]] = command
        return commands

    return answer


BROKEN_AHEAD = {
    "not a number": (
        ahead(3, 13, [0.0, np.nan]),
        "returned [0.0, nan], but a command must be finite (case 3, step 13)",
    ),
    "one step": (
        lambda obs: np.zeros((len(obs), 2)),
        "returned shape [5, 2] instead of [5, 8, 2], a command per world",
    ),
    "time first": (lambda obs: np.zeros((8, len(obs), 2)), "returned shape [8, 5, 2] instead of [5, 8, 2]"),
    "an exception": (lambda obs: 1 / 0, "raised ZeroDivisionError: division by zero, in line "),
    "no end": (forever, "took longer than the limit of 0.2 s (step 8, one of 5 cases)"),
}


@pytest.mark.parametrize("name", BROKEN_AHEAD)
def test_a_broken_plan_of_several_steps_gets_one_sentence(name):
    answer, expected = BROKEN_AHEAD[name]
    with pytest.raises(InputError) as error:
        drive(SaysAhead(answer), "5", decision_limit=0.2, replan_every=8)
    assert str(error.value).startswith("planner SaysAhead ")
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("planner", [Still(), OneWorldPlanner(lambda obs: np.zeros(2))])
def test_a_planner_of_single_steps_is_told_that_it_plans_none_ahead(planner):
    with pytest.raises(InputError, match=r"^planner \w+ has no plan_ahead"):
        drive(planner, "2", replan_every=8)


def test_the_decision_limit_leaves_other_threads_alone():
    done = []
    thread = threading.Thread(target=lambda: done.append(drive(Still(), "2")))
    thread.start()
    thread.join()
    assert len(done) == 1


def test_a_planner_for_one_world_is_lifted_to_batches():
    seen = []

    def straight(obs):
        shapes = obs.vehicle.position.shape, obs.pedestrians.history.shape, obs.noise("x", (5, 3)).shape
        seen.append((*shapes, float(obs.time)))
        offset = obs.vehicle.goal - obs.vehicle.position
        obs.log("distance", np.linalg.norm(offset))
        return 0.99 * offset / np.linalg.norm(offset)

    class Straight(Planner):
        def plan(self, obs):
            offset = obs.vehicle.goal - obs.vehicle.position
            return 0.99 * offset / np.linalg.norm(offset, axis=1, keepdims=True)

    lifted, batched = drive(OneWorldPlanner(straight), "10"), drive(Straight(), "10")
    assert np.allclose(lifted.position, batched.position, equal_nan=True)
    assert set(seen[:10]) == {((2,), (8, 5, 2), (5, 3), 0.0)}


def test_a_planner_cannot_move_the_world():
    class Cheats(Still):
        def plan(self, obs):
            obs.vehicle.position[:] = obs.vehicle.goal
            obs.vehicle.goal[:] = 0.0
            obs.pedestrians.position[:] = 99.0
            obs.pedestrians.history[:] = 99.0
            obs.step[:] = 0
            return super().plan(obs)

    assert same(drive(Cheats(), "5"), drive(Still(), "5"))


def test_a_planner_cannot_raise_its_own_maximum():
    class Cheats(Still):
        def plan(self, obs):
            obs.vehicle.preferred_speed[:] = 9.0
            return super().plan(obs) + 2.0

    with pytest.raises(InputError, match=r"asked for 2\.82843 m/s, but the vehicle's maximum is 1 m/s"):
        drive(Cheats(), "2")


def test_a_planner_that_breaks_at_its_reset_is_told_so():
    class Mine(Still):
        def reset(self, rows):
            raise KeyError("weights")

    with pytest.raises(InputError, match=r"planner Mine raised KeyError in reset\(\)"):
        drive(Mine(), "2")


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_decision_limit_is_a_time(limit):
    with pytest.raises(InputError, match="decision limit"):
        drive(Still(), "1", decision_limit=limit)


def test_a_planners_noise_is_not_the_crowds():
    start = load_scenario("circle_crossing_5").worlds(Cases("val", 0, 20))
    own = observe(start).noise("social_force", (5, 2))
    assert not (own == rng.normal(start.key, "social_force", start.step, (5, 2))).any()
    assert not np.isin(start.noise_key, start.key).any()


def test_noise_does_not_change_with_batch_padding_or_length():
    obs = observe(load_scenario("circle_crossing_5").worlds(Cases("val", 0, 9)))
    noise = obs.noise("x", (3, 5, 6))
    assert np.array_equal(obs.take(np.array([7, 2])).noise("x", (2, 9, 5))[:, :, :5], noise[[7, 2], :2, :, :5])
    assert np.array_equal(obs.noise("x", (5, 6)), noise[:, 0])
    assert np.array_equal(obs.noise("x", (6,)), noise[:, 0, 0])
    assert np.array_equal(obs.noise("x", ()), noise[:, 0, 0, 0])
    assert obs.noise("x", (0, 4)).shape == (9, 0, 4)
    assert len(np.unique(obs.noise("x", (2, 3, 4, 5, 6)))) == 9 * 720


@pytest.mark.parametrize("shape", [(1,) * 6, (2, -1), (2**21 + 1, 1, 1)])
def test_impossible_shapes_of_noise_are_refused(shape):
    obs = observe(load_scenario("circle_crossing_5").worlds(Cases("val", 0, 1)))
    with pytest.raises(InputError, match="cannot be drawn: it must have at most 5 axes"):
        obs.noise("x", shape)


@pytest.mark.parametrize(("number", "said"), [(10, ""), (12, "was trained with 10 pedestrians at most, but")])
def test_a_run_says_where_there_are_more_pedestrians_than_in_training(number, said, capsys):
    spec = RunSpec("ppo", "circle_crossing_5", Cases.parse("1"), overrides={"pedestrians.number": number})
    warn_if_trained_otherwise(load_run(spec))
    told = capsys.readouterr().err
    assert told.endswith(f"circle_crossing_5 has {number}: its figures may be worse for that\n") if said else not told
    assert said in told


@pytest.mark.parametrize(
    ("planner", "dt", "said"),
    [
        ("ppo", 0.25, ""),
        ("ppo", 0.2, "crowdbench: planner ppo was trained with steps of 0.25 s, but circle_crossing_5 has dt = 0.2 s"),
        ("sarl_cvm", 0.5, "crowdbench: planner sarl_cvm was trained with steps of 0.25 s, but"),
        ("orca", 0.1, ""),
    ],
)
def test_a_run_says_where_steps_are_longer_or_shorter_than_in_training(planner, dt, said, capsys):
    warn_if_trained_otherwise(load_run(RunSpec(planner, "circle_crossing_5", Cases.parse("1"), overrides={"dt": dt})))
    told = capsys.readouterr().err
    assert told.startswith(said)
    assert bool(told) == bool(said)


@pytest.mark.parametrize("scenario", ["circle_crossing_5", "unicycle", "car_28"])
def test_a_huge_command_gets_one_sentence_and_no_warning_of_numpy(scenario):
    class Huge(Planner):
        native = True

        def plan(self, obs):
            return np.full((len(obs), 2), 1e300)

    with pytest.raises(InputError, match=r"1e\+300"):
        drive(Huge(), "1", scenario)
