"""The score and the seconds close to pedestrians, with values by hand and from a slow reference."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import drive, trace

from crowdbench.core.dynamics import Bicycle, chain
from crowdbench.core.dynamics.kernels import along_arc
from crowdbench.core.types import Outcome, Rules
from crowdbench.metrics.registry import METRICS

FAR = [50.0, 50.0]


def value(name, episode):
    return METRICS[name](episode)[0]


def still(gap, seconds=2.0):
    """An episode of a standing vehicle, with persons at these gaps."""
    places = [[0.0, 0.0], *([0.6 + each, 0.0] for each in gap)]
    return trace(np.repeat([places], round(4 * seconds) + 1, axis=0))


@pytest.mark.parametrize(
    ("gaps", "per_second"),
    [([0.0], 1.0), ([0.3], 1.0), ([0.45], 0.5), ([0.6], 0.0), ([0.7], 0.0), ([0.2, 0.45], 1.5), ([0.39, 9.0], 0.7)],
)
def test_seconds_close_are_weighted_by_the_gap_and_summed_over_persons(gaps, per_second):
    assert value("t_close", still(gaps)) == pytest.approx(2.0 * per_second)


def test_a_person_that_passes_within_a_step_counts():
    # It passes by at a gap of 0.3 m: full weight at one moment, none before and after the step.
    ways = np.stack([np.zeros((3, 2)), [[-1.5, 0.9], [1.5, 0.9], [4.5, 0.9]]], axis=1)
    share = (np.arange(20_000) + 0.5) / 20_000
    gap = np.hypot(-1.5 + 3.0 * share, 0.9) - 0.6
    expected = 0.25 * np.clip((0.6 - gap) / 0.3, 0.0, 1.0).mean()
    assert expected > 0.04
    assert value("t_close", trace(ways)) == pytest.approx(expected, abs=1e-4)


def test_another_person_in_the_same_entry_does_not_jump_past_the_vehicle():
    ways = np.stack([np.zeros((2, 2)), [[-1.2, 0.0], [1.2, 0.0]]], axis=1)
    episode = trace(ways)
    person = episode.person.copy()
    person[:, 1:] = 7
    assert value("t_close", episode) > 0.0
    assert value("t_close", dataclasses.replace(episode, person=person)) == 0.0


def slow_reference(episode, samples=2000):
    """Seconds close to persons of the first episode, sampled densely along arcs."""
    found, body, dt = 0.0, np.array(episode.rules.body), episode.rules.dt
    for t in range(episode.steps[0]):
        x, y = episode.position[0, t, 0]
        faces, after = episode.heading[0, t : t + 2]
        ahead = episode.velocity[0, t + 1, 0] @ [math.cos(after), math.sin(after)]
        rate = (after - faces + math.pi) % (2 * math.pi) - math.pi
        for share in (np.arange(samples) + 0.5) / samples:
            vx, vy, heading = along_arc(x, y, faces, ahead, rate / dt, share * dt)
            discs = np.array([vx, vy]) + body[:, None] * [math.cos(heading), math.sin(heading)]
            people = episode.position[0, t, 1:] + share * (episode.position[0, t + 1, 1:] - episode.position[0, t, 1:])
            distance = np.hypot(*(people[:, None] - discs).transpose(2, 0, 1)).min(axis=1)
            gap = distance - episode.radius[0, t, 0] - episode.radius[0, t, 1:]
            found += np.clip((0.6 - gap) / 0.3, 0.0, 1.0).sum() * dt / samples
    return found


def test_a_long_vehicle_on_an_arc_has_the_seconds_of_a_slow_reference():
    rules = Rules(dynamics=Bicycle(2.0, 0.6, 1.0), body=chain(2.0, 0.3, 0.5))
    heading = 0.2 + 0.15 * np.arange(9)
    position, random = np.zeros((9, 4, 2)), np.random.default_rng(3)
    for t in range(8):
        position[t + 1, 0] = along_arc(*position[t, 0], heading[t], 1.0, 0.6, 0.25)[:2]
    position[:, 1:] = random.uniform(-1, 3, (3, 2)) + 0.25 * np.arange(9)[:, None, None] * random.uniform(-1, 1, (3, 2))
    episode = trace(position)
    facing, velocity = episode.heading.copy(), episode.velocity.copy()
    facing[0, :9] = heading
    velocity[0, :9, 0] = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    episode = dataclasses.replace(episode, heading=facing, velocity=velocity, rules=rules)
    expected = slow_reference(episode, 200)
    assert expected > 1.0
    assert value("t_close", episode) == pytest.approx(expected, abs=1e-3)


def test_the_score_is_the_least_time_by_the_time_and_the_seconds_close():
    # 2 m in 8 steps; the goal's tolerance is 0.3 m, so that 7 steps are possible. A person stands at 0.45 m for 2 s.
    way = 0.25 * np.arange(9)[:, None] * [1.0, 0.0]
    beside = way + np.array([0.0, 1.05])
    success = trace(np.stack([way, beside], axis=1), goal=[[2.0, 0.0], FAR])
    assert value("t_empty", success) == 1.75
    assert value("score", success) == pytest.approx(1.75 / (2.0 + 1.0))
    failure = dataclasses.replace(success, outcome=np.array([int(Outcome.COLLISION)]))
    assert value("score", failure) == 0.0
    assert np.isnan(value("t_close", failure))


def test_a_recorded_robot_above_its_stated_speed_has_a_score_of_1_at_most():
    way = np.arange(5)[:, None] * [1.0, 0.0]
    assert value("score", trace(np.stack([way, way + FAR], axis=1), goal=[[4.0, 0.0], FAR])) == 1.0


@pytest.mark.slow
def test_an_episode_has_the_same_score_alone_and_in_a_batch():
    together, alone = drive("orca_margin", "6", "door_10"), drive("orca_margin", "4:5", "door_10")
    for name in ("score", "t_close", "t_empty"):
        assert np.array_equal(METRICS[name](together)[4:5], METRICS[name](alone), equal_nan=True)
