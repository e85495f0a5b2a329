import dataclasses

import numpy as np
import pytest
import torch
from lookahead_scenes import Forks, Nearer, crowded, network, scene, slow_step

from agents.planners.sarl_sgan_seq import CrossEntropy, SequencePlanner
from crowdbench import InputError, load_planner
from crowdbench.core.types import Outcome
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.scene import scene_of
from crowdbench.planners.trials import try_sequences
from crowdbench.predict import ConstantVelocity


def some_sequences(obs, number, steps, seed=0):
    """Random commands within the speed limit."""
    rng = np.random.default_rng(seed)
    angle, share = rng.uniform(-np.pi, np.pi, (len(obs), number, 1)), rng.uniform(0.0, 1.0, (len(obs), number, steps))
    speed = share * obs.vehicle.preferred_speed[:, None, None]
    return speed[..., None] * np.stack(np.broadcast_arrays(np.cos(angle), np.sin(angle)), axis=-1)


def slow_course(obs, prediction, w, mode, commands, margin):
    """Reward until the end, outcome and number of steps of one sequence in one future, step by step."""
    position, earned = obs.vehicle.position.copy(), 0.0
    gamma = 0.9 ** (obs.dt * obs.vehicle.preferred_speed[w])
    for t, command in enumerate(commands):
        seen = scene(obs, prediction, t, position)
        seen = dataclasses.replace(seen, crowd=seen.crowd._replace(radius=seen.crowd.radius + margin * t))
        outcome, reward, _ = slow_step(seen, w, mode, command)
        earned += gamma**t * reward
        position[w] += obs.dt * command
        if outcome != Outcome.RUNNING:
            return earned, outcome, t + 1
    return earned, Outcome.RUNNING, len(commands)


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_sequences_are_worth_their_rewards_and_the_value_at_their_end(margin):
    obs = crowded()
    prediction = Forks(3).predict(obs, 4)
    lookahead = ValuePlanner(Forks(3), network())
    made = SequencePlanner(lookahead, margin=margin)
    commands = some_sequences(obs, 7, 4)
    futures = scene_of(obs, prediction, 0, obs.vehicle, prediction.position.shape[2])
    values = made.values(futures, commands)
    tried = try_sequences(futures, commands, margin * np.arange(4.0)[None, :, None])
    ends = SequencePlanner(ValuePlanner(Forks(3), Nearer()), margin=margin)
    assert {Outcome.RUNNING, Outcome.COLLISION, Outcome.SUCCESS} == set(tried.outcome.flat)
    mean = dataclasses.replace(
        prediction,
        position=prediction.position.mean(axis=1, keepdims=True),
        velocity=prediction.velocity.mean(axis=1, keepdims=True),
    )
    for w in range(len(obs)):
        gamma = 0.9 ** (obs.dt * obs.vehicle.preferred_speed[w])
        for s in range(7):
            courses = [slow_course(obs, prediction, w, m, commands[w, s], margin) for m in range(3)]
            assert [outcome for _, outcome, _ in courses] == list(tried.outcome[w, s])
            assert [steps for *_, steps in courses] == list(tried.steps[w, s])
            start = obs.vehicle.position + obs.dt * commands[:, s, :-1].sum(axis=1)
            *_, joint = slow_step(scene(obs, mean, 3, start), w, 0, commands[w, s, -1])
            expected = np.mean([earned for earned, *_ in courses])
            running = np.mean([outcome == Outcome.RUNNING for _, outcome, _ in courses])
            expected += running * gamma**4 * value_of(lookahead.value, joint, obs.pedestrians.seen[w])
            assert values[w, s] == pytest.approx(expected, abs=2e-5)
    assert not np.allclose(ends.values(futures, commands), values)


def value_of(net, joint, present):
    """A network's value of one state."""
    with torch.no_grad():
        return float(net(torch.tensor(np.array(joint), dtype=torch.float32)[None], torch.from_numpy(present)[None]))


