"""Each point of a planner's contract is examined by itself: there is a planner that breaks it and nothing else."""

import time

import numpy as np
import pytest

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.check import CheckResult, check_planner
from crowdbench.cli.check import check_table
from crowdbench.planners.base import Planner
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

POINTS = [
    "exceptions",
    "decision time",
    "dtype",
    "shape",
    "finite",
    "speed",
    "observation",
    "deterministic",
    "batch",
]


def examined(make, cases="val:6", limit=60.0):
    points = check_planner(make, "mine", load_scenario("circle_crossing_5"), Cases.parse(cases), limit)
    assert [point.name for point in points][: len(POINTS)] == POINTS
    return {point.name: point for point in points}


def broken(points):
    return {name: point.seen for name, point in points.items() if point.kept is False}


def not_examined(points):
    return {name for name, point in points.items() if point.kept is None}


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
    "an exception": (lambda obs, command: 1 / 0, "exceptions", "raised ZeroDivisionError: division by zero"),
    "a way out": (lambda obs, command: exit(), "exceptions", "raised SystemExit"),
    "late": (late, "decision time", "took longer than the limit of 0.2 s (step 3, one of 6 cases)"),
    "late and deaf": (late_and_deaf, "decision time", "took longer than the limit of 0.2 s (step 3, one of 6 cases)"),
    "a list": (lambda obs, command: command.tolist(), "dtype", "returned a list instead of a float array"),
    "integers": (lambda obs, command: np.zeros((len(obs), 2), int), "dtype", "returned a int64 array"),
    "a third number": (
        lambda obs, command: np.pad(command, ((0, 0), (0, 1))),
        "shape",
        "returned shape [6, 3] instead of [6, 2]",
    ),
    "not a number": (
        lambda obs, command: with_case_2(command, obs, np.nan),
        "finite",
        "returned [nan, nan], but a command must be finite (case 2, step 3)",
    ),
    "infinite": (lambda obs, command: with_case_2(command, obs, np.inf), "finite", "returned [inf, inf]"),
    "too fast": (
        lambda obs, command: with_case_2(command, obs, 9.0),
        "speed",
        "asked for 12.7279 m/s, but the vehicle's maximum is 1 m/s (case 2, step 3)",
    ),
    "meddling": (meddle, "observation", "changes obs.pedestrians.velocity (case 0, step 3)"),
    "dice": (
        dice_for_case_2,
        "deterministic",
        "1e-06 when it sees the same episodes again",
    ),
}


@pytest.mark.parametrize("name", OFFENCES)
def test_an_offence_against_one_point_breaks_that_point_alone(name):
    answer, point, expected = OFFENCES[name]
    # Of so many commands one may differ in other batches, as a tie in rounding would.
    cases = "val:12" if answer is dice_for_case_2 else "val:6"
    points = examined(lambda: Breaks(answer), cases, limit=0.2 if point == "decision time" else 60.0)
    assert set(broken(points)) == {point}
    assert expected in points[point].seen
    assert not_examined(points) == set()


class Herd(Straight):
    """Lets the other worlds decide."""

    def plan(self, obs):
        return super().plan(obs) * (0.5 + 0.5 / len(obs))


def test_a_planner_that_lets_the_batch_decide_breaks_that_point_alone():
    points = examined(Herd, "val:4")
    assert set(broken(points)) == {"batch"}
    assert not_examined(points) == set()


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
    points = examined(make, "val:5")
    assert set(broken(points)) == {"batch"}
    assert f"commands differ by more than 1e-06 {when}" in points["batch"].seen


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
def test_an_offence_in_plan_ahead_breaks_that_point_alone(name):
    answer, expected = AHEAD[name]
    points = examined(lambda: Ahead(answer), "val:4")
    assert set(broken(points)) == {"plan_ahead"}
    assert expected in points["plan_ahead"].seen


def test_plan_ahead_is_a_point_of_planners_that_have_it():
    assert examined(Ahead, "val:2")["plan_ahead"].kept
    assert "plan_ahead" not in examined(Straight, "val:2")


