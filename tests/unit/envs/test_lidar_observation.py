"""The observation `lidar` in every environment and in planners: an agent's own numbers and the ranges of a scan."""

import gymnasium
import numpy as np
import pytest
from helpers import world

from crowdbench.catalog import load_scenario
from crowdbench.core.types import Lidar, Rules, Sensor
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.stable_baselines import CrowdVecEnv
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.planners.policy_planner import PolicyPlanner
from crowdbench.scenario.cases import Cases
from crowdbench.sim.lidar import DEFAULT_LIDAR, scan
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import InputError
from crowdbench.views.scans import OWN_NUMBERS, lidar_features, lidar_features_of_all

CASE = {"case": "val/3"}
NOISY = {"beams": 40, "range": 6.0, "legs": True, "noise": 0.05, "dropout": 0.05, "false_returns": 0.05}
STEPS = 6


@pytest.mark.parametrize("sensor", [{}, {"sensor.lidar": NOISY}])
def test_all_environments_and_planners_observe_the_same_numbers(sensor):
    scenario = load_scenario("door_10", sensor)
    one, many = VehicleEnv(scenario, observation="lidar"), VehicleVectorEnv(2, scenario, observation="lidar")
    people = parallel_env(scenario, observation="lidar")
    received = []
    planner = PolicyPlanner(lambda seen: received.append(seen) or np.zeros((len(seen), 2)), "lidar", "normalized")
    first = one.reset(options=CASE)[0]
    both = many.reset(options={"case": ["val/3", "val/4"]})[0]
    alike = people.reset(options=CASE)[0]
    for _ in range(STEPS):
        planner.plan(observe(one._world))
        for seen in (both[0], alike["vehicle"], received[-1][0].astype(np.float32)):
            np.testing.assert_array_equal(seen, first)
        assert first.dtype == np.float32
        assert first in one.observation_space
        assert all(alike[agent] in people.observation_space(agent) for agent in people.agents)
        action = np.array([0.5, 0.2], np.float32)
        first = one.step(action)[0]
        both = many.step(np.tile(action, (2, 1)))[0]
        alike = people.step({"vehicle": action})[0]


def test_without_a_lidar_in_the_scenario_there_are_180_beams_of_10_m():
    env = VehicleEnv(observation="lidar")
    assert env.observation_space.shape == (OWN_NUMBERS + 180,)
    assert env.observation_space.high[OWN_NUMBERS:] == pytest.approx(10.0)
    assert CrowdVecEnv(2, observation="lidar").observation_space == env.observation_space
    made = gymnasium.make("crowdbench/Vehicle-v0", observation="lidar")
    assert made.reset(seed=0)[0] in made.observation_space


def test_own_numbers_are_relative_to_the_heading():
    made = world([[1.0, 2.0], [1.0, 5.0]], [[0.0, 0.5], [0.3, 0.0]], [[-2.0, 2.0], [1.0, 9.0]])
    made = made.replace(heading=np.array([np.pi / 2]), angular_speed=np.array([0.7]))
    own = lidar_features(observe(made))[0, :OWN_NUMBERS]
    assert own == pytest.approx([3.0, 0.0, 1.0, 0.5, 0.0, 0.7, 0.3, 1.0])
    assert lidar_features(observe(made))[0, OWN_NUMBERS] == pytest.approx(2.7)
    pedestrian = lidar_features_of_all(made)[1, :OWN_NUMBERS]
    assert pedestrian == pytest.approx([4.0, 0.0, 1.0, 0.3, 0.0, 0.0, 0.3, 1.0])


@pytest.mark.parametrize("observation", ["lidar", "dict"])
def test_every_agent_observes_its_scan_with_the_lidar_of_the_scenario(observation):
    scenario = load_scenario("car_28", {"vehicle.visible": True, "sensor.lidar": NOISY})
    env = parallel_env(scenario, observation=observation, dtype="float64")
    seen, _ = env.reset(options=CASE)
    seen, *_ = env.step({"vehicle": np.array([0.5, 0.1])})
    expected = scan(env._world, Lidar(**NOISY), env._world.radius.shape[1])[0]
    for column, agent in enumerate(env.possible_agents):
        if agent in env.agents:
            ranges = seen[agent]["lidar"] if observation == "dict" else seen[agent][OWN_NUMBERS:]
            np.testing.assert_array_equal(ranges, expected[column])


def test_people_who_are_out_of_reach_or_hidden_change_no_number():
    wall = np.array([[[[2.0, -5.0], [2.0, 5.0]]]])
    rules = Rules(sensor=Sensor(lidar=Lidar(beams=90, range=4.0)))
    made = [
        world([[0.0, 0.0], [3.0, y], [far, 9.0]], rules=rules).replace(obstacles=wall)
        for y, far in ((0.0, -8.0), (1.0, 6.0))
    ]
    near, other = (lidar_features(observe(one)) for one in made)
    np.testing.assert_array_equal(near, other)


def test_agents_that_observe_few_others_scan_all_of_them():
    scenario = load_scenario("circle_crossing_10", {"sensor.nearest": 2})
    env = parallel_env(scenario, observation="lidar", dtype="float64")
    seen, _ = env.reset(options=CASE)
    everybody = scenario.worlds(Cases("val", 3, 4))
    expected = scan(everybody, DEFAULT_LIDAR, 3)[0]
    np.testing.assert_array_equal(seen["pedestrian_1"][OWN_NUMBERS:], expected[2])


@pytest.mark.parametrize("options", [{"rays": 8}, {"nearest": 3}, {"rays": 10**9}, {"nearest": 10**9}])
@pytest.mark.parametrize("make", [VehicleEnv, parallel_env])
def test_rays_and_nearest_are_refused_with_a_scan(make, options):
    with pytest.raises(InputError, match="where the observation is"):
        make(observation="lidar", **options)
