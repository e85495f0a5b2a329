"""`import crowdbench_for_crowdnav`: scripts of CrowdNav simulate with crowdbench, and forks keep what is their own."""

import copy
import importlib
import logging
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from crowdnav_simulation import ORCA, OUTCOMES, ActionRot, ActionXY, Agent, CrowdSim, Lookahead, drive, modules

from crowdbench import Cases, load_scenario

FOLDER = Path(__file__).parents[2] / "adapters" / "crowdnav"
STAND_INS = "gym", "gym.envs", "gym.envs.registration", "gym.spaces", "gym.utils", "rvo2"
OWN = "crowdbench_for_crowdnav", "batched_lookahead", "crowd_sim_step", "rvo2_simulator"


@pytest.fixture
def fork(monkeypatch):
    """The module `crowd_sim_step`, in a program whose `CrowdSim` is taken for CrowdNav's."""
    monkeypatch.syspath_prepend(FOLDER)
    for name in (*STAND_INS, *OWN):
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name, module in modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    before = set(sys.modules)
    importlib.import_module("crowdbench_for_crowdnav")
    step = importlib.import_module("crowd_sim_step")
    monkeypatch.setattr(step, "STEP", step.fingerprint(CrowdSim.step))
    monkeypatch.setattr(step, "PREDICT", step.fingerprint(ORCA.predict))
    monkeypatch.setattr(step, "ACT", step.fingerprint(Agent.act))
    yield step
    for name in {*STAND_INS, *OWN} - before:
        sys.modules.pop(name, None)


def make(visible=False, kinematics="holonomic", **settings):
    """An environment in which the robot is driven by ORCA, made as CrowdNav's scripts make it."""
    import gym
    from gym.envs.registration import register

    register(id="CrowdSim-v0", entry_point="crowd_sim.envs:CrowdSim")
    env = gym.make("CrowdSim-v0")
    robot = Agent((0.0, -4.0), (0.0, 4.0), ORCA(), visible)
    robot.kinematics = kinematics
    env.set_robot(robot)
    vars(env).update(settings)
    return env


def starts(number, split="val"):
    world = load_scenario("circle_crossing_5").worlds(Cases(split, 0, number))
    return zip(world.position.tolist(), world.goal.tolist(), strict=True)


@pytest.mark.slow
@pytest.mark.parametrize("seen", ["invisible", "visible"])
def test_episodes_are_crowdnavs(fork, reference, seen):
    data, same = reference(f"crowdnav_circle5_orca_{seen}"), 0
    env = make(visible=seen == "visible")
    for case, length in enumerate(data["length"]):
        env.robot.policy.sim = None
        position, goal = data["position"][case, 0].tolist(), data["goal"][case].tolist()
        states, rewards, outcomes = drive(env, env.put(position, goal))
        if outcomes == data["info"][case, :length].tolist():
            same += 1
            assert np.median(np.abs(states[..., 0:2] - data["position"][case, : length + 1])) < 1e-4
            assert np.quantile(np.abs(rewards - data["reward"][case, :length]), 0.95) < 1e-3
            assert env.global_time == data["end_time"][case]
            assert len(env.states) == length
    assert same >= 0.97 * len(data["length"])


@pytest.mark.parametrize("kinematics", ["holonomic", "unicycle"])
def test_a_lookahead_says_what_the_step_does_and_does_nothing(fork, kinematics):
    env, rng = make(kinematics=kinematics), np.random.default_rng(0)
    ends = set()
    for position, goal in starts(12):
        env.put(position, goal)
        for _ in range(40):
            turn, speed = rng.normal(0.0, 0.3), rng.uniform(0.3, 1.0)
            action = ActionRot(speed, turn) if kinematics == "unicycle" else ActionXY(speed * math.sin(turn), speed)
            before = copy.deepcopy((env.robot.__dict__ | {"policy": 0}, env.global_time, len(env.states)))
            foreseen = [env.onestep_lookahead(one) for one in (action, action._replace(**{action._fields[0]: 0.0}))]
            assert before == (env.robot.__dict__ | {"policy": 0}, env.global_time, len(env.states))
            ob, reward, done, info = env.step(action)
            assert foreseen[0][:3] == (ob, reward, done)
            assert foreseen[1][0] == ob
            assert type(foreseen[0][3]) is type(info)
            assert foreseen[0][3].min_dist == info.min_dist
            ends.add(type(info))
            if done:
                break
    assert len(ends) >= 3


