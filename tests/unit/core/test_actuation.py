"""Delay and lag of the vehicle's actuators, and wheels that drive backwards, in whole episodes."""

import math

import numpy as np
import pytest

import crowdbench
from crowdbench.catalog import load_scenario
from crowdbench.envs.compiled_step import CompiledStep
from crowdbench.envs.parallel import parallel_env
from crowdbench.scenario.cases import Cases
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.utils.errors import InputError

WHEELS = {"vehicle.dynamics": "unicycle", "vehicle.max_acceleration": 100.0}


def driven(changes, command, steps=6, name="circle_crossing_5"):
    """The worlds after each of some steps with the same command, from the start on."""
    scenario = load_scenario(name, {"vehicle.preferred_speed": 2.0} | changes)
    worlds = [scenario.worlds(Cases.parse("val:3"))]
    for _ in range(steps):
        crowd = crowd_velocities(worlds[-1], scenario.policies)
        worlds.append(step(worlds[-1], np.tile(command, (3, 1)).astype(float), crowd)[0])
    return worlds


def velocities(worlds):
    return np.array([world.velocity[0, 0] for world in worlds[1:]])


def test_a_command_acts_after_its_delay():
    late, direct = (velocities(driven(changes, [0.3, 0.4])) for changes in ({"vehicle.command_delay": 0.5}, {}))
    assert late[:2].tolist() == [[0.0, 0.0], [0.0, 0.0]]
    np.testing.assert_array_equal(late[2:], direct[:4])


def test_a_command_is_approached_as_by_a_first_order_system():
    moved = velocities(driven({"vehicle.lag": 0.4}, [0.6, -0.8]))
    expected = 1.0 - np.exp(-0.25 * np.arange(1, 7) / 0.4)
    np.testing.assert_allclose(moved, expected[:, None] * [0.6, -0.8], rtol=1e-12)


def test_a_lag_smooths_speed_and_turn_rate_of_wheels():
    worlds = driven(WHEELS | {"vehicle.lag": 0.4, "vehicle.command_delay": 0.25}, [0.5, 1.0])
    share = np.concatenate([[0.0], 1.0 - np.exp(-0.25 * np.arange(1, 6) / 0.4)])
    assert [world.angular_speed[1] for world in worlds[1:]] == pytest.approx(share)
    assert [math.hypot(*world.velocity[1, 0]) for world in worlds[1:]] == pytest.approx(0.5 * share)


@pytest.mark.parametrize("planner", ["orca", "dwa"])
@pytest.mark.parametrize(
    "changes",
    [
        {"vehicle.command_delay": 0.5, "vehicle.lag": 0.3},
        {"vehicle.dynamics": "bicycle", "vehicle.wheelbase": 1.0, "vehicle.max_reverse_speed": 0.5, "vehicle.lag": 0.3},
    ],
)
def test_an_episode_is_the_same_alone_and_in_a_batch(planner, changes):
    scenario = load_scenario("circle_crossing_5", changes)
    batch = crowdbench.rollout(planner, scenario, "val:5").episode(2)
    alone = crowdbench.rollout(planner, scenario, "val/2").episode(0)
    assert alone.steps[0] > 10
    np.testing.assert_array_equal(batch.position, alone.position)
    np.testing.assert_array_equal(batch.command, alone.command)


def test_a_planner_is_told_delay_and_lag():
    class Asking(crowdbench.Planner):
        def plan(self, obs):
            self.told = obs.vehicle.actuation
            return np.zeros((len(obs), 2))

    planner = Asking()
    scenario = load_scenario("circle_crossing_5", {"vehicle.lag": 0.3, "time_limit": 2.0})
    crowdbench.rollout(planner, scenario, "val:1")
    assert planner.told == (0.0, 0.3)


def test_environments_execute_commands_late_too():
    scenario = load_scenario("circle_crossing_5", {"vehicle.command_delay": 0.25})
    env = parallel_env(scenario)
    env.reset(options={"case": "val/0"})
    assert not CompiledStep.fits(env._world, env.view, env.reward)
    for speed in (0.0, 1.0):
        env.step({"vehicle": np.array([1.0, 0.0])})
        assert env._world.velocity[0, 0].tolist() == [speed, 0.0]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"vehicle.command_delay": 0.3}, "vehicle.command_delay is 0.3, but must be a multiple of dt, 0.25 s"),
        ({"vehicle.command_delay": 900.0}, "vehicle.command_delay is 900, but must be 250 s or less, 1000 steps"),
        ({"vehicle.lag": -1.0}, "vehicle.lag"),
        ({"vehicle.lag": math.nan}, "vehicle.lag"),
        ({"vehicle.max_reverse_speed": 1.0}, "vehicle.max_reverse_speed"),
        (WHEELS | {"vehicle.max_reverse_speed": -1.0}, "vehicle.max_reverse_speed"),
    ],
)
def test_impossible_actuators_are_refused_in_one_sentence(changes, expected):
    with pytest.raises(InputError) as error:
        load_scenario("circle_crossing_5", changes)
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


def test_a_pedestrian_behind_is_hit_by_a_vehicle_that_drives_backwards():
    changes = WHEELS | {"vehicle.max_reverse_speed": 2.0}
    scenario = load_scenario("circle_crossing_5", changes)
    world = scenario.worlds(Cases.parse("val/0"))
    behind = world.position.copy()
    way = np.array([math.cos(world.heading[0]), math.sin(world.heading[0])])
    behind[0, 1] = world.position[0, 0] - 0.8 * way
    world = world.replace(position=behind)
    still = np.zeros((1, 5, 2))
    _, check = step(world, np.array([[-1.0, 0.0]]), still)
    assert check.gap[0] == pytest.approx(0.8 - 0.25 - 0.6)
    _, check = step(world, np.array([[1.0, 0.0]]), still)
    assert check.gap[0] == pytest.approx(0.2)
