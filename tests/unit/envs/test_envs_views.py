"""Rewards, observations and actions of environments, and the vector environment for stable-baselines3."""

import sys
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import crowdbench.envs
from crowdbench import InputError, load_scenario, parallel_env
from crowdbench.core.types import Outcome
from crowdbench.envs.rewards import (
    COLLISION,
    PROGRESS,
    SECOND,
    CheckedReward,
    Step,
    crowdnav,
    crowdnav_plus,
    load_reward,
    progress,
    safe_progress,
    scored,
)
from crowdbench.envs.stable_baselines import CrowdVecEnv
from crowdbench.envs.stepping import drive
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.metrics.score import close_seconds
from crowdbench.networks.encoders import make_policy
from crowdbench.networks.features import features
from crowdbench.networks.policy import Seen
from crowdbench.planners.trained_policy import NetworkPlanner, PolicyInterface
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.views.actions import ACTIONS
from crowdbench.views.ego import ego_views
from crowdbench.views.view import OBSERVATIONS, View

ID = "crowdbench/Vehicle-v0"


def worlds(number=6, scenario="circle_crossing_5"):
    return load_scenario(scenario).worlds(Cases("val", 0, number))


def turned(world, angle):
    """The same worlds, turned around the origin."""
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, s], [-s, c]])
    names = ("position", "velocity", "goal", "history")
    return world.replace(**{name: getattr(world, name) @ rotation for name in names})


def test_features_are_the_same_in_a_scene_that_is_turned():
    start = worlds()
    start = start.replace(velocity=np.random.default_rng(0).normal(size=start.velocity.shape))
    one, other = (features(observe(world), 3) for world in (start, turned(start, 2.1)))
    np.testing.assert_allclose(one.vehicle, other.vehicle, atol=1e-12)
    np.testing.assert_allclose(one.pedestrians, other.pedestrians, atol=1e-12)
    np.testing.assert_array_equal(one.which, other.which)


@pytest.mark.parametrize("observation", OBSERVATIONS)
@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.filterwarnings("ignore:.*A Box observation space (minimum|maximum) value is -?infinity.*")
def test_every_view_passes_the_check_of_gymnasium(observation, action):
    env = gymnasium.make(ID, observation=observation, action=action, reward="progress")
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_many_worlds_show_what_one_world_shows(observation):
    options = {"observation": observation, "action": "goal_frame", "reward": "progress"}
    many = gymnasium.make_vec(ID, num_envs=3, **options)
    ones = [gymnasium.make(ID, **options) for _ in range(3)]
    seen, _ = many.reset(seed=5)
    each = [env.reset(seed=5 + row)[0] for row, env in enumerate(ones)]
    actions = np.random.default_rng(0).uniform(-1, 1, (8, 3, 2))
    for action in actions:
        for row in range(3):
            part = {key: value[row] for key, value in seen.items()} if isinstance(seen, dict) else seen[row]
            for name in part if isinstance(part, dict) else [...]:
                np.testing.assert_array_equal(part[name], each[row][name])
        seen, rewards, *_ = many.step(action)
        stepped = [env.step(own) for env, own in zip(ones, action, strict=True)]
        each = [one[0] for one in stepped]
        np.testing.assert_array_equal(rewards, [one[1] for one in stepped])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            {"reward": "nothing"},
            r"^no reward is called 'nothing'; there are crowdnav, progress, safe_progress, scored, crowdnav_plus, or",
        ),
        ({"observation": "round"}, r"^observation is 'round', but must be one of flat, goal_frame, dict, lidar$"),
        ({"nearest": 0}, r"^nearest is 0, but must be a whole number from 1 to 10000$"),
        ({"nearest": True}, r"^nearest is True, but must be a whole number"),
        ({"observation": "dict", "rays": True}, r"^rays is True, but must be a whole number"),
        (
            {"observation": "goal_frame", "rays": 10**9},
            r"^rays is 1000000000, but must be a whole number from 0 to 10000",
        ),
        (
            {"observation": "goal_frame", "nearest": 10**9},
            r"^nearest is 1000000000, but must be a whole number from 1 to",
        ),
        ({"reward": lambda: 1}, r"^reward <lambda> must be a function of one argument, the step$"),
        ({"scenario": None}, r"^scenario is None, but must be a name, a file or a Scenario$"),
        ({"dtype": "int8"}, r"^dtype is 'int8', but must be one of float32, float64$"),
        ({"action": ["native"]}, r"^action is \['native'\], but must be one of normalized, normalized_goal_frame,"),
    ],
)
def test_what_does_not_exist_gets_one_sentence(options, sentence):
    for make in (gymnasium.make, lambda *given, **more: gymnasium.make_vec(*given, num_envs=2, **more)):
        with pytest.raises(InputError, match=sentence):
            make(ID, **options)


