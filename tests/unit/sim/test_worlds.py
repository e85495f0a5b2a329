"""Every planner drives in every world that ships, and what one sees in it is what the simulator did."""

import numpy as np
import pytest
from helpers import drive, fixture

from crowdbench.catalog import load_scenario
from crowdbench.core.geometry import norm
from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import sct, spl
from crowdbench.scenario.cases import Cases
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.sim.simulator import crowd_velocities, step

WALLED = ["doorway", "corridor", "blind_corner", "intersection", "room", "traffic"]


def assert_only_the_vehicle_meets_walls_and_ends_there(trace):
    assert (trace.outcome != Outcome.RUNNING).all()
    hit = np.nanmin(trace.wall_gap, axis=1) < 0.0
    assert (hit[trace.outcome == Outcome.WALL_COLLISION]).all()
    assert not hit[trace.outcome == Outcome.SUCCESS].any()
    for row in range(len(trace)):
        end = trace.position[row, trace.steps[row], 1:]
        for (x, y), radius in zip(end, trace.radius[row, 0, 1:], strict=True):
            assert wall_gap_in_step(x, y, 0.0, 0.0, radius, trace.obstacles[row]) > -1e-6


@pytest.mark.parametrize("scenario", WALLED)
@pytest.mark.parametrize("planner", ["straight", "orca", "social_force", "ppo"])
def test_planners_drive_among_walls(planner, scenario):
    assert_only_the_vehicle_meets_walls_and_ends_there(drive(planner, "5", fixture(scenario)))


@pytest.mark.parametrize("planner", ["lstm_rl", "sarl_lin", pytest.param("sarl_sgan_seq", marks=pytest.mark.slow)])
def test_learned_planners_drive_among_walls(planner):
    assert_only_the_vehicle_meets_walls_and_ends_there(drive(planner, "1", fixture("blind_corner")))


@pytest.mark.slow
@pytest.mark.parametrize("pedestrians", ["orca", "social_force"])
def test_pedestrians_reach_their_goals_among_walls(pedestrians):
    scenario = load_scenario(fixture("room"), {"time_limit": 60.0}, pedestrians=pedestrians)
    world = scenario.worlds(Cases.parse("20"))
    for _ in range(200):
        world, _ = step(world, np.zeros((20, 2)), crowd_velocities(world, scenario.policies))
    arrived = norm(world.position - world.goal)[:, 1:] < world.radius[:, 1:]
    assert arrived.mean() > 0.85


def test_straight_never_slows_down():
    trace = drive("straight", "5", fixture("blind_corner"))
    for row, steps in enumerate(trace.steps):
        assert norm(trace.velocity[row, 1 : steps + 1, 0]) == pytest.approx(1.0)


def test_spl_and_sct_take_the_way_round_walls():
    trace = drive("straight", "30", fixture("blind_corner"), pedestrians__number=0)
    assert (trace.outcome == Outcome.SUCCESS).all()
    assert ((spl(trace) > 0.97) & (spl(trace) <= 1.0)).all()
    assert (sct(trace) > 0.9).all()
    beeline = norm(trace.goal[:, 0, 0] - trace.position[:, 0, 0])
    assert (beeline < 0.95 * trace.steps * trace.rules.dt).all()


def test_a_door_without_people_can_be_driven_through():
    trace = drive("straight", "3", "door_10", pedestrians__number=0)
    assert (trace.outcome == Outcome.SUCCESS).all()
    assert trace.noticed.shape[2] == 0


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["orca", "social_force", "ppo"])
def test_a_unicycle_that_follows_velocities_stops_in_front_of_walls(planner):
    trace = drive(planner, "10", fixture("doorway"), vehicle__dynamics="unicycle")
    assert_only_the_vehicle_meets_walls_and_ends_there(trace)
    assert not (trace.outcome == Outcome.WALL_COLLISION).any()


@pytest.mark.slow
def test_a_lookahead_of_a_unicycle_foresees_where_it_could_not_stop():
    trace = drive("sarl_lin", "10", fixture("doorway"), vehicle__dynamics="unicycle")
    assert_only_the_vehicle_meets_walls_and_ends_there(trace)
    assert (trace.outcome == Outcome.WALL_COLLISION).mean() <= 0.2