def test_the_best_sequence_is_at_least_as_good_as_the_lookahead_s_and_as_any_constant_one():
    obs = crowded()
    lookahead = ValuePlanner(Forks(3), network())
    made = SequencePlanner(lookahead, CrossEntropy(samples=20, elites=5), horizon=5)
    prediction = Forks(3).predict(obs, 5)
    futures = scene_of(obs, prediction, 0, obs.vehicle, prediction.position.shape[2])
    best = made.values(futures, made.plan_ahead(obs, 5)[:, None])[:, 0]
    mean = dataclasses.replace(
        prediction,
        position=prediction.position.mean(axis=1, keepdims=True),
        velocity=prediction.velocity.mean(axis=1, keepdims=True),
    )
    constant = lookahead.actions(obs.vehicle.preferred_speed)[:, :, None].repeat(5, axis=2)
    others = np.concatenate([lookahead.follow(obs, mean)[0][:, None], constant], axis=1)
    values = made.values(futures, others).max(axis=1)
    assert (best >= values - 1e-6).all()
    assert (best > values + 1e-3).any()


def test_more_rounds_find_better_sequences():
    obs = crowded(worlds=20)
    lookahead = ValuePlanner(Forks(3), network())
    futures = scene_of(obs, Forks(3).predict(obs, 5), 0, obs.vehicle, 5)
    found = []
    for rounds in (1, 4):
        made = SequencePlanner(lookahead, CrossEntropy(samples=30, rounds=rounds, elites=5), horizon=5)
        found.append(made.values(futures, made.plan_ahead(obs, 5)[:, None])[:, 0])
    assert (found[1] >= found[0] - 1e-6).all()
    assert found[1].mean() > found[0].mean() + 1e-3


def test_commands_are_no_faster_than_the_vehicle_and_the_first_is_what_is_planned_for_one_step():
    obs = crowded()
    made = SequencePlanner(ValuePlanner(ConstantVelocity(), network()), CrossEntropy(spread=3.0))
    commands = made.plan_ahead(obs, 8)
    speed = np.linalg.norm(commands, axis=-1)
    assert (speed <= obs.vehicle.preferred_speed[:, None] * (1.0 + 1e-12)).all()
    assert np.array_equal(made.plan(obs), commands[:, 0])
    assert np.array_equal(made.plan_ahead(obs, 3), commands[:, :3])
    assert made.plan_ahead(obs, 11).shape == (len(obs), 11, 2)


def test_a_case_does_not_depend_on_its_batch():
    obs = crowded(worlds=30)
    made = SequencePlanner(ValuePlanner(Forks(3), network()), CrossEntropy(samples=20, elites=5))
    together = made.plan_ahead(obs, 8)
    for w in (0, 13, 29):
        np.testing.assert_allclose(made.plan_ahead(obs.take(slice(w, w + 1)), 8)[0], together[w], atol=1e-5)


def test_what_was_planned_is_logged():
    obs = dataclasses.replace(crowded(), logs={})
    made = SequencePlanner(ValuePlanner(Forks(3), network()))
    commands = made.plan_ahead(obs, 8)
    assert obs.logs["predicted"].shape == (6, 3, 8, 4, 2)
    way = obs.vehicle.position[:, None] + (commands * obs.dt).cumsum(axis=1)
    np.testing.assert_allclose(obs.logs["planned"], way[:, :, None])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizon": 0}, "horizon is 0, but must be a whole number, 1 or more"),
        ({"search": {"rounds": 0}}, "in search, rounds is 0, but must be a whole number, 1 or more"),
        ({"search": {"elites": 200}}, "in search, elites is 200, but must be 96 at most, which is samples"),
        ({"search": False}, "search is False, but must be a table with samples, rounds, elites, spread"),
    ],
)
def test_an_impossible_option_gets_one_sentence(options, message):
    with pytest.raises(InputError, match=message):
        load_planner("sarl_sgan_seq", options)


def test_the_network_may_be_any_and_its_digest_is_a_fact():
    made = load_planner("sarl_sgan_seq", {"predictor": "constant_velocity"})
    assert made.facts["network"] == "sarl"
    assert not made.privileged
