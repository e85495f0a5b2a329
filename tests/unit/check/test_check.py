"""`crowdbench check` on planners: each fault is found by one check, in a sentence."""

import time

import numpy as np
import pytest

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.check import CheckResult, check_plugin
from crowdbench.check.checks import Subject
from crowdbench.check.drives import PLANNER
from crowdbench.cli.check import check_table
from crowdbench.planners.planner import Planner
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

PLACE = load_scenario("circle_crossing_5", {"time_limit": 4.0})


def examined(make, cases="val:6", limit=60.0):
    subject = Subject(PLANNER, make, "mine", {"": PLACE}, limit, neural=False)
    return {result.name: result for result in check_plugin(subject, Cases.parse(cases))}


def broken(results):
    return {name: result.observation for name, result in results.items() if result.passed is False}


def not_examined(results):
    return {name for name, result in results.items() if result.passed is None}


class Straight(Planner):
    """Drives to the goal, as seen from a copy: what it is shown is left to those who change it."""

    def plan(self, obs):
        offset = obs.vehicle.goal - obs.vehicle.position
        return 0.9 * offset / np.linalg.norm(offset, axis=1, keepdims=True)


class Breaks(Straight):
    """Answers otherwise at step 3: as a function of the observation and the command says."""

    def __init__(self, answer):
        self.answer = answer

    def plan(self, obs):
        command = super().plan(obs)
        return self.answer(obs, command) if obs.step[0] == 3 else command


KEYS = load_scenario("circle_crossing_5").draw("val", np.arange(12)).noise_key.tolist()
"""By these a planner here knows its cases."""


def with_case_2(command, obs, value):
    command[obs.noise_key == KEYS[2]] = value
    return command


def meddle(obs, command):
    obs.pedestrians.velocity[:] += 1e-3
    return command


def late(obs, command):
    time.sleep(0.5)
    return command


def late_and_deaf(obs, command):
    """Catches what interrupts it, and answers after the limit."""
    try:
        time.sleep(0.5)
    except BaseException:
        time.sleep(0.1)
    return command


def dice_for_case_2(obs, command):
    return with_case_2(command, obs, np.random.default_rng().uniform(0.0, 0.5, 2))


OFFENCES = {
    "an exception": (lambda obs, command: 1 / 0, "planner mine raised ZeroDivisionError: division by zero"),
    "a way out": (lambda obs, command: exit(), "raised SystemExit"),
    "late": (late, "took longer than the limit of 0.2 s (step 3, one of 6 cases)"),
    "late and deaf": (late_and_deaf, "took longer than the limit of 0.2 s (step 3, one of 6 cases)"),
    "a list": (lambda obs, command: command.tolist(), "returned a list instead of a float array"),
    "integers": (lambda obs, command: np.zeros((len(obs), 2), int), "returned a int64 array"),
    "a third number": (
        lambda obs, command: np.pad(command, ((0, 0), (0, 1))),
        "returned shape [6, 3] instead of [6, 2]",
    ),
    "not a number": (
        lambda obs, command: with_case_2(command, obs, np.nan),
        "returned [nan, nan], but a command must be finite (case 2, step 3)",
    ),
    "infinite": (lambda obs, command: with_case_2(command, obs, np.inf), "returned [inf, inf]"),
    "too fast": (
        lambda obs, command: with_case_2(command, obs, 9.0),
        "asked for 12.7279 m/s, but the vehicle's maximum is 1 m/s (case 2, step 3)",
    ),
    "meddling": (meddle, "changes obs.pedestrians.velocity (case 0, step 3), but must leave it as it is"),
    "a text": (lambda obs, command: "north", "returned a str instead of a float array"),
}


@pytest.mark.parametrize("name", OFFENCES)
def test_an_invalid_answer_is_told(name):
    answer, expected = OFFENCES[name]
    results = examined(lambda: Breaks(answer), limit=0.2 if name.startswith("late") else 60.0)
    assert set(broken(results)) == {"answers"}
    assert expected in broken(results)["answers"]
    assert not_examined(results) == {"repeatable", "independent"}