def a_step(outcome, moved=0.25):
    """A step of two worlds whose vehicles come closer to their goals, with the same outcome."""
    before = worlds(2)
    way = before.goal[:, 0] - before.position[:, 0]
    position = before.position.copy()
    position[:, 0] += moved * way / np.linalg.norm(way, axis=1, keepdims=True)
    return Step(before, before.replace(position=position), np.full(2, int(outcome)), np.full(2, 1.0))


def test_progress_pays_for_metres_and_collisions():
    np.testing.assert_allclose(progress(a_step(Outcome.RUNNING)), PROGRESS * 0.25)
    np.testing.assert_allclose(progress(a_step(Outcome.SUCCESS)), 1.0 + PROGRESS * 0.25)
    np.testing.assert_allclose(progress(a_step(Outcome.COLLISION)), COLLISION + PROGRESS * 0.25)
    np.testing.assert_allclose(crowdnav(a_step(Outcome.COLLISION)), -0.25)


@pytest.mark.parametrize("scenario", ["streets_16", "car_28"])
def test_the_reward_scored_takes_the_seconds_of_the_score(scenario):
    view = View(load_scenario(scenario), action="velocity")
    seen, paid = [view.scenario.worlds(Cases("val", 0, 3))], 0.0
    for _ in range(30):
        driven = drive(view, seen[-1], np.tile([0.5, 0.5], (3, 1)))
        paid += safe_progress(driven) - scored(driven)
        seen.append(driven.after)
    states = (np.stack([getattr(world, name) for world in seen], axis=1) for name in ("heading", "radius", "person"))
    position = np.stack([np.where(world.present[..., None], world.position, np.nan) for world in seen], axis=1)
    velocity = np.stack([world.velocity for world in seen], axis=1)
    close = close_seconds(position, velocity, *states, np.full(3, 30), seen[0].rules)
    assert close.max() > 0.5
    np.testing.assert_allclose(paid, SECOND * (30 * seen[0].rules.dt + close))


def test_the_reward_of_crowdnav_plus_pays_for_metres_or_distance_and_for_predicted_contacts():
    def paid(outcome, gap=1.0, speed=0.0):
        """Where one person, 1 m to the right of the vehicle, comes at a speed, and the others are far away."""
        step = a_step(outcome)
        position, velocity = step.after.position.copy(), np.zeros_like(step.after.velocity)
        position[:, 1:] += 50.0
        position[:, 1], velocity[:, 1] = position[:, 0] + [1.0, 0.0], [-speed, 0.0]
        return crowdnav_plus(Step(step.before, step.after.replace(position=position, velocity=velocity), step.outcome,
                                  np.full(2, gap)))  # fmt: skip

    np.testing.assert_allclose(paid(Outcome.RUNNING), 2.0 * 0.25)
    np.testing.assert_allclose(paid(Outcome.RUNNING, gap=0.05), 10.0 * -0.2 * 0.25)
    np.testing.assert_allclose(paid(Outcome.SUCCESS), 10.0)
    np.testing.assert_allclose(paid(Outcome.COLLISION), -20.0)
    np.testing.assert_allclose(paid(Outcome.TIMEOUT), 0.0)
    # 0.4 m are left between the rims: 0.5 m in two steps, and 2 m/s in one.
    np.testing.assert_allclose(paid(Outcome.RUNNING, speed=1.0), 0.5 - 20.0 / 8.0)
    np.testing.assert_allclose(paid(Outcome.RUNNING, speed=2.0), 0.5 - 20.0 / 4.0)
    np.testing.assert_allclose(paid(Outcome.RUNNING, speed=0.3), 0.5)


