"""Several vehicles as agents of the PettingZoo environment."""

import warnings

import numpy as np
import pytest

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Outcome
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

with warnings.catch_warnings():  # of PettingZoo's own modules
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import parallel_api_test, parallel_seed_test


@pytest.mark.parametrize("observation", ["flat", "goal_frame", "dict", "lidar"])
def test_four_vehicles_and_twelve_pedestrians_pass_pettingzoos_tests(observation):
    parallel_api_test(parallel_env("fleet_4", observation=observation), num_cycles=60)


def test_the_same_seed_gives_the_same_episodes():
    parallel_seed_test(lambda: parallel_env("fleet_4"), num_cycles=60)


@pytest.mark.parametrize("name", ["fleet_4", "fleet_door_3"])
def test_the_vehicles_drive_as_in_a_rollout(name):
    scenario = load_scenario(name)
    trace = rollout(Driver(load_planner("straight"), "straight"), scenario, Cases("test", 2, 3))
    env = parallel_env(scenario, action="native", dtype="float64")
    env.reset(options={"case": "test/2"})
    ends, t = {}, 0
    while env.agents:
        driven = [agent for agent in env.agents if agent.startswith("vehicle")]
        numbers = {agent: int(agent.removeprefix("vehicle_")) for agent in driven}
        state = env.state().reshape(-1, 10)
        for number in numbers.values():
            assert np.array_equal(state[number, :2], trace.position[number, t, 0])
        _, _, terminated, truncated, infos = env.step({agent: trace.command[k, t] for agent, k in numbers.items()})
        t += 1
        for agent, k in numbers.items():
            if terminated[agent] or truncated[agent]:
                ends[k] = infos[agent]["outcome"], t
                assert truncated[agent] == (infos[agent]["outcome"] == Outcome.TIMEOUT)
    assert ends == {k: (trace.outcome[k], trace.steps[k]) for k in range(len(trace))}


def test_each_vehicle_observes_its_own_view_and_the_state_shows_all():
    env = parallel_env("fleet_4", dtype="float64")
    observations, _ = env.reset(options={"case": "test/0"})
    world, state = load_scenario("fleet_4").worlds(Cases("test", 0, 1)), env.state().reshape(-1, 10)
    assert state.shape == (16, 10)
    for k in range(4):
        own = observations[f"vehicle_{k}"]
        assert np.array_equal(own[:2], world.goal[k, 0] - world.position[k, 0])
        assert np.array_equal(own[6:8], world.position[1 if k == 0 else 0, 0] - world.position[k, 0])
        assert state[k, 8] == pytest.approx(world.heading[k])
    assert np.array_equal(observations["pedestrian_0"][6:8], world.position[0, 0] - world.position[0, 4])


def test_every_vehicle_that_drives_must_act():
    env = parallel_env("fleet_4")
    env.reset(options={"case": "test/0"})
    with pytest.raises(InputError, match="one for vehicle_0, vehicle_1, vehicle_2, vehicle_3"):
        env.step({"vehicle_0": np.zeros(2)})


def test_environments_of_one_vehicle_refuse_several():
    with pytest.raises(InputError, match="fleet_4 has 4 vehicles: use"):
        VehicleEnv("fleet_4")
