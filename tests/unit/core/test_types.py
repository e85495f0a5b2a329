"""The data model: what worlds, observations and traces hold beyond positions and velocities."""

import dataclasses

import numpy as np
import pytest
from helpers import advance, drive, fixture, trace

from crowdbench import load_scenario
from crowdbench.core.reward import COLLISION, WALL_COLLISION, reward
from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import collision_rate, discomfort_frequency, discounted_return, success_rate
from crowdbench.planners.planner import Planner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.layouts.crossings import circle_crossing
from crowdbench.scenario.placement import LayoutCall, Placement
from crowdbench.scenario.starts import LayoutStarts
from crowdbench.sim.episode import step_outcome
from crowdbench.sim.sensor import observe


def remembering(deep):
    """Worlds whose policy remembers nested arrays."""
    start = load_scenario("circle_crossing_5").worlds(Cases("val", 0, len(deep)))
    return start.replace(memory={"orca": {"flat": np.arange(len(deep)), "deep": {"er": np.array(deep)}}})


def test_rows_are_taken_from_memories_however_deep():
    part = remembering([[0.5], [1.5], [2.5], [3.5]]).take(np.array([True, False, True, False]))
    assert part.memory["orca"]["flat"].tolist() == [0, 2]
    assert part.memory["orca"]["deep"]["er"].tolist() == [[0.5], [2.5]]


def test_rows_are_put_into_memories_however_deep():
    start = remembering([0, 1, 2, 3])
    both = start.put(np.array([1]), remembering([77, 78]).take(np.array([1])))
    assert both.memory["orca"]["deep"]["er"].tolist() == [0, 78, 2, 3]
    assert start.memory["orca"]["deep"]["er"].tolist() == [0, 1, 2, 3]
    assert both.case.tolist() == [0, 1, 2, 3]


def test_a_world_is_put_among_worlds_with_other_routes():
    place = load_scenario(fixture("room"))
    alone = [place.worlds(Cases("val", case, case + 1)) for case in range(6)]
    longest = [world.route.shape[2] for world in alone]
    short, long = alone[int(np.argmin(longest))], alone[int(np.argmax(longest))]
    assert short.route.shape[2] < long.route.shape[2]
    for first, second in ((short, long), (long, short)):
        (case,) = second.case
        both = first.take(np.array([0, 0])).put(np.array([1]), second)
        together = place.draw("val", np.array([first.case[0], case]))
        assert np.array_equal(both.route, together.route, equal_nan=True)


def walled(rng, radius, preferred_speed):
    """A layout of one wall in every other case, in which the vehicle has a way of two points."""
    placed = circle_crossing(rng, radius, preferred_speed)
    if rng.random() < 0.5:
        return placed
    route = np.full((len(radius), 2, 2), np.nan)
    route[0] = [[1.0, 2.0], [3.0, 4.0]]
    return Placement(placed.start, placed.goal, route, np.array([[[0.0, 0.0], [1.0, 0.0]]]))


def test_routes_and_obstacles_of_a_layout_reach_the_world_and_the_observation():
    place = dataclasses.replace(load_scenario("circle_crossing_5"), starts=LayoutStarts(LayoutCall(walled)))
    start = place.worlds(Cases("val", 0, 12))
    assert start.route.shape == (12, 6, 2, 2)
    assert start.obstacles.shape == (12, 1, 2, 2)
    bare = np.isnan(start.obstacles).all(axis=(1, 2, 3))
    assert 0 < bare.sum() < 12
    assert np.isnan(start.route[bare]).all()
    assert np.isnan(start.route[:, 1:]).all()
    obs = observe(start)
    assert np.array_equal(obs.obstacles, start.obstacles, equal_nan=True)
    assert obs.vehicle.route[~bare].tolist() == [[[1.0, 2.0], [3.0, 4.0]]] * int((~bare).sum())
    assert np.array_equal(obs.take(~bare).vehicle.route, start.route[~bare, 0])


def test_worlds_without_routes_and_obstacles_have_none():
    obs = observe(load_scenario("circle_crossing_5").worlds(Cases("val", 0, 3)))
    assert obs.vehicle.route.shape == (3, 0, 2)
    assert obs.obstacles.shape == (3, 0, 0, 2)


