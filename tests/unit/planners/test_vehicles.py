"""Vehicles on wheels in the simulator: scenarios, rollouts, planners, recordings."""

import math

import numpy as np
import pytest
from helpers import advance, check_step, drive, same, world

from crowdbench.catalog import load_scenario
from crowdbench.core.dynamics import Bicycle, State, Unicycle, chain, hull
from crowdbench.core.geometry import wrap_angle
from crowdbench.core.types import Outcome, Rules
from crowdbench.envs.step_outcomes import outcomes_of_agents
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.planners.reactive import along_walls
from crowdbench.planners.scene import scene_of
from crowdbench.planners.trials import propagate_vehicle, try_commands, try_sequences
from crowdbench.predict.predictor import Prediction
from crowdbench.results.stored_tracks import read_tracks, write_tracks
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.sim.pedestrians import ORCA
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.utils.errors import InputError

UNICYCLE = {"vehicle__dynamics": "unicycle"}
CAR = {"vehicle__dynamics": "bicycle", "vehicle__radius": 0.9, "vehicle__length": 4.5, "layout__circle_radius": 12.0}


class Native(Planner):
    """Gives one command, always."""

    native = True

    def __init__(self, *command):
        self.command = command

    def plan(self, obs):
        return np.tile(np.array(self.command, float), (len(obs), 1))


def moved(rules, command, position=((0.0, 0.0), (9.0, 9.0)), velocity=None, goal=None):
    """A world before and after a step in which the vehicle gets a command and the pedestrians stand."""
    before = world(position, velocity, goal, rules=rules)
    commands = np.zeros((1, len(position), 2))
    commands[0, 0] = command
    return before, advance(before, commands)


def test_the_simulator_drives_by_the_dynamics():
    unicycle = Unicycle(1.0, 1.5, 4.0)
    before, after = moved(Rules(dynamics=unicycle), (0.8, -1.2), velocity=((0.5, 0.0), (0.0, 0.0)))
    state = State(before.position[:, 0], before.velocity[:, 0], before.heading, before.angular_speed)
    expected = unicycle.step(state, np.array([[0.8, -1.2]]), np.ones(1), before.rules.dt)
    found = State(after.position[:, 0], after.velocity[:, 0], after.heading, after.angular_speed)
    assert all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))
    assert found.angular_speed[0] == -1.0
    assert found.speed[0] == pytest.approx(0.75)


def test_a_pedestrian_inside_the_arc_is_missed_by_its_chord_and_hit_by_the_vehicle():
    # Half a turn to the left in a step, radius 1 m: the arc bulges to x = 1, its chord is on the y axis.
    rules = Rules(dt=0.9, dynamics=Unicycle(99.0, math.pi / 0.9, 99.0))
    before, after = moved(rules, (math.pi / 0.9, math.pi / 0.9), ((0.0, 0.0), (1.5, 1.0)))
    before = before.replace(preferred_speed=np.full((1, 2), 9.0))
    after = advance(before, np.array([[[math.pi / 0.9, math.pi / 0.9], [0.0, 0.0]]]))
    assert after.position[0, 0] == pytest.approx([0.0, 2.0], abs=1e-9)
    outcome, gap, _ = check_step(before, after)
    assert outcome[0] == Outcome.COLLISION
    assert gap[0] == pytest.approx(0.5 - 0.6, abs=1e-3)


def test_the_gap_of_a_long_vehicle_is_the_least_over_its_discs():
    rules = Rules(dynamics=Unicycle(), body=chain(2.0, 0.3, 0.0))
    for place, gap in (((1.5, 0.0), 0.2), ((0.0, 1.0), 0.4), ((-1.5, 0.0), 0.2), ((0.5, -0.8), 0.2)):
        before, after = moved(rules, (0.0, 0.0), ((0.0, 0.0), place))
        assert check_step(before, after).gap[0] == pytest.approx(gap, abs=0.02)


def test_the_corner_of_a_turning_car_hits_a_wall():
    rules = Rules(dynamics=Unicycle(2.0, 2.0, 99.0), body=chain(2.0, 0.3, 0.0))
    wall = np.array([[[[-5.0, 0.45], [5.0, 0.45]]]])
    for turn_rate, expected in ((0.0, Outcome.RUNNING), (1.5, Outcome.WALL_COLLISION)):
        before, after = moved(rules, (0.0, turn_rate))
        check = check_step(before.replace(obstacles=wall), after)
        assert check.outcome[0] == expected
    # The centre of its front disc is 0.7 m ahead.
    assert check.wall_gap[0] == pytest.approx(0.45 - 0.7 * math.sin(1.5 * 0.25) - 0.3, abs=1e-3)


