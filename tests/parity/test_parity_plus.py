"""The simulator against CrowdNav++'s own episodes."""

import numpy as np
import pytest
from helpers import drive

from crowdbench import Planner, load_planner, load_scenario
from crowdbench.core.geometry import toward_goal
from crowdbench.scenario.cases import Cases
from crowdbench.sim.pedestrians.orca import orca_velocities


class Robot(Planner):
    """The ORCA robot of CrowdNav++. Differs from the planner `orca` because all others are neighbours."""

    def plan(self, obs):
        vehicle = obs.vehicle
        position, velocity, radius, present = obs.everybody()
        preferred = np.zeros_like(position)
        preferred[:, 0] = toward_goal(vehicle.position, vehicle.goal, vehicle.preferred_speed)
        return orca_velocities(
            position,
            velocity,
            preferred,
            radius + 0.16,
            np.ones_like(radius),
            time_step=obs.dt,
            max_neighbors=1000,
            seen=present,
            moves=np.broadcast_to(np.arange(radius.shape[1]) == 0, radius.shape),
        )[:, 0]


def first_change(data):
    """The time of the last state before a pedestrian is another one or has another goal; the end where none is."""
    jumps = np.abs(np.diff(data["goal"][:, :, 1:], axis=1)).max(axis=(2, 3)) > 1e-6  # NaN compares false
    return np.where(jumps.any(axis=1), jumps.argmax(axis=1), data["length"])


@pytest.mark.parametrize(
    ("recorded", "planner", "scenario", "outcomes", "lengths", "positions"),
    [
        ("crowdnavpp_straight", "straight", "crowdnav_plus_20", 0.99, 0.99, 0.99),
        ("crowdnavpp_random_straight", "straight", "crowdnav_plus_20_random", 0.95, 0.95, 0.99),
        ("crowdnavpp_orca", "robot", "crowdnav_plus_20", 0.95, 0.9, 0.96),
    ],
)
def test_episodes_are_crowdnav_plus_s(reference, recorded, planner, scenario, outcomes, lengths, positions):
    data = reference(recorded)
    driver = Robot() if planner == "robot" else load_planner(planner)
    trace = drive(driver, str(len(data["case"])), scenario)
    assert (trace.outcome == data["outcome"]).mean() >= outcomes
    assert (trace.steps == data["length"]).mean() >= lengths
    both = min(trace.position.shape[1], data["position"].shape[1])
    error = np.abs(trace.position[:, :both] - data["position"][:, :both]).max(axis=3)
    # Where pedestrians are tightly packed, RVO2's single precision shows after some steps.
    same_people = (np.arange(both) <= first_change(data)[:, None])[:, :, None] & np.isfinite(error)
    assert (error[same_people] < 1e-4).mean() >= positions


def test_people_who_arrive_are_replaced_by_those_of_crowdnav_plus(reference):
    data = reference("crowdnavpp_orca")
    trace = drive(Robot(), str(len(data["case"])), "crowdnav_plus_20")
    both = min(trace.goal.shape[1], data["goal"].shape[1])
    came = np.diff(trace.person[:, :both], axis=1) != 0
    first = came & (np.cumsum(came.any(axis=2), axis=1) == 1)[:, :, None]
    assert first.sum() > 20
    same = np.abs(trace.goal[:, 1:both, 1:] - data["goal"][:, 1:both, 1:])[first].max(axis=1) < 1e-5
    assert same.mean() >= 0.9  # the others arrive a step earlier or later


def test_goals_change_on_the_way_to_those_of_crowdnav_plus(reference):
    data = reference("crowdnavpp_random_straight")
    trace = drive("straight", str(len(data["case"])), "crowdnav_plus_20_random")
    long = data["length"] > 21  # goals change after 5 s
    before, after = (trace.goal[long, time, 1:] for time in (19, 20))
    assert 0.4 < (before != after).any(axis=2).mean() < 0.6
    assert (np.abs(after - data["goal"][long, 20, 1:]).max(axis=2) < 1e-5).mean() >= 0.99


def test_only_test_cases_below_crowdnav_cases_are_crowdnav_plus_s():
    scenario = load_scenario("crowdnav_plus_20_random", {"crowdnav_cases": 2})
    theirs, others = scenario.worlds(Cases.parse("2")), scenario.worlds(Cases.parse("2:4"))
    again = load_scenario("crowdnav_plus_20_random", {"crowdnav_cases": 500})
    assert np.array_equal(theirs.position, again.worlds(Cases.parse("2")).position)
    assert not np.array_equal(others.position, again.worlds(Cases.parse("2:4")).position)
    assert (others.memory["crowdnav_plus"]["drawn"] == -1).all()
    assert ((others.radius[:, 1:] >= 0.3) & (others.radius[:, 1:] <= 0.5)).all()


def test_a_case_does_not_depend_on_its_batch():
    together = drive("straight", "3:9", "crowdnav_plus_20_random")
    alone = drive("straight", "5:6", "crowdnav_plus_20_random")
    last = alone.steps[0] + 1
    assert np.array_equal(together.position[2, :last], alone.position[0, :last])
    assert np.array_equal(together.person[2, :last], alone.person[0, :last])
