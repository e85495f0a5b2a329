"""Each view, reward and action of the environments, in crowds of 0, 1 and many, among walls and cars."""

import gymnasium
import numpy as np
import pytest

from crowdbench import load_scenario
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.rewards import REWARDS
from crowdbench.views.actions import ACTIONS
from crowdbench.views.view import OBSERVATIONS

WORLDS = {
    "nobody": ("circle_crossing_5", {"pedestrians.number": 0}),
    "one": ("circle_crossing_5", {"pedestrians.number": 1}),
    "hidden vehicle": ("circle_crossing_5", {"vehicle.visible": False}),
    "nobody among walls": ("door_10", {"pedestrians.number": 0}),
    "walls": ("door_10", {}),
    "a car": ("car_28", {}),
    "groups": ("groups_12", {}),
    "limited sight": ("corner_5", {}),
    "recorded": ("eth_recorded", {}),
}


CHOICES = [
    *({"observation": observation} for observation in OBSERVATIONS),
    *({"observation": observation, "rays": 8} for observation in ("goal_frame", "dict")),
    *({"action": action} for action in ACTIONS),
    *({"reward": reward} for reward in REWARDS.built_in()),
    *({"observation": observation, "dtype": "float64"} for observation in OBSERVATIONS),
]
"""Each observation, action and reward once, with defaults for the others."""


@pytest.fixture(params=WORLDS, scope="module")
def scenario(request):
    name, overrides = WORLDS[request.param]
    data = request.getfixturevalue("shared") / "data" / "eth_ucy" if name == "eth_recorded" else None
    return load_scenario(name, overrides, data=data)


def steps(env, number=3):
    """Step an environment with random actions, and return what it returned."""
    env.action_space.seed(0)
    return [env.step(env.action_space.sample()) for _ in range(number)]


@pytest.mark.parametrize("choice", [choice for choice in CHOICES], ids=str)
def test_every_agent_observes_and_is_rewarded(scenario, choice):
    env = parallel_env(scenario, **choice)
    observations, _ = env.reset(seed=0)
    for _ in range(3):
        for agent, observed in observations.items():
            assert env.observation_space(agent).contains(observed)
            assert all(
                np.isfinite(part).all() for part in (observed.values() if isinstance(observed, dict) else [observed])
            )
        observations, rewards, *_ = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        assert np.isfinite(list(rewards.values())).all()


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_the_vehicle_observes_and_is_rewarded(scenario, choice):
    options = {"scenario": scenario, **choice}
    with gymnasium.make("crowdbench/Vehicle-v0", **options) as env:
        observed, _ = env.reset(seed=0)
        assert env.observation_space.contains(observed)
        for observed, given, *_ in steps(env):
            assert env.observation_space.contains(observed)
            assert np.isfinite(given)
    envs = gymnasium.make_vec("crowdbench/Vehicle-v0", num_envs=2, vectorization_mode="vector_entry_point", **options)
    observed, _ = envs.reset(seed=0)
    assert envs.observation_space.contains(observed)
    for observed, given, *_ in steps(envs):
        assert envs.observation_space.contains(observed)
        assert np.isfinite(given).all()
    envs.close()
