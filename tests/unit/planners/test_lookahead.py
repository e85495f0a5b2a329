import math

import numpy as np
import pytest
import torch
from helpers import world
from lookahead_scenes import (
    DT,
    Far,
    Forks,
    Nearer,
    Says,
    assert_best,
    crowded,
    network,
    scene,
    slow_step,
    slow_values,
    within,
)

from crowdbench.core.dynamics.dynamics import speeds_and_headings
from crowdbench.core.types import Observation, Outcome
from crowdbench.networks.value import NETWORKS
from crowdbench.planners import lookahead
from crowdbench.planners.lookahead import SHOWN, ValuePlanner
from crowdbench.predict import ConstantVelocity, Oracle
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import step

# The commands.


def test_there_are_81_commands_in_exponential_steps():
    preferred = np.array([1.0, 0.4, 1.7])
    commands = speeds_and_headings(preferred)
    for w, most in enumerate(preferred):
        expected = [(0.0, 0.0)]
        for k in range(1, 6):
            speed = most * (math.exp(k / 5) - 1.0) / (math.e - 1.0)
            expected += [(speed * math.cos(n * math.pi / 8), speed * math.sin(n * math.pi / 8)) for n in range(16)]
        np.testing.assert_allclose(commands[w], expected, rtol=1e-12, atol=1e-12)
        assert (commands[w, 0] == 0.0).all()
        assert len(np.unique(commands[w], axis=0)) == 81
        assert np.hypot(*commands[w].T).max() == pytest.approx(most, rel=1e-12)


# One step.