def test_a_planner_that_never_answers_ends():
    def hang(obs, command):
        while True:
            time.sleep(0.01)

    assert "took longer than the limit of 0.2 s" in broken(examined(lambda: Breaks(hang), limit=0.2))["answers"]


def test_dice_are_found():
    results = examined(lambda: Breaks(dice_for_case_2))
    assert "repeatable" in broken(results)
    sentence = "1 of 64 commands differ when repeated, first in case 2, step 3: an answer may depend only on"
    assert sentence in results["repeatable"].observation


class Herd(Straight):
    """Lets the other worlds decide."""

    def plan(self, obs):
        return super().plan(obs) * (0.5 + 0.5 / len(obs))


def test_a_planner_that_lets_the_batch_decide_is_found():
    results = examined(Herd, "val:4")
    assert set(broken(results)) == {"independent"}
    assert not_examined(results) == set()


class Triples(Straight):
    """Drives slower in batches of three."""

    def reset(self, rows):
        self.pace = 0.5 if len(rows) == 3 else 1.0

    def plan(self, obs):
        return super().plan(obs) * self.pace


class Ordered(Straight):
    """Drives slower where the last case comes first."""

    def plan(self, obs):
        first, last = (KEYS.index(key) for key in obs.noise_key[[0, -1]])
        return super().plan(obs) * (0.5 if first > last else 1.0)


@pytest.mark.parametrize(("make", "when"), [(Triples, "in batches of 3"), (Ordered, "in reverse order")])
def test_commands_are_compared_in_batches_of_several_sizes_and_orders(make, when):
    results = examined(make, "val:5")
    assert set(broken(results)) == {"independent"}
    assert f"commands differ {when}, first in case " in results["independent"].observation


class Ahead(Straight):
    """Decides several steps at once, as a function of the commands and the observation says."""

    def __init__(self, answer=lambda commands, obs: commands):
        self.answer = answer

    def plan_ahead(self, obs, steps):
        return self.answer(np.repeat(self.plan(obs)[:, None], steps, axis=1), obs)


AHEAD = {
    "an exception": (lambda commands, obs: 1 / 0, "raised ZeroDivisionError: division by zero"),
    "a list": (lambda commands, obs: commands.tolist(), "returned a list instead of a float array"),
    "one step": (lambda commands, obs: commands[:, 0], "returned shape [4, 2] instead of [4, 8, 2]"),
    "not a number": (lambda commands, obs: commands * np.nan, "must be finite (case 0, step 0)"),
    "too fast": (lambda commands, obs: commands * 2, "asked for 1.8 m/s, but the vehicle's maximum is 1 m/s"),
}


@pytest.mark.parametrize("name", AHEAD)
def test_an_invalid_answer_of_plan_ahead_is_told(name):
    answer, expected = AHEAD[name]
    assert expected in broken(examined(lambda: Ahead(answer), "val:4"))["answers"]


def test_plan_ahead_is_compared_too():
    results = examined(lambda: Ahead(lambda commands, obs: commands * (0.5 + 0.5 / len(obs))), "val:4")
    assert "first in case 0, step 0, plan_ahead" in broken(results)["independent"]
    assert not broken(examined(Ahead, "val:2"))


def test_a_planner_that_breaks_at_its_reset_is_told_so():
    class Mine(Straight):
        def reset(self, rows):
            raise KeyError("weights")

    sentence = broken(examined(Mine))["answers"]
    assert sentence.startswith("planner mine raised KeyError in reset(): 'weights', in line ")


class Remembers(Straight):
    """Has a memory, keyed by row as it should be."""

    def __init__(self):
        self.calls = {}

    def reset(self, rows):
        self.calls = dict.fromkeys(rows.tolist(), 0)

    def plan(self, obs):
        for row in obs.row.tolist():
            self.calls[row] += 1
        slower = np.array([0.99 ** self.calls[row] for row in obs.row.tolist()])
        return super().plan(obs) * slower[:, None]