def test_a_reward_of_ones_own_is_a_file(tmp_path):
    (tmp_path / "mine.py").write_text("def reward(step):\n    return 10.0 * step.progress\n")
    mine = load_reward(str(tmp_path / "mine.py"))
    assert mine.name == "mine"
    np.testing.assert_allclose(mine(a_step(Outcome.RUNNING)), 2.5)


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (
            lambda step: np.zeros(3),
            r"^reward mine gave shape \[3\] of float64, but must give one number per world, \[2\]$",
        ),
        (lambda step: np.array([0.0, np.nan]), r"^reward mine is nan in world 1, case 1, step 0, but must be finite$"),
        (lambda step: 1 / 0, r"^reward mine raised ZeroDivisionError \(one of 2 cases, step 0\): division"),
    ],
)
def test_a_reward_that_is_wrong_gets_one_sentence(answer, sentence):
    with pytest.raises(InputError, match=sentence):
        CheckedReward("mine", answer)(a_step(Outcome.RUNNING))


def test_the_vec_env_keeps_the_contract_of_stable_baselines():
    env = CrowdVecEnv(4, seed=3, cases=16, nearest=3)
    seen = env.reset()
    assert {name: part.shape for name, part in seen.items()} == {
        "vehicle": (4, 5),
        "pedestrians": (4, 3, 8),
        "mask": (4, 3),
        "history": (4, 8, 3, 2),
    }
    ends = 0
    for _ in range(130):
        seen, rewards, dones, infos = env.step(np.tile([1.0, 0.0], (4, 1)))
        assert rewards.shape == dones.shape == (4,)
        for done, info in zip(dones, infos, strict=True):
            assert ("terminal_observation" in info) == bool(done)
            if done:
                ends += 1
                assert info["episode"]["l"] <= 100
                assert info["outcome"] in (Outcome.SUCCESS, Outcome.COLLISION, Outcome.TIMEOUT)
                assert info["terminal_observation"]["vehicle"].shape == (5,)
    assert ends > 4


def test_without_stable_baselines_a_sentence_says_how_it_is_installed(monkeypatch):
    monkeypatch.delitem(sys.modules, "crowdbench.envs.stable_baselines")
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    monkeypatch.delitem(vars(crowdbench.envs), "CrowdVecEnv", raising=False)
    with pytest.raises(ImportError, match=r"^CrowdVecEnv needs stable-baselines3: pip install 'crowdbench\[ppo\]'$"):
        from crowdbench.envs import CrowdVecEnv  # noqa: F401


@pytest.mark.parametrize(
    "wrong", [{"num_envs": 0}, {"num_envs": "3"}, {"num_envs": 10**9}, {"cases": 0}, {"seed": -1}, {"seed": "a"}]
)
def test_a_number_that_the_vec_env_cannot_use_gets_one_sentence(wrong):
    with pytest.raises(InputError, match=rf"^{next(iter(wrong))} is .*, but must be a whole number"):
        CrowdVecEnv(**{"num_envs": 2, "cases": 4, **wrong})


def test_the_vec_env_repeats_itself():
    runs = []
    for _ in range(2):
        env = CrowdVecEnv(3, seed=8, cases=16)
        env.reset()
        runs.append([env.step(np.full((3, 2), 0.5))[1] for _ in range(60)])
    np.testing.assert_array_equal(*runs)


def test_the_vec_env_tells_the_end_of_an_episode_as_it_was():
    """Against the simulator: last observations, outcomes and returns of the episodes that end, by time or otherwise."""
    scenario = load_scenario("circle_crossing_5", {"time_limit": 9.0})
    env = CrowdVecEnv(6, scenario, seed=8, cases=16, nearest=2)
    env.reset()
    action, returned, ends = np.tile([[1.0, 0.0], [0.2, 0.1]], (3, 1)), np.zeros(6), []
    for _ in range(70):
        before = env._running.worlds
        command = env.view.commands(before.position[:, 0], before.goal[:, 0], before.preferred_speed[:, 0], action)
        after, (outcome, gap, _) = step(before, command, crowd_velocities(before, scenario.policies))
        last = env.view.observe(after)
        seen, rewards, dones, infos = env.step(action)
        returned += rewards
        np.testing.assert_array_equal(rewards, progress(Step(before, after, outcome, gap)))
        np.testing.assert_array_equal(dones, outcome != Outcome.RUNNING)
        for row, done in enumerate(dones):
            told = infos[row]["terminal_observation"] if done else {name: part[row] for name, part in seen.items()}
            for name, part in last.items():
                np.testing.assert_array_equal(told[name], part[row])
            if done:
                ends.append(infos[row]["outcome"])
                assert infos[row]["TimeLimit.truncated"] == (outcome[row] == Outcome.TIMEOUT)
                assert infos[row]["episode"]["r"] == pytest.approx(returned[row])
                assert not np.array_equal(seen["vehicle"][row], last["vehicle"][row])
                returned[row] = 0.0
    assert {Outcome.TIMEOUT, Outcome.COLLISION} <= set(ends)