@pytest.mark.parametrize("name", list(NETWORKS))
def test_values_are_reward_and_discounted_value_of_the_predicted_step(name):
    obs, net = crowded(), network(name)
    made = ValuePlanner(ConstantVelocity(), net)
    seen = scene(obs, made.predictor.predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    values, outcomes = slow_values(seen, commands, net)
    assert set(outcomes.flat) == {Outcome.RUNNING, Outcome.SUCCESS, Outcome.COLLISION}
    np.testing.assert_allclose(made.score(seen, commands).values, values, rtol=0.0, atol=1e-5)
    assert_best(made.plan(obs), commands, values)


def test_values_are_means_over_modes():
    obs, net = crowded(seed=3), network()
    made = ValuePlanner(Forks(3), net)
    seen = scene(obs, made.predictor.predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    values, outcomes = slow_values(seen, commands, net)
    assert (outcomes.min(axis=2) != outcomes.max(axis=2)).any()
    np.testing.assert_allclose(made.score(seen, commands).values, values, rtol=0.0, atol=1e-5)
    assert_best(made.plan(obs), commands, values)


@pytest.mark.parametrize("chunk", [1, 100, 1000])
def test_chunks_change_no_value_and_bound_what_a_network_is_given(monkeypatch, chunk):
    obs, net, near = crowded(3), network(), Nearer()
    seen = scene(obs, Forks(3).predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    whole = ValuePlanner(Forks(3), net).score(seen, commands).values
    monkeypatch.setattr(lookahead, "CHUNK", chunk)
    np.testing.assert_allclose(ValuePlanner(Forks(3), net).score(seen, commands).values, whole, rtol=0.0, atol=1e-5)
    ValuePlanner(Forks(3), near).score(seen, commands)
    one_command = 3 * 4
    filled_up = 1.25  # states, and pedestrians in them, each by up to an eighth
    assert max(near.given) <= filled_up * max(chunk, one_command)
    assert 1.0 <= sum(near.given) / (3 * 81 * one_command) <= filled_up


def test_nothing_comes_after_arrival_or_collision():
    obs = crowded()
    seen = scene(obs, ConstantVelocity().predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    values = ValuePlanner(ConstantVelocity(), Far()).score(seen, commands).values[1:]
    outcomes = slow_values(seen, commands, Far())[1][1:, :, 0]
    assert set(outcomes.flat) == {Outcome.RUNNING, Outcome.SUCCESS, Outcome.COLLISION}
    assert (values[outcomes == Outcome.SUCCESS] == 1.0).all()
    assert (values[outcomes == Outcome.COLLISION] == -0.25).all()
    # Somebody is there in some of the other worlds only.
    crowd = obs.pedestrians.seen.any(axis=1)[1:]
    assert (values[crowd][outcomes[crowd] == Outcome.RUNNING] > 50.0).all()


def test_the_planner_takes_the_reward_it_is_given():
    obs = crowded()
    seen = scene(obs, ConstantVelocity().predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    made = ValuePlanner(ConstantVelocity(), Far(), reward=lambda outcome, gap, dt: outcome * 10.0 + dt)
    outcomes = slow_values(seen, commands, Far())[1][:, :, 0]
    ended = outcomes != Outcome.RUNNING
    assert np.array_equal(made.score(seen, commands).values[ended], 10.0 * outcomes[ended] + DT)


@pytest.mark.parametrize(
    ("crowd", "said", "goes"),
    [([0.65, 0.0], [5.0, 0.0], True), ([0.65, 0.0], [0.65, 0.0], False), ([5.0, 5.0], [0.75, 0.0], False)],
)
def test_a_prediction_is_believed_right_or_wrong(crowd, said, goes):
    before = world([[0.0, 0.0], crowd], goal=[[5.0, 0.0], [0.0, 0.0]])
    command = ValuePlanner(Says([[said]]), Nearer()).plan(observe(before))
    assert np.array_equal(command, [[1.0, 0.0]]) == goes
    # In truth the crowd stands still: whoever believes otherwise runs into it.
    outcome = step(before, command, np.zeros((1, 1, 2)))[1].outcome
    assert outcome == (Outcome.COLLISION if goes else Outcome.RUNNING)


def test_a_vehicle_alone_goes_straight_to_its_goal():
    made = ValuePlanner(ConstantVelocity(), network())
    obs = observe(world([[0.0, 0.0]], goal=[[0.0, 5.0]]))
    assert obs.pedestrians.seen.shape == (1, 0)
    np.testing.assert_allclose(made.plan(obs), [[0.0, 1.0]], atol=1e-12)


def test_a_case_does_not_depend_on_its_batch():
    obs, made = crowded(8), ValuePlanner(Forks(2), network())
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    together = made.score(scene(obs, made.predictor.predict(obs, 1)), commands).values
    alone = []
    for w in range(8):
        one = obs.take(np.array([w]))
        seen = scene(one, made.predictor.predict(one, 1))
        np.testing.assert_allclose(made.score(seen, commands[w : w + 1]).values[0], together[w], rtol=0.0, atol=1e-5)
        alone.append(made.plan(one)[0])
    assert_best(alone, commands, together)


@pytest.mark.parametrize(("predictor", "privileged"), [(Oracle(), True), (ConstantVelocity(), False)])
def test_a_planner_is_privileged_where_its_predictor_is(predictor, privileged):
    assert ValuePlanner(predictor, network()).privileged is privileged


def test_what_the_planner_saw_is_logged():
    logs = {}
    obs, net = crowded(), network()
    obs = Observation(**vars(obs) | {"logs": logs})
    made = ValuePlanner(Forks(2), net)
    command, prediction = made.plan(obs), made.predictor.predict(obs, 1)
    assert logs.keys() == {"predicted", "commands", "value", "attention"}
    best = logs["commands"][..., 2].argmax(axis=1)
    assert np.array_equal(logs["commands"][np.arange(len(obs)), best, :2], command)
    assert np.array_equal(logs["predicted"], made.predictor.predict(obs, SHOWN).position)
    seen = scene(obs, prediction)
    for w in range(len(obs)):
        joint = np.array([slow_step(seen, w, m, command[w])[2] for m in range(2)], np.float32)
        present = torch.from_numpy(np.repeat(obs.pedestrians.seen[None, w], 2, axis=0))
        value, attention = net.attend(torch.from_numpy(joint), present)
        assert logs["value"][w] == pytest.approx(value.mean().item(), abs=1e-5)
        np.testing.assert_allclose(logs["attention"][w], attention.detach().mean(0), atol=1e-5)


# Limits and exploration.


def near(change, velocity, commands):
    """Which commands these are, and the one of braking as hard as that: `[world, action]` and all commands."""
    speed = np.linalg.norm(velocity, axis=1)
    braked = velocity * (np.maximum(speed - change, 0.0) / np.maximum(speed, 1e-9))[:, None]
    every = np.concatenate([commands, braked[:, None]], axis=1)
    return np.linalg.norm(every - velocity[:, None], axis=-1) <= change + 1e-9, every


@pytest.mark.parametrize("change", [0.5, 0.01])
def test_only_allowed_commands_are_taken_and_braking_always_is(change):
    obs, net = crowded(), network()
    made = ValuePlanner(ConstantVelocity(), net, limits=within(change))
    allowed, commands = near(change, obs.vehicle.velocity, speeds_and_headings(obs.vehicle.preferred_speed))
    values = slow_values(scene(obs, made.predictor.predict(obs, 1)), commands, net)[0]
    assert allowed[:, -1].all()
    assert allowed[:, :-1].any() == (change == 0.5)
    assert not allowed[np.arange(6), values.argmax(axis=1)].all()
    assert_best(made.plan(obs), commands, np.where(allowed, values, -np.inf))


def around(scene, command):
    """The same command turned a little to either side, and slower by a share of the preferred speed."""
    c, s = np.cos(0.1), np.sin(0.1)
    turned = [command @ np.array([[c, side], [-side, c]]) for side in (-s, s)]
    return np.stack([*turned, command * (1.0 - 0.05 * scene.vehicle.preferred_speed[:, None])], axis=1)


@pytest.mark.parametrize("change", [None, 0.7])
def test_a_finer_command_is_taken_where_it_is_better_and_allowed(change):
    obs, net = crowded(12), network()
    limits = None if change is None else within(change)
    coarse = ValuePlanner(ConstantVelocity(), net, limits=limits).plan(obs)
    made = ValuePlanner(ConstantVelocity(), net, limits=limits, explore=around)
    seen = scene(obs, made.predictor.predict(obs, 1))
    commands = np.concatenate([speeds_and_headings(obs.vehicle.preferred_speed), around(seen, coarse)], axis=1)
    if change is not None:
        allowed, commands = near(change, obs.vehicle.velocity, commands)
    values = slow_values(seen, commands, net)[0]
    if change is not None:
        values = np.where(allowed, values, -np.inf)
    chosen = made.plan(obs)
    assert_best(chosen, commands, values)
    finer, arrived = (chosen != coarse).any(axis=1), values[:, :81].max(axis=1) == 1.0
    assert finer.any()
    assert arrived.any()
    assert not finer[arrived].any()


# Several steps.


def test_planning_one_step_ahead_is_planning():
    obs, made = crowded(), ValuePlanner(Forks(2), network())
    assert np.array_equal(made.plan_ahead(obs, 1)[:, 0], made.plan(obs))


@pytest.mark.parametrize("change", [None, 0.7])
def test_each_later_step_starts_where_the_one_before_ended(change):
    obs, net = crowded(4), network()
    made = ValuePlanner(Forks(2), net, limits=None if change is None else within(change))
    prediction = made.predictor.predict(obs, 3)
    plan = made.plan_ahead(obs, 3)
    position, velocity = obs.vehicle.position, obs.vehicle.velocity
    for ahead in range(3):
        commands = speeds_and_headings(obs.vehicle.preferred_speed)
        if change is not None:
            allowed, commands = near(change, velocity, commands)
        values = slow_values(scene(obs, prediction, ahead, position), commands, net)[0]
        if change is not None:
            values = np.where(allowed, values, -np.inf)
        assert_best(plan[:, ahead], commands, values)
        velocity = plan[:, ahead]
        position = position + DT * velocity
    assert (plan[:, 0] != plan[:, 2]).any()