class SinglePrecision(Straight):
    def plan(self, obs):
        return super().plan(obs).astype(np.float32)


@pytest.mark.slow
def test_good_planners_pass():
    good = lambda: load_planner("orca"), lambda: load_planner("social_force"), Straight, Remembers
    for make in (*good, SinglePrecision):
        assert all(result.passed for result in examined(make, "val:4").values())


def test_commands_that_differ_each_time_break_both_repetitions():
    class Dice(Straight):
        def plan(self, obs):
            return super().plan(obs) * np.random.default_rng().uniform(0.9, 1.0, (len(obs), 1))

    assert set(broken(examined(Dice, "val:4"))) == {"repeatable", "independent"}


def test_memory_that_reset_does_not_clear_is_found():
    class Remembers(Straight):
        """Drives slower with every call, of whatever case."""

        calls = 0

        def plan(self, obs):
            self.calls += 1
            return super().plan(obs) / (1.0 + 0.01 * self.calls)

    assert "when repeated" in broken(examined(Remembers, "val:4"))["repeatable"]


def test_a_network_with_random_weights_is_found():
    class Untrained(Straight):
        def __init__(self):
            self.pace = np.random.default_rng().uniform(0.5, 1.0)

        def plan(self, obs):
            return super().plan(obs) * self.pace

    assert "with a new instance" in broken(examined(Untrained, "val:4"))["repeatable"]


def test_only_networks_may_be_rounded_by_the_batch():
    class Rounded(Straight):
        def plan(self, obs):
            return super().plan(obs) * (1.0 - 1e-9 * len(obs))

    assert set(broken(examined(Rounded, "val:4"))) == {"independent"}
    assert not broken(
        {
            each.name: each
            for each in check_plugin(Subject(PLANNER, Rounded, "mine", {"": PLACE}, neural=True), Cases("val", 0, 4))
        }
    )


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (lambda obs: np.full((1, 2), np.nan), "planner mine returned [nan, nan], but a command must be finite (case 3"),
        (lambda obs: 1 / 0, "planner mine raised ZeroDivisionError"),
        (lambda obs: np.zeros(2), "planner mine returned shape [2] instead of [1, 2]"),
        (lambda obs: meddle(obs, np.zeros((1, 2))), "the plug-in changes obs.pedestrians.velocity (case 3"),
    ],
)
def test_what_breaks_only_alone_is_found(answer, expected):
    class Lonely(Straight):
        def reset(self, rows):
            self.is_alone = len(rows) == 1

        def plan(self, obs):
            return answer(obs) if self.is_alone else super().plan(obs)

    found = broken(examined(Lonely, "val:3:6"))
    assert set(found) == {"independent"}
    assert found["independent"].startswith(f"when a case is driven alone: {expected}")


def test_a_broken_pedestrian_policy_is_not_blamed_on_the_planner(tmp_path):
    (tmp_path / "mine.py").write_text(
        "from crowdbench import PedestrianPolicy\n"
        "class Mine(PedestrianPolicy):\n"
        "    parameters = {}\n"
        "    def velocities(self, world, parameters):\n"
        "        return None\n"
        "policy = Mine\n"
    )
    place = load_scenario("circle_crossing_5", pedestrians=str(tmp_path / "mine.py"))
    with pytest.raises(InputError, match="pedestrian policy mine returned None"):
        check_plugin(Subject(PLANNER, Straight, "mine", {"": place}), Cases.parse("val:2"))


def test_the_table_tells_what_is_kept_what_is_broken_and_what_was_not_examined():
    points = [
        CheckResult("dtype", False, "a list"),
        CheckResult("shape", None, "not examined"),
        CheckResult("finite", True, "all"),
    ]
    assert [row[0] for row in check_table("mine", points).rows] == ["failed", "?", "passed"]