def test_every_agent_has_a_world_of_its_own():
    world = worlds(1, "circle_crossing_5_visible")
    own = ego_views(world)
    assert len(own) == 6
    for agent in range(6):
        order = [agent, *(other for other in range(6) if other != agent)]
        for name in ("position", "velocity", "goal", "radius", "preferred_speed", "present"):
            np.testing.assert_array_equal(getattr(own, name)[agent], getattr(world, name)[0, order])
    unseen = ego_views(worlds(1)).present
    assert unseen[0].all()
    assert not unseen[1:, 1].any()
    assert unseen[1:].sum(axis=1).tolist() == [5] * 5


def test_agents_of_pettingzoo_see_and_act_in_the_frames_of_their_goals():
    env = parallel_env(reward="progress", observation="goal_frame", action="goal_frame", nearest=2)
    seen, _ = env.reset(seed=3)
    distance = {agent: row[0] for agent, row in seen.items()}
    assert all(row.shape == env.observation_space(agent).shape for agent, row in seen.items())
    seen, rewards, *_ = env.step({agent: np.array([0.8, 0.0]) for agent in env.agents})
    for agent, row in seen.items():
        assert row[0] == pytest.approx(distance[agent] - 0.8 * 0.25)
        assert rewards[agent] == pytest.approx(PROGRESS * 0.8 * 0.25)
        np.testing.assert_allclose(row[1:3], [0.8, 0.0], atol=1e-12)


def test_agents_of_pettingzoo_are_paid_as_the_vehicle_is():
    """With the vehicle's actions alone, its observations and rewards are those of the Gymnasium environment."""
    options = {"reward": "progress", "observation": "goal_frame", "action": "goal_frame", "nearest": 3}
    everybody, alone = parallel_env(**options), gymnasium.make(ID, **options).unwrapped
    one, _ = everybody.reset(options={"case": "val/2"})
    other, _ = alone.reset(options={"case": "val/2"})
    for _ in range(20):
        np.testing.assert_array_equal(one["vehicle"], other)
        one, paid_to, *_ = everybody.step({"vehicle": np.array([0.7, 0.2])})
        other, reward, terminated, _, _ = alone.step(np.array([0.7, 0.2]))
        assert paid_to["vehicle"] == pytest.approx(reward)
        if terminated:
            break


@pytest.mark.filterwarnings("ignore:.*A Box observation space (minimum|maximum) value is -?infinity.*")
def test_pettingzoos_tests_pass_in_the_frame_of_the_goal():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from pettingzoo.test import parallel_api_test
    parallel_api_test(parallel_env(reward="progress", observation="goal_frame", action="goal_frame"), num_cycles=100)


def test_rewards_are_asked_only_for_steps_of_episodes():
    def strict(step):
        assert (step.before.step < step.before.rules.max_steps).all()
        return np.ones(len(step.gap))

    envs = gymnasium.make_vec(
        ID, num_envs=3, scenario=load_scenario("circle_crossing_5", {"time_limit": 3.0}), reward=strict
    )
    envs.reset(seed=0)
    rewards = np.array([envs.step(np.zeros((3, 2)))[1] for _ in range(2 * envs.unwrapped.scenario.rules.max_steps)])
    assert (rewards == 0.0).sum(axis=0).tolist() == [1, 1, 1]


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_a_policy_drives_as_it_was_trained(speed):
    """A planner's command is the velocity that the same action has in the environment."""
    scenario = load_scenario("circle_crossing_5", {"vehicle.preferred_speed": speed})
    env = CrowdVecEnv(4, scenario, action="goal_frame", nearest=5, cases=4)
    seen = env.reset()
    policy = make_policy("ppo")
    inputs = (torch.as_tensor(seen[name], dtype=torch.float32) for name in ("vehicle", "pedestrians"))
    with torch.no_grad():
        shown = Seen(*inputs, torch.as_tensor(seen["mask"] > 0.5))
        action = policy(shown, policy.initial_memory(len(shown.mask)))[0].double().numpy()
    command = NetworkPlanner(policy, PolicyInterface(5)).plan(observe(env._running.worlds))
    env.step_async(action)
    env.step_wait()
    np.testing.assert_allclose(env._running.worlds.velocity[:, 0], command, atol=1e-6)