def test_the_goal_is_reached_within_its_tolerance():
    goal = ((0.75, 0.0), (9.0, 9.0))
    for tolerance, expected in ((None, Outcome.RUNNING), (0.8, Outcome.SUCCESS), (0.2, Outcome.RUNNING)):
        before, after = moved(Rules(goal_tolerance=tolerance), (0.2, 0.0), goal=goal)
        assert check_step(before, after).outcome[0] == expected


def test_discs_cover_a_rectangle_but_for_its_corners():
    body = chain(4.5, 0.9, 1.35)
    assert (body[0] - 0.9, body[-1] + 0.9) == pytest.approx((1.35 - 2.25, 1.35 + 2.25))
    # Between two discs the side of the body is no more than 3.2 % of the radius further in.
    assert 0.9 - math.sqrt(0.9**2 - max(np.diff(body)) ** 2 / 4) < 0.032 * 0.9
    centre, radius = hull(body, np.zeros((1, 2)), np.array([math.pi / 2]), np.array([0.9]))
    assert centre[0] == pytest.approx([0.0, 1.35])
    assert radius[0] == pytest.approx(2.25)


def test_pedestrians_see_a_long_vehicle_as_the_disc_around_it():
    place, goal = ((0.0, 0.0), (4.0, 0.2)), ((9.0, 0.0), (-9.0, 0.2))
    asked = []
    for body in ((0.0,), chain(4.5, 0.9, 1.35)):
        before = world(place, ((0.0, 0.0), (-1.0, 0.0)), goal, rules=Rules(visible=True, dynamics=Bicycle(), body=body))
        asked.append(crowd_velocities(before, {"orca": ORCA()})[0, 0])
    assert asked[0][0] < -0.98
    assert asked[1][0] > -0.9


def test_nobody_starts_inside_a_long_vehicle():
    place = load_scenario("circle_crossing_5", {key.replace("__", "."): value for key, value in CAR.items()})
    worlds = place.draw("test", np.arange(20))
    body = np.array(place.rules.body)
    direction = np.stack([np.cos(worlds.heading), np.sin(worlds.heading)], axis=1)
    discs = worlds.position[:, None, 0] + body[:, None] * direction[:, None]
    apart = np.linalg.norm(discs[:, :, None] - worlds.position[:, None, 1:], axis=3) - 0.9 - worlds.radius[:, None, 1:]
    assert apart.min() > 0.0


@pytest.mark.parametrize("planner", ["orca", "social_force", "straight"])
@pytest.mark.parametrize("vehicle", [UNICYCLE, CAR])
def test_planners_that_think_in_velocities_drive_every_vehicle(planner, vehicle):
    trace = drive(planner, "5", **vehicle)
    assert (trace.outcome != Outcome.RUNNING).all()
    speed = np.linalg.norm(trace.velocity[:, :, 0], axis=2)
    facing = np.stack([np.cos(trace.heading), np.sin(trace.heading)], axis=2) * speed[..., None]
    assert np.allclose(facing, trace.velocity[:, :, 0], equal_nan=True)


def test_who_heads_for_a_goal_behind_turns_and_arrives():
    trace = drive("straight", "3", pedestrians__number=0, **UNICYCLE)
    assert (trace.outcome == Outcome.SUCCESS).all()
    scenario = load_scenario("circle_crossing_5", {"vehicle.dynamics": "unicycle", "pedestrians.number": 0})
    start = scenario.draw("test", np.arange(2))
    now = start.replace(heading=start.heading + math.pi)
    planner = Driver(drive_to_goal(), "mine")
    planner.reset(now.case)
    for _ in range(90):
        after = advance(now, planner.decide(observe(now))[:, None])
        if (check_step(now, after).outcome == Outcome.SUCCESS).all():
            return
        now = after
    pytest.fail("it never arrived")


def drive_to_goal():
    class ToGoal(Planner):
        def plan(self, obs):
            way = obs.vehicle.goal - obs.vehicle.position
            return way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1.0)

    return ToGoal()


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ((0.5, 2.5), "asked for 2.5 rad/s, but its max_angular_speed is 2 rad/s (case 0, step 0)"),
        ((-0.5, 0.0), "asked for -0.5 m/s, but the vehicle's speeds are 0 to 1 m/s (case 0, step 0)"),
        ((math.nan, 0.0), "returned [nan, 0.0], but a command must be finite (case 0, step 0)"),
    ],
)
def test_a_native_command_beyond_the_limits_is_refused_in_one_sentence(command, expected):
    with pytest.raises(InputError) as error:
        drive(Native(*command), "2", **UNICYCLE)
    assert str(error.value) == f"planner Native {expected}"


def test_native_commands_are_executed_and_kept_in_the_trace():
    trace = drive(Native(0.5, 0.1), "2", pedestrians__number=0, **UNICYCLE)
    assert np.array_equal(trace.command[0, : trace.steps[0]], np.tile([0.5, 0.1], (trace.steps[0], 1)))
    assert trace.heading[0, 10] - trace.heading[0, 0] == pytest.approx(10 * 0.25 * 0.1)