def test_padding_is_nobody_and_was_never_seen():
    start = load_scenario("circle_crossing_5", {"pedestrians.number": [1, 4]}).worlds(Cases("val", 0, 10))
    absent = ~start.present[:, 1:]
    assert absent.any()
    assert (start.person[absent] == -1).all()
    assert (start.group == -1).all()
    assert all(own[here].tolist() == list(range(here.sum())) for own, here in zip(start.person, ~absent, strict=True))
    crowd = observe(start).pedestrians
    assert np.array_equal(crowd.seen, ~absent)
    assert np.array_equal(crowd.observed, np.where(absent, 0, 1))
    assert np.array_equal(crowd.age, np.where(absent, np.inf, 0.0))


def test_a_vehicle_faces_its_goal_then_where_it_last_moved():
    now = load_scenario("circle_crossing_5").worlds(Cases("val", 0, 1))
    assert now.heading == pytest.approx(np.pi / 2)
    quarter = np.pi / 2 / now.rules.dt
    for velocity, heading, turning in (
        ([0.0, 0.0], np.pi / 2, 0.0),
        ([1.0, 0.0], 0.0, -quarter),
        ([0.0, 0.0], 0.0, 0.0),
        ([0.0, -0.5], -np.pi / 2, -quarter),
        ([-0.5, 0.0], np.pi, -quarter),
    ):
        moved = np.zeros((1, 6, 2))
        moved[0, 0] = velocity
        now = advance(now, moved)
        assert now.heading == pytest.approx(heading)
        assert now.angular_speed == pytest.approx(turning)


@pytest.mark.parametrize(
    ("gap", "wall_gap", "left", "is_last", "outcome"),
    [
        (-0.1, -0.1, 0.0, True, Outcome.TIMEOUT),
        (-0.1, -0.1, 0.0, False, Outcome.COLLISION),
        (0.1, -0.1, 0.0, False, Outcome.WALL_COLLISION),
        (0.1, 0.1, 0.29, False, Outcome.SUCCESS),
        (0.0, 0.0, 0.3, False, Outcome.RUNNING),
    ],
)
def test_the_rule_of_an_episode_is_timeout_then_collision_then_success(gap, wall_gap, left, is_last, outcome):
    assert step_outcome(gap, wall_gap, left, 0.0, 0.3, is_last) == outcome


def test_a_collision_with_an_obstacle_is_a_collision_and_has_a_reward_of_its_own():
    path = [[[0.0, 0.1 * t]] for t in range(4)]
    walls, people, arrived = (trace(path, end, gap=[1.0] * 3) for end in (4, Outcome.COLLISION, Outcome.SUCCESS))
    assert Outcome(4) is Outcome.WALL_COLLISION
    assert [bool(collision_rate(each)[0]) for each in (walls, people, arrived)] == [True, True, False]
    assert not success_rate(walls)[0]
    assert discomfort_frequency(walls)[0] == 0.0
    for outcome, paid in ((Outcome.WALL_COLLISION, WALL_COLLISION), (Outcome.COLLISION, COLLISION)):
        assert reward(np.array([outcome]), np.array([-0.1]), 0.25)[0] == paid
    assert discounted_return(walls)[0] == pytest.approx(WALL_COLLISION * 0.9**0.5)


class Weaves(Planner):
    """Drives left and right in turn, and remembers what it asked for."""

    def __init__(self):
        self.asked = []

    def plan(self, obs):
        self.asked.append(np.tile([0.3 * (-1.0) ** obs.step[0], 0.9], (len(obs), 1)))
        return self.asked[-1]


def test_a_trace_keeps_commands_apart_from_velocities():
    planner = Weaves()
    driven = drive(planner, "val:1")
    steps = driven.steps[0]
    assert np.array_equal(driven.command[0, :steps], np.concatenate(planner.asked))
    assert np.isnan(driven.command[0, steps:]).all()
    assert np.array_equal(driven.command[0, :steps], driven.velocity[0, 1 : steps + 1, 0])
    assert np.array_equal(driven.heading[0, 1 : steps + 1], np.arctan2(*driven.command[0, :steps].T[::-1]))


def test_a_trace_tells_everything_over_time():
    driven = drive("orca", "val:3", "circle_crossing_mixed")
    worlds, times, agents = driven.position.shape[:3]
    assert driven.goal.shape == (worlds, times, agents, 2)
    assert driven.radius.shape == driven.present.shape == (worlds, times, agents)
    assert driven.person.shape == driven.seen.shape == (worlds, times, agents - 1)
    assert np.array_equal(driven.seen, driven.present[:, :, 1:])
    here = np.arange(times)[None, :] <= driven.steps[:, None]
    assert np.array_equal(np.isfinite(driven.position[..., 0]), driven.present & here[..., None])
    assert np.isinf(driven.wall_gap[:, 0]).all()