def test_rays_and_the_motion_are_named_parts_and_stand_at_the_end_of_a_vector():
    made = {"id": ID, "scenario": "door_10", "action": "goal_frame", "rays": 24, "nearest": 3}
    named, joined = (gymnasium.make(**made, observation=observation) for observation in ("dict", "goal_frame"))
    parts, vector = (env.reset(options={"case": "val/0"})[0] for env in (named, joined))
    assert set(parts) == set(named.observation_space)
    assert named.observation_space.contains(parts)
    assert joined.observation_space.contains(vector)
    np.testing.assert_array_equal(vector[-34:], np.concatenate([parts["motion"], parts["rays"]]))
    assert parts["rays"].min() < 5.0
    with pytest.raises(
        InputError, match="rays is 24, but must be a whole number from 0 to 10000, 0 where the observation is flat"
    ):
        gymnasium.make(**made)


@pytest.mark.parametrize(
    "action",
    [
        *({}, None, "left", [1.0], [[1.0], [1.0, 2.0]], [np.nan, 0.0], ["1", "1"], np.array(["1", "1"], object)),
        *([1j, 0j], [True, False], np.zeros(2, "datetime64[s]"), np.zeros(2, "timedelta64[s]"), [b"1", b"1"]),
        *([10**400, 0], torch.zeros(2, requires_grad=True)),
    ],
)
def test_an_action_that_is_no_pair_of_numbers_gets_one_sentence(action):
    env = VehicleEnv()
    env.reset(seed=0)
    with pytest.raises(InputError, match="an action must be two finite numbers"):
        env.step(action)


@pytest.mark.parametrize(("name", "value"), [("seed", 0.5), ("seed", {1, 2}), ("case", 3)])
def test_a_value_for_all_worlds_that_is_no_list_gets_one_sentence(name, value):
    envs = gymnasium.make_vec(ID, num_envs=2)
    with pytest.raises(InputError, match=f"{name} is .*, but must be a list with a value for each of 2 worlds"):
        envs.reset(**({"seed": value} if name == "seed" else {"options": {name: value}}))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"num_envs": 0}, "num_envs is 0, but must be a whole number from 1 to 100000$"),
        ({"num_envs": 10**9}, "num_envs is 1000000000, but must be"),
        ({"num_envs": 2.0}, "num_envs is 2.0, but must be"),
        ({"num_envs": 10**5, "observation": "dict", "nearest": 10**4}, "has 2.* numbers, but at most 100000000 fit$"),
        ({"autoreset_mode": "always"}, "autoreset_mode is 'always', but must be one of NextStep, SameStep, Disabled$"),
    ],
)
def test_arguments_of_many_worlds_get_one_sentence(options, sentence):
    with pytest.raises(InputError, match=sentence):
        VehicleVectorEnv(**options)


@pytest.mark.parametrize("options", [3, [], "case"])
def test_options_of_a_reset_that_are_no_table_get_one_sentence(options):
    for env in (parallel_env(), VehicleEnv(), VehicleVectorEnv(2)):
        with pytest.raises(InputError, match=r"options of reset is .*, but must be a table"):
            env.reset(options=options)


@pytest.mark.parametrize("actions", [None, 3, [[0.0, 0.0]], {"vehicle": [0.0, 0.0], 3: [0.0, 0.0]}])
def test_actions_of_agents_that_are_no_table_get_one_sentence(actions):
    env = parallel_env()
    env.reset(seed=0)
    with pytest.raises(
        InputError, match=r"actions is .*, but must be a table of actions by agent|there are actions for"
    ):
        env.step(actions)