def test_velocities_ahead_are_followed_step_by_step():
    class Turn(Planner):
        def plan(self, obs):
            return self.plan_ahead(obs, 1)[:, 0]

        def plan_ahead(self, obs, steps):
            return np.tile([-0.5, 0.5], (len(obs), steps, 1))

    one = drive(Turn(), "2", pedestrians__number=0, **UNICYCLE)
    ahead = drive(Turn(), "2", pedestrians__number=0, replan_every=8, **UNICYCLE)
    assert same(one, ahead)


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["sarl_cvm", "ppo", "sarl_sgan_kce"])
def test_learned_planners_drive_a_unicycle_to_an_end(planner):
    trace = drive(planner, "3", **UNICYCLE)
    assert (trace.outcome != Outcome.RUNNING).all()
    turn = np.abs(wrap_angle(np.diff(trace.heading, axis=1)))
    assert np.nanmax(turn) <= 2.0 * 0.25 + 1e-9


@pytest.mark.parametrize("vehicle", [UNICYCLE, CAR])
def test_a_lookahead_foresees_what_the_simulator_does(vehicle):
    place = load_scenario("circle_crossing_5", {key.replace("__", "."): value for key, value in vehicle.items()})
    now = place.draw("val", np.arange(4))
    for _ in range(5):
        command = place.rules.dynamics.space(now.preferred_speed[:, 0])[1] * 0.6
        walks = crowd_velocities(now, place.policies)
        after, check = step(now, command, walks)
        obs = observe(now)
        ahead = Prediction(after.position[:, None, None, 1:], after.velocity[:, None, None, 1:])
        tried = try_commands(scene_of(obs, ahead, 0, obs.vehicle), command, np.arange(4))
        assert tried.gap[:, 0] == pytest.approx(check.gap, abs=1e-12)
        assert tried.outcome[:, 0].tolist() == check.outcome.tolist()
        assert np.array_equal(tried.velocity, after.velocity[:, 0])
        assert np.array_equal(propagate_vehicle(obs.vehicle, command, obs).position, after.position[:, 0])
        now = after


def test_sequences_are_rolled_by_the_dynamics():
    place = load_scenario("circle_crossing_5", {"vehicle.dynamics": "unicycle", "pedestrians.number": 0})
    now = start = place.draw("val", np.arange(2))
    commands = np.random.default_rng(1).uniform([0.0, -2.0], [1.0, 2.0], (2, 1, 6, 2))
    obs = observe(start)
    nobody = Prediction(np.zeros((2, 1, 6, 0, 2)), np.zeros((2, 1, 6, 0, 2)))
    motion = try_sequences(scene_of(obs, nobody, 0, obs.vehicle, 6), commands, np.zeros((1, 1, 1))).motion
    for t in range(6):
        now = advance(now, commands[:, 0, t][:, None])
        assert np.array_equal(motion[:, 0, t + 1, :2], now.position[:, 0])
        assert np.array_equal(motion[:, 0, t + 1, 4], now.heading)


def test_a_pedestrian_is_checked_against_the_whole_body_of_a_vehicle_that_it_sees():
    rules = Rules(visible=True, dynamics=Unicycle(), body=chain(2.0, 0.3, 0.0))
    before, after = moved(rules, (0.0, 0.0), ((0.0, 0.0), (1.5, 0.0), (9.0, 9.0)))
    _, gaps = outcomes_of_agents(before, after, check_step(before, after))
    assert gaps[:2] == pytest.approx([0.2, 0.2])


def test_stored_tracks_of_a_vehicle_have_its_dynamics_its_body_and_its_tolerance(tmp_path):
    trace = drive("orca", "2", vehicle__goal_tolerance=1.0, **CAR)
    write_tracks(trace, tmp_path / "tracks.parquet")
    found = read_tracks(tmp_path / "tracks.parquet")
    assert found.rules == trace.rules
    assert same(found, trace)


class Wandering(Planner):
    """Gives a direction for a second, then another one, corrected along walls."""

    def plan(self, obs):
        seconds = np.broadcast_to(obs.time, len(obs)).astype(int)
        angle = [np.random.default_rng(key).uniform(-3.0, 3.0) for key in zip(obs.row, seconds, strict=True)]
        return along_walls(obs, obs.vehicle.preferred_speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", [0.5, 1.0])
def test_no_vehicle_on_wheels_drives_into_a_wall_whatever_velocities_are_wanted(acceleration):
    overrides = {"pedestrians.number": 0, "vehicle.max_acceleration": acceleration}
    trace = rollout(Driver(Wandering(), "wandering"), load_scenario("door_10", overrides), Cases("val", 0, 60))
    assert trace.gap.shape[1] > 100
    assert (trace.outcome != Outcome.WALL_COLLISION).all()
