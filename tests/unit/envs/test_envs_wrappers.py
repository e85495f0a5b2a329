"""The registries and wrappers of Gymnasium, PettingZoo and SuperSuit."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RecordVideo
from pettingzoo.utils import aec_to_parallel, parallel_to_aec
from pettingzoo.utils.wrappers import RecordVideoParallel

from crowdbench import InputError, load_scenario, parallel_env
from crowdbench.core.geometry import wrap_angle
from crowdbench.core.types import Outcome
from crowdbench.envs.registration import CROWD, VEHICLE
from crowdbench.views.actions import ACTIONS

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test, state_test

SCENARIOS = ["circle_crossing_5", "door_10", "mixed_20", "car_28"]


@pytest.fixture(params=[*SCENARIOS, "eth_recorded"], scope="module")
def scenario(request):
    data = request.getfixturevalue("shared") / "data" / "eth_ucy" if request.param == "eth_recorded" else None
    return load_scenario(request.param, data=data)


def samples(env):
    return {agent: env.action_space(agent).sample() for agent in env.agents}


def test_pettingzoo_makes_it_by_its_id():
    code = (
        "import crowdbench, pettingzoo\n"
        f"env = pettingzoo.make('parallel', '{CROWD}', scenario='door_10', max_cycles=3)\n"
        "print(type(env).__name__, len(env.possible_agents), env.metadata['name'])\n"
        f"print(pettingzoo.make('aec', '{CROWD}').possible_agents[0])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines() == ["CrowdParallelEnv 11 crowdbench_v0", "vehicle"]


def test_an_episode_is_truncated_after_its_largest_number_of_steps():
    for env in (pettingzoo.make("parallel", CROWD, max_cycles=3), parallel_env(max_episode_steps=3)):
        env.reset(seed=0)
        for number in range(3):
            *_, terminated, truncated, infos = env.step(samples(env))
            assert set(truncated.values()) == {number == 2}
        assert not any(terminated.values())
        assert infos["vehicle"]["outcome"] == Outcome.RUNNING
        assert env.agents == []


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("kind", ["vector_entry_point", "sync"])
def test_every_vector_environment_truncates_after_the_largest_number_of_steps(kind, mode):
    options = {"autoreset_mode": mode} if kind != "sync" else {"vector_kwargs": {"autoreset_mode": mode}}
    envs = gymnasium.make_vec(VEHICLE, num_envs=2, max_episode_steps=5, vectorization_mode=kind, **options)
    envs.reset(seed=0)
    ends = []
    for _ in range(5):
        _, _, terminated, truncated, infos = envs.step(np.zeros((2, 2), np.float32))
        ends.append([terminated.any(), truncated.all()])
    assert ends == [[False, False]] * 4 + [[False, True]]
    assert ("final_obs" in infos) == (mode == AutoresetMode.SAME_STEP)
    envs.close()


def test_one_environment_truncates_after_the_largest_number_of_steps():
    env = gymnasium.make(VEHICLE, max_episode_steps=5)
    env.reset(seed=0)
    assert [env.step(np.zeros(2, np.float32))[3] for _ in range(5)] == [False] * 4 + [True]


@pytest.mark.parametrize("steps", [0, -1, 1.5, True, "5"])
def test_a_largest_number_of_steps_that_is_no_count_is_refused(steps):
    for make in (parallel_env, lambda **options: gymnasium.make_vec(VEHICLE, num_envs=2, **options)):
        with pytest.raises(InputError, match=r"max_episode_steps is .*, but must be a whole number, 1 or more"):
            make(max_episode_steps=steps)


def test_the_state_lists_every_agent(scenario):
    env = parallel_env(scenario)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.state()
    env.reset(seed=3)
    for _ in range(3):
        assert env.state_space.contains(env.state())
        env.step({"vehicle": np.array([0.3, 0.4])})
    world, rows = env._world, env.state().reshape(-1, 10)
    assert rows.dtype == np.float32
    present = world.present[0]
    expected = [world.position[0], world.velocity[0], world.radius[0, :, None], world.goal[0]]
    found = np.split(rows[present, :7], [2, 4, 5], axis=1)
    for part, value in zip(found, expected, strict=True):
        np.testing.assert_array_equal(part, value[present].astype(np.float32))
    np.testing.assert_array_equal(rows[present, 7], world.preferred_speed[0, present].astype(np.float32))
    assert rows[0, 8] == np.float32(wrap_angle(world.heading)[0])
    np.testing.assert_array_equal(rows[:, 9], present)
    assert not rows[~present].any()


def test_pettingzoos_test_of_the_state_passes():
    state_test(parallel_to_aec(parallel_env("door_10")), parallel_env("door_10"))


@pytest.mark.filterwarnings("ignore:We recommend agents to be named")
@pytest.mark.filterwarnings("ignore:Observation numpy array is all zeros")  # of a pedestrian that has left
def test_agents_act_in_turns_as_they_act_together(scenario):
    api_test(pettingzoo.make("aec", CROWD, scenario=scenario), num_cycles=60)
    ours, theirs = parallel_env(scenario), aec_to_parallel(parallel_to_aec(parallel_env(scenario)))
    seen, other = (env.reset(seed=2)[0] for env in (ours, theirs))
    for _ in range(8):
        for agent, row in seen.items():
            np.testing.assert_array_equal(row, other[agent])
        actions = samples(ours)
        seen, other = ours.step(actions)[0], theirs.step(actions)[0]


@pytest.mark.parametrize("action", ACTIONS)
def test_the_spaces_of_all_agents_are_the_same(scenario, action):
    env = parallel_env(scenario, action=action)
    observations = [env.observation_space(agent) for agent in env.possible_agents]
    assert all(space == observations[0] for space in observations)
    assert observations[0].dtype == np.float32
    actions = [env.action_space(agent) for agent in env.possible_agents]
    if ACTIONS[action].normalized:
        assert set(map(str, actions)) == {"Box(-1.0, 1.0, (2,), float32)"}
    assert all(space.dtype == np.float32 for space in actions)


@pytest.mark.filterwarnings("ignore")
def test_the_vector_wrappers_of_supersuit_work(scenario):
    supersuit = pytest.importorskip("supersuit", reason="pip install supersuit")
    single = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(parallel_env(scenario)))
    envs = supersuit.concat_vec_envs_v1(single, 2, num_cpus=1, base_class="gymnasium")
    shown, _ = envs.reset(seed=0)
    for _ in range(30):
        assert all(envs.observation_space.contains(row) for row in shown)
        shown, rewards, *_ = envs.step(np.stack([envs.action_space.sample() for _ in shown]))
    assert rewards.shape == (2 * len(parallel_env(scenario).possible_agents),)


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_a_normalized_action_is_a_share_of_the_agents_own_speed(scale):
    env = parallel_env(load_scenario("mixed_20", {"pedestrians.limits": None}))
    env.reset(seed=4)
    env.step({agent: np.array([0.0, scale]) for agent in env.agents})
    world = env._world
    np.testing.assert_allclose(world.velocity[0, :, 1], min(scale, 1.0) * world.preferred_speed[0], rtol=1e-12)


def test_a_normalized_native_action_covers_the_commands_of_the_dynamics():
    many = {"scenario": "car_28", "action": "normalized_native"}, {"scenario": "car_28", "action": "native"}
    one, other = (parallel_env(**options) for options in many)
    low, high = other.action_space("vehicle").low, other.action_space("vehicle").high
    for env in (one, other):
        env.reset(options={"case": "val/3"})
    for share in (np.array([1.0, 1.0]), np.array([-1.0, 0.0]), np.array([0.5, -0.5])):
        speed = one._world.preferred_speed[0, 1]
        one.step({"vehicle": share, "pedestrian_0": share / 2})
        other.step({"vehicle": (low + high) / 2 + share * (high - low) / 2, "pedestrian_0": share / 2 * speed})
        np.testing.assert_allclose(one._world.position, other._world.position, atol=1e-6)


def test_pedestrians_have_the_lidar_of_the_vehicle():
    env = parallel_env(load_scenario("door_10", {"sensor.lidar": {"beams": 9, "range": 5.0}}), observation="dict")
    parallel_api_test(env, num_cycles=10)
    seen, _ = env.reset(seed=0)
    assert {row["lidar"].shape for row in seen.values()} == {(9,)}
    assert min(row["lidar"].min() for row in seen.values()) < 5.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:invalid escape sequence")  # when moviepy is compiled
def test_videos_are_recorded(tmp_path):
    pytest.importorskip("moviepy", reason="pip install 'crowdbench[video]'")
    one = RecordVideo(gymnasium.make(VEHICLE, render_mode="rgb_array", max_episode_steps=3), str(tmp_path / "one"))
    one.reset(seed=0)
    for _ in range(3):
        one.step(one.action_space.sample())
    one.close()
    many = RecordVideoParallel(parallel_env(render_mode="rgb_array", max_episode_steps=3), str(tmp_path / "many"))
    many.reset(seed=0)
    while many.agents:
        many.step(samples(many))
    many.close()
    for kind in ("one", "many"):
        (film,) = (tmp_path / kind).glob("*.mp4")
        assert film.stat().st_size > 1000
