import numpy as np

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.evaluate.check import check
from crowdbench.planners.base import Planner
from crowdbench.scenario.cases import Cases


def broken_points(make, cases="val:6"):
    points = check(make, "mine", load_scenario("circle_crossing_5"), Cases.parse(cases), 60.0)
    return {point.name: point.seen for point in points if not point.kept}


class Straight(Planner):
    def plan(self, obs):
        offset = obs.vehicle.goal - obs.vehicle.position
        return 0.9 * offset / np.linalg.norm(offset, axis=1, keepdims=True)


class Meddler(Straight):
    def plan(self, obs):
        command = super().plan(obs)
        obs.pedestrians.velocity[:] += 1e-3
        return command


class Dice(Straight):
    def plan(self, obs):
        return super().plan(obs) * np.random.default_rng().uniform(0.9, 1.0, (len(obs), 1))


class Herd(Straight):
    """Lets the other worlds decide."""

    def plan(self, obs):
        return super().plan(obs) * (0.5 + 0.5 / len(obs))


class Remembers(Straight):
    """Has a memory, keyed by case as it should be."""

    def __init__(self):
        self.calls = {}

    def reset(self, cases):
        self.calls = dict.fromkeys(cases.tolist(), 0)

    def plan(self, obs):
        for case in obs.case.tolist():
            self.calls[case] += 1
        slower = np.array([0.99 ** self.calls[case] for case in obs.case.tolist()])
        return super().plan(obs) * slower[:, None]


class Lonely(Straight):
    """Answers otherwise from the third planner on, when each case has one of its own."""

    def __init__(self, made, answer):
        made.append(self)
        self.answer = answer if len(made) > 2 else super().plan

    def plan(self, obs):
        return self.answer(obs)


class Races(Planner):
    def plan(self, obs):
        return np.full((len(obs), 2), 9.0)


def test_good_planners_keep_every_point():
    for make in (lambda: load_planner("orca")[1], lambda: load_planner("social_force")[1], Straight, Remembers):
        assert broken_points(make) == {}


def test_each_offence_is_found():
    assert "obs.pedestrians.velocity" in broken_points(Meddler)["observation"]
    assert set(broken_points(Dice)) == {"deterministic", "batch"}
    assert set(broken_points(Herd)) == {"batch"}
    assert "asked for 12.7279 m/s" in broken_points(Races)["commands"]


def test_what_breaks_only_alone_is_found():
    for answer in (lambda obs: np.full((1, 2), np.nan), lambda obs: 1 / 0, lambda obs: np.zeros(2)):
        made = []
        points = broken_points(lambda made=made, answer=answer: Lonely(made, answer), "val:3:6")
        assert set(points) == {"batch"}