def test_a_lookahead_follows_what_a_script_moves(fork):
    env, stop = make(), ActionXY(0.0, 0.0)
    env.put(*next(starts(1)))
    alone = env.onestep_lookahead(stop)[0]
    env.robot.px, env.robot.py = 0.8 * env.humans[0].px, 0.7 * env.humans[0].py
    assert env.onestep_lookahead(stop)[0] == alone
    env.robot.visible = True
    seen = env.onestep_lookahead(stop)[0]
    env.robot.px += 0.2
    assert alone != seen != env.onestep_lookahead(stop)[0]


def test_rewards_are_those_of_the_configuration(fork):
    env = make(collision_penalty=-0.5, success_reward=3, discomfort_dist=0.4, discomfort_penalty_factor=2.0)
    assert env.put([[0.0, 0.0], [0.0, 1.1]], [[0.0, 4.0], [9.0, 9.0]])
    nothing = ActionXY(0.0, 0.0)
    assert env.onestep_lookahead(nothing)[1:3] == (0, False)
    assert env.onestep_lookahead(ActionXY(0.0, 0.8))[1] == pytest.approx((0.3 - 0.4) * 2.0 * 0.25)
    assert env.onestep_lookahead(ActionXY(0.0, 2.5))[1:3] == (-0.5, True)
    env.robot.gy = 0.2
    assert env.onestep_lookahead(nothing)[1:3] == (3, True)
    env.global_time = 24.0
    _, reward, done, info = env.onestep_lookahead(nothing)
    assert (reward, done, OUTCOMES.index(type(info))) == (0, True, 3)


def test_a_fork_keeps_a_step_of_its_own(fork, monkeypatch, caplog):
    monkeypatch.setattr(fork, "STEP", "another")
    with caplog.at_level(logging.INFO):
        env = make()
    assert "has a step of its own, which is kept" in caplog.text
    assert type(env) is CrowdSim
    assert env.step(None) == "a step of its own"


@pytest.mark.parametrize("what", ["PREDICT", "ACT"])
def test_people_who_walk_otherwise_do_so(fork, monkeypatch, what):
    monkeypatch.setattr(fork, what, "another")
    env = make()
    env.put(*next(starts(1)))
    assert env.onestep_lookahead(ActionXY(0.0, 0.0)) == "a step of its own"


def test_people_with_different_parameters_do_too(fork):
    env = make()
    env.put(*next(starts(1)))
    env.humans[2].policy.safety_space = 0.2
    assert env.step(ActionXY(0.0, 0.0)) == "a step of its own"


@pytest.mark.slow
@pytest.mark.parametrize("query_env", [True, False])
def test_a_batched_lookahead_decides_as_one_action_after_the_other(fork, monkeypatch, query_env):
    batched = importlib.import_module("batched_lookahead")
    one_by_one, rotate = Lookahead.predict, Lookahead.rotate
    monkeypatch.setattr(Lookahead, "predict", one_by_one)  # is given back after the test
    monkeypatch.setattr(batched, "PREDICT", fork.fingerprint(one_by_one))
    monkeypatch.setattr(batched, "ROTATE", "another")
    make()
    assert Lookahead.predict is one_by_one
    monkeypatch.setattr(batched, "ROTATE", fork.fingerprint(rotate))
    env = make()
    assert Lookahead.predict is batched.predict
    policy = env.robot.policy = Lookahead(env, query_env)
    for position, goal in starts(4):
        ob = env.put(position, goal)
        for _ in range(12):
            state = env.robot.seen(ob)
            chosen, values = policy.predict(state), policy.action_values
            assert one_by_one(policy, state) == chosen
            np.testing.assert_allclose(values, policy.action_values, atol=1e-6)
            assert np.std(values) > 1e-3
            ob, _, _, _ = env.step(chosen)


