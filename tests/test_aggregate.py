import dataclasses

import numpy as np
import pytest
import torch
from helpers import world
from lookahead_scenes import Forks, Nearer, assert_best, crowded, network, scene, slow_step, slow_values, within

from crowdbench.core.dynamics.base import speeds_and_headings
from crowdbench.core.types import Observation
from crowdbench.networks.value import NETWORKS
from crowdbench.planners.aggregate import AGGREGATES, mean_future
from crowdbench.planners.kce import Exploration
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.scene import Crowd
from crowdbench.sim.sensor import observe

VALUES = np.array([[0.5, -0.25, 1.0], [0.1, 0.1, 0.4]])


@pytest.mark.parametrize(("name", "expected"), [("mean", [1.25 / 3, 0.2]), ("worst", [-0.25, 0.1])])
def test_values_under_several_futures_become_one(name, expected):
    np.testing.assert_allclose(AGGREGATES[name].combine(VALUES, axis=1), expected)


def by_hand(seen):
    """All pedestrians of all modes in one future, put together one by one."""
    worlds, modes, times, pedestrians = seen.crowd.position.shape[:4]
    position = np.zeros((worlds, 1, times, modes * pedestrians, 2))
    velocity = np.zeros((worlds, 1, modes * pedestrians, 2))
    radius, present = np.zeros((worlds, modes * pedestrians)), np.zeros((worlds, modes * pedestrians), bool)
    for w in range(worlds):
        for m in range(modes):
            for p in range(pedestrians):
                position[w, 0, :, m * pedestrians + p] = seen.crowd.position[w, m, :, p]
                velocity[w, 0, m * pedestrians + p] = seen.crowd.velocity[w, m, p]
                radius[w, m * pedestrians + p] = seen.crowd.radius[w, p]
                present[w, m * pedestrians + p] = seen.crowd.present[w, p]
    return dataclasses.replace(seen, crowd=Crowd(position, velocity, radius, present))


@pytest.mark.parametrize("name", list(NETWORKS))
def test_the_literal_reading_shows_the_network_everybodys_futures_at_once(name):
    obs, net = crowded(seed=3), network(name)
    made = ValuePlanner(Forks(3), net, aggregate=AGGREGATES["crowd"])
    seen = scene(obs, made.predictor.predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    values = slow_values(by_hand(seen), commands, net)[0]
    np.testing.assert_allclose(made.values(seen, commands), values, rtol=0.0, atol=1e-5)
    assert_best(made.plan(obs), commands, values)


@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_one_future_is_worth_what_it_is_worth_alone(aggregate):
    obs, net = crowded(), network()
    seen = scene(obs, Forks(1).predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    values = ValuePlanner(Forks(1), net, aggregate=AGGREGATES[aggregate]).values(seen, commands)
    np.testing.assert_allclose(values, slow_values(seen, commands, net)[0], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("crowd", [[], [[1.0, 0.2]]])
def test_one_pedestrian_or_none_is_crowd_enough(aggregate, crowd):
    logs = {}
    obs = observe(world([[0.0, 0.0], *crowd], goal=[[5.0, 0.0], *[[0.0, 0.0] for _ in crowd]]))
    obs = Observation(**vars(obs) | {"logs": logs})
    made = ValuePlanner(
        Forks(3),
        network(),
        aggregate=AGGREGATES[aggregate],
        limits=within(1.0),
        explore=Exploration(0.1, 2),
        shortlist=4,
    )
    assert np.isfinite(made.plan(obs)).all()
    assert made.plan_ahead(obs, 3).shape == (1, 3, 2)
    assert logs["attention"].shape == (1, len(crowd))
    np.testing.assert_allclose(logs["attention"].sum(), len(crowd), atol=1e-6)


def test_a_pedestrian_gets_the_attention_of_all_its_futures():
    logs = {}
    obs, net = crowded(), network()
    obs = Observation(**vars(obs) | {"logs": logs})
    made = ValuePlanner(Forks(2), net, aggregate=AGGREGATES["crowd"])
    command = made.plan(obs)
    whole = by_hand(scene(obs, made.predictor.predict(obs, 1)))
    for w in range(len(obs)):
        joint = np.array(slow_step(whole, w, 0, command[w])[2], np.float32)
        value, attention = net.attend(torch.from_numpy(joint), torch.from_numpy(whole.crowd.present[w]))
        assert logs["value"][w] == pytest.approx(value.item(), abs=1e-5)
        both = attention.detach().numpy().reshape(2, 4).sum(axis=0)
        np.testing.assert_allclose(logs["attention"][w], both, atol=1e-5)


# The shortlist.


def test_the_mean_future_is_the_mean_of_places_and_velocities():
    obs = crowded()
    prediction = Forks(3).predict(obs, 1)
    seen = mean_future(scene(obs, prediction))
    assert seen.crowd.velocity.shape == (6, 1, 4, 2)
    np.testing.assert_allclose(seen.crowd.position[:, 0, 1], prediction.position[:, :, 0].mean(axis=1))
    np.testing.assert_allclose(seen.crowd.velocity[:, 0], prediction.velocity[:, :, 0].mean(axis=1))
    np.testing.assert_allclose(seen.crowd.position[:, 0, 0], obs.pedestrians.position)


@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("shortlist", [82, 500])
def test_a_shortlist_of_all_commands_changes_nothing(aggregate, shortlist):
    obs, net = crowded(12), network()
    options = {"aggregate": AGGREGATES[aggregate], "limits": within(0.7), "explore": Exploration(0.1, 2)}
    planners = [ValuePlanner(Forks(3), net, shortlist=each, **options) for each in (None, shortlist)]
    every, listed = (made.plan(obs) for made in planners)
    assert np.array_equal(every, listed)


@pytest.mark.parametrize("shortlist", [1, 5])
def test_of_a_shortlist_the_best_under_all_futures_is_taken(shortlist):
    obs, net = crowded(12), network()
    made = ValuePlanner(Forks(3), net, shortlist=shortlist)
    seen = scene(obs, made.predictor.predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    likely = slow_values(mean_future(seen), commands, net)[0]
    values = slow_values(seen, commands, net)[0]
    for w, command in enumerate(made.plan(obs)):
        kept = np.argsort(-likely[w], kind="stable")[:shortlist]
        same = [a for a in kept if np.array_equal(commands[w, a], command)]
        assert same
        assert values[w, same].max() >= values[w, kept].max() - 1e-5


def test_a_shortlist_does_nothing_where_there_is_one_future_and_saves_work_where_there_are_more():
    obs = crowded(3)
    for modes, factor in ((1, 81), (20, (81 + 20 * 8) / 20)):
        near = Nearer()
        ValuePlanner(Forks(modes), near, shortlist=8).plan(obs)
        assert sum(near.given) == pytest.approx(3 * 4 * modes * factor, rel=1 / 8)
