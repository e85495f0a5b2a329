import dataclasses

import numpy as np
import pytest
from helpers import drive
from joint_states import slow_joint_states

from crowdbench.core.types import Outcome, Rules
from crowdbench.train.replay_memory import ReplayBuffer, Transitions, transitions


@pytest.fixture(scope="module")
def episodes():
    """Episodes that end in every way, among 1 to 4 pedestrians, with a vehicle that is not as fast as 1 m/s."""
    trace = drive("orca", "24", pedestrians__number=[1, 4], vehicle__preferred_speed=0.8, time_limit=13.0)
    assert set(trace.outcome) == {Outcome.SUCCESS, Outcome.COLLISION, Outcome.TIMEOUT}
    assert not trace.present.all()
    return trace


def slow_rewards(trace, w):
    """Of each step, by the published rule."""
    rewards = []
    for t in range(trace.steps[w]):
        gap = trace.gap[w, t]
        rewards.append(min(gap - 0.2, 0.0) * 0.5 * trace.rules.dt)
    ends = {Outcome.SUCCESS: 1.0, Outcome.COLLISION: -0.25, Outcome.TIMEOUT: 0.0}
    rewards[-1] = ends[Outcome(trace.outcome[w])]
    return rewards


def slow_transitions(trace, n=1):
    """A dictionary for each transition, episode by episode."""
    for w in range(len(trace)):
        rewards, factor = slow_rewards(trace, w), 0.9 ** (trace.rules.dt * trace.preferred_speed[w, 0])
        states = [
            slow_joint_states(
                trace.position[w, t],
                trace.velocity[w, t],
                trace.radius[w, 0],
                trace.present[w, 0],
                trace.goal[w, 0, 0],
                trace.preferred_speed[w, 0],
            )
            for t in range(trace.steps[w] + 1)
        ]
        for t in range(trace.steps[w]):
            then = min(t + n, trace.steps[w])
            ended = then == trace.steps[w] and trace.outcome[w] != Outcome.TIMEOUT
            yield {
                "joint": states[t],
                "next_joint": states[then],
                "present": trace.present[w, t, 1:],
                "next_present": trace.present[w, then, 1:],
                "reward": sum(factor**k * reward for k, reward in enumerate(rewards[t:then])),
                "bootstrap": 0.0 if ended else factor ** (then - t),
                "episode_return": sum(factor**k * reward for k, reward in enumerate(rewards[t:])),
            }


@pytest.mark.parametrize("n", [1, 3, 1000])
def test_transitions_are_those_of_the_trace(n, episodes):
    steps, expected = transitions(episodes, n), list(slow_transitions(episodes, n))
    assert len(steps) == len(expected) == episodes.steps.sum()
    # The return of an episode that was truncated lacks what would have followed.
    finished = np.repeat(episodes.outcome != Outcome.TIMEOUT, episodes.steps)
    for field in dataclasses.fields(Transitions):
        found, wanted = getattr(steps, field.name), np.array([step[field.name] for step in expected])
        rows = finished if field.name == "episode_return" else slice(None)
        np.testing.assert_allclose(found[rows], wanted[rows], rtol=1e-5, atol=2e-6)


def test_truncated_episodes_can_be_left_out(episodes):
    every, some = transitions(episodes, 2), transitions(episodes, 2, truncated=False)
    finished = np.repeat(episodes.outcome != Outcome.TIMEOUT, episodes.steps)
    for field in dataclasses.fields(Transitions):
        assert np.array_equal(getattr(some, field.name), getattr(every, field.name)[finished])


def test_only_where_an_episode_terminated_the_next_state_has_no_value(episodes):
    factor = transitions(episodes, 1).bootstrap
    last = np.cumsum(episodes.steps) - 1
    ended = last[episodes.outcome != Outcome.TIMEOUT]
    assert np.array_equal(np.flatnonzero(factor == 0.0), ended)
    np.testing.assert_allclose(np.delete(factor, ended), 0.9**0.2, rtol=1e-6)


def test_each_vehicle_is_discounted_by_its_own_speed(episodes):
    speeds = np.linspace(0.5, 1.5, 24)
    faster = episodes.preferred_speed.copy()
    faster[:, 0] = speeds
    mixed = dataclasses.replace(episodes, preferred_speed=faster, rules=Rules(dt=0.2, time_limit=13.0))
    steps = transitions(mixed, 1)
    going = steps.bootstrap > 0.0
    np.testing.assert_allclose(
        steps.bootstrap[going], (0.9 ** (0.2 * np.repeat(speeds, episodes.steps)))[going], rtol=1e-6
    )
    np.testing.assert_allclose(steps.reward, [step["reward"] for step in slow_transitions(mixed)], atol=1e-6)


def test_episodes_without_pedestrians_have_transitions():
    trace = drive("orca", "2", pedestrians__number=0)
    steps = transitions(trace, 1)
    assert len(steps) == trace.steps.sum()
    assert not steps.present.any()
    assert steps.joint.shape[1:] == (1, 13)
    assert (steps.reward[np.cumsum(trace.steps) - 1] == 1.0).all()


def numbered(start, stop):
    """Steps that can be told by their reward."""
    number = np.arange(start, stop, dtype=np.float32)
    joint = np.repeat(number[:, None, None], 13, axis=2)
    return Transitions(joint, joint + 0.5, number[:, None] % 2 == 0, number[:, None] % 2 == 1, number, number, number)


@pytest.mark.parametrize("portion", [1, 3, 10, 25])
def test_the_oldest_transitions_are_overwritten(portion):
    replay = ReplayBuffer(10)
    for start in range(0, 50, portion):
        replay.add(numbered(start, start + portion))
        end = start + portion
        kept = np.sort(replay.transitions.reward[: len(replay)])
        assert np.array_equal(kept, np.arange(max(0, end - 10), end))
    order = replay.transitions.reward.astype(int)
    for field in dataclasses.fields(Transitions):
        assert np.array_equal(getattr(replay.transitions, field.name), getattr(numbered(0, end), field.name)[order])


def test_a_sample_repeats_with_its_generator():
    replay = ReplayBuffer(1000)
    replay.add(numbered(0, 40))
    one, again, other = (replay.sample(np.random.default_rng(seed), 200) for seed in (1, 1, 2))
    for field in dataclasses.fields(Transitions):
        assert np.array_equal(getattr(one, field.name), getattr(again, field.name))
    assert not np.array_equal(one.reward, other.reward)
    # Whole transitions, and only those added.
    assert np.array_equal(one.next_joint[:, 0, 0], one.reward + 0.5)
    assert set(one.reward) <= set(range(40))
    assert len(set(one.reward)) > 30