def test_every_point_has_a_planner_that_breaks_it_alone():
    assert {point for _, point, _ in OFFENCES.values()} | {"batch"} == set(POINTS)


class Always(Planner):
    """Answers the same way at each step."""

    def __init__(self, answer):
        self.answer = answer

    def plan(self, obs):
        return self.answer(obs)


@pytest.mark.slow
def test_what_cannot_be_examined_is_said():
    after_shape = {"finite", "speed", "deterministic", "batch"}
    points = examined(lambda: Always(lambda obs: np.zeros(len(obs))))
    assert (set(broken(points)), not_examined(points)) == ({"shape"}, after_shape)
    points = examined(lambda: Always(lambda obs: "north"))
    assert (set(broken(points)), not_examined(points)) == ({"dtype"}, {"shape"} | after_shape)
    points = examined(lambda: Always(lambda obs: 1 / 0))
    assert (set(broken(points)), not_examined(points)) == ({"exceptions"}, set(POINTS) - {"exceptions"})
    assert points["speed"].seen == "not examined: the planner returned no array of commands"


@pytest.mark.slow
def test_several_offences_are_all_found():
    def answer(obs):
        meddle(obs, None)
        return np.full((len(obs), 2), 9)

    assert set(broken(examined(lambda: Always(answer), "val:2"))) == {"dtype", "speed", "observation"}


def test_a_planner_that_breaks_at_its_reset_is_told_so():
    class Mine(Straight):
        def reset(self, rows):
            raise KeyError("weights")

    points = examined(Mine)
    assert broken(points)["exceptions"].startswith("planner mine raised KeyError in reset(): 'weights', in line ")
    assert not_examined(points) == set(POINTS) - {"exceptions"}


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
def test_good_planners_keep_every_point():
    for make in (lambda: load_planner("orca")[1], lambda: load_planner("social_force")[1], Straight, Remembers):
        points = examined(make, "val:4")
        assert all(point.kept for point in points.values())
    assert examined(SinglePrecision, "val:2")["dtype"].seen.startswith("float32")


def test_commands_that_differ_each_time_break_both_repetitions():
    class Dice(Straight):
        def plan(self, obs):
            return super().plan(obs) * np.random.default_rng().uniform(0.9, 1.0, (len(obs), 1))

    assert set(broken(examined(Dice, "val:4"))) == {"deterministic", "batch"}


def test_memory_that_reset_does_not_clear_is_found():
    class Remembers(Straight):
        """Drives slower with every call, of whatever case."""

        calls = 0

        def plan(self, obs):
            self.calls += 1
            return super().plan(obs) / (1.0 + 0.01 * self.calls)

    assert set(broken(examined(Remembers, "val:4"))) == {"deterministic"}


class Lonely(Straight):
    """Answers otherwise from the second planner on, when each case has one of its own."""

    def __init__(self, made, answer):
        made.append(self)
        self.answer = answer if len(made) > 1 else super().plan

    def plan(self, obs):
        return self.answer(obs)


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (
            lambda obs: np.full((1, 2), np.nan),
            "planner mine returned [nan, nan], but a command must be finite (case 3",
        ),
        (lambda obs: 1 / 0, "planner mine raised ZeroDivisionError"),
        (lambda obs: np.zeros(2), "planner mine returned shape [2] instead of [1, 2]"),
        (lambda obs: meddle(obs, np.zeros((1, 2))), "planner mine changes obs.pedestrians.velocity (case 3"),
    ],
)
def test_what_breaks_only_alone_is_found(answer, expected):
    made = []
    points = examined(lambda: Lonely(made, answer), "val:3:6")
    assert set(broken(points)) == {"batch"}
    assert points["batch"].seen.startswith(f"when a case runs alone: {expected}")


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
        check_planner(Straight, "mine", place, Cases.parse("val:2"), 60.0)


def test_the_table_tells_what_is_kept_what_is_broken_and_what_was_not_examined():
    points = [
        CheckResult("dtype", False, "a list"),
        CheckResult("shape", None, "not examined"),
        CheckResult("finite", True, "all"),
    ]
    assert [row[0] for row in check_table("mine", points).rows] == ["broken", "?", "kept"]