def test_a_lookahead_explores_in_training_with_crowdnavs_generator(fork, monkeypatch):
    batched = importlib.import_module("batched_lookahead")
    env = make()
    policy = Lookahead(env, True)
    state = env.robot.seen(env.put(*next(starts(1))))
    policy.phase, policy.epsilon = "train", 1.0
    np.random.seed(3)  # noqa: NPY002
    found = [batched.predict(policy, state) for _ in range(5)]
    np.random.seed(3)  # noqa: NPY002
    expected = []
    for _ in range(5):
        np.random.random()  # noqa: NPY002
        expected.append(policy.action_space[np.random.choice(len(policy.action_space))])  # noqa: NPY002
    assert found == expected
    assert policy.last_state is state
    policy.phase, policy.model = "test", lambda inputs: torch.full((len(inputs), 1), torch.nan)
    with pytest.raises(ValueError, match="returns NaN"):
        batched.predict(policy, state)
    env.robot.py = 3.9
    assert batched.predict(policy, env.robot.seen(state.human_states)) == ActionXY(0, 0)
    policy.phase = None
    with pytest.raises(AttributeError, match="set_phase and set_device"):
        batched.predict(policy, state)


INPUTS = "position", "velocity", "preferred_velocity", "radius", "max_speed"


@pytest.mark.parametrize("file", ["orca_steps", "orca_walls"])
def test_rvo2_is_rvo2(fork, reference, file):
    import rvo2

    data, errors = reference(file), []
    for scene in range(0, 250, 5):
        position, velocity, preferred, radius, speed = (data[f"n6_{name}"][scene].tolist() for name in INPUTS)
        walls = file == "orca_walls"
        most = 20 if walls else int(data["n6_max_neighbors"][scene])
        horizon = float(data["n6_time_horizon_obst"][scene]) if walls else 5.0
        sim = rvo2.PyRVOSimulator(0.25, 10.0, most, 5.0, horizon, 0.5, 1.0)
        for i in range(6):
            assert sim.addAgent(position[i], 10.0, most, 5.0, horizon, radius[i], speed[i], velocity[i]) == i
            sim.setAgentPrefVelocity(i, preferred[i])
        for polygon in data["n6_obstacles"][scene] if walls else ():
            if len(corners := polygon[~np.isnan(polygon[:, 0])]):
                sim.addObstacle(corners.tolist())
        sim.processObstacles()
        sim.doStep()
        found = np.array([sim.getAgentVelocity(i) for i in range(6)])
        errors += np.abs(found - data["n6_new_velocity"][scene]).max(axis=1).tolist()
        moved = np.array([sim.getAgentPosition(i) for i in range(6)])
        np.testing.assert_allclose(moved, np.array(position) + 0.25 * found)
    assert (np.array(errors) < 1e-4).mean() >= 0.98


def test_agents_of_rvo2_have_defaults_and_are_set(fork):
    import rvo2

    sim = rvo2.PyRVOSimulator(0.5, 10.0, 5, 2.0, 3.0, 0.4, 1.5)
    assert sim.addAgent((1.0, 2.0)) == 0
    sim.setAgentDefaults(9.0, 4, 2.5, 3.5, 0.2, 1.0, (0.1, 0.2))
    assert sim.addAgent((5.0, 2.0)) == 1
    assert [sim.getAgentRadius(i) for i in range(2)] == [0.4, 0.2]
    assert [sim.getAgentVelocity(i) for i in range(2)] == [(0.0, 0.0), (0.1, 0.2)]
    sim.setAgentMaxSpeed(0, 0.7)
    sim.setAgentPrefVelocity(0, (0.0, 2.0))
    sim.setTimeStep(0.25)
    sim.doStep()
    assert sim.getAgentVelocity(0) == pytest.approx((0.0, 0.7))
    assert (sim.getGlobalTime(), sim.getTimeStep(), sim.getNumAgents()) == (0.25, 0.25, 2)
    with pytest.raises(ValueError, match="the position alone, or all parameters"):
        sim.addAgent((0.0, 0.0), 10.0)
