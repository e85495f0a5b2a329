import numpy as np
import pytest
from helpers import world
from lookahead_scenes import Forks, Nearer, crowded, network, scene, slow_values, within

from crowdbench.core.dynamics.dynamics import speeds_and_headings
from crowdbench.core.types import Observation
from crowdbench.planners.kce import Exploration
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.scene import mean_future
from crowdbench.sim.sensor import observe


@pytest.mark.parametrize("crowd", [[], [[1.0, 0.2]]])
def test_one_pedestrian_or_none_is_crowd_enough(crowd):
    logs = {}
    obs = observe(world([[0.0, 0.0], *crowd], goal=[[5.0, 0.0], *[[0.0, 0.0] for _ in crowd]]))
    obs = Observation(**vars(obs) | {"logs": logs})
    made = ValuePlanner(
        Forks(3),
        network(),
        limits=within(1.0),
        explore=Exploration(0.1, 2),
        shortlist=4,
    )
    assert np.isfinite(made.plan(obs)).all()
    assert made.plan_ahead(obs, 3).shape == (1, 3, 2)
    assert logs["attention"].shape == (1, len(crowd))
    np.testing.assert_allclose(logs["attention"].sum(), len(crowd), atol=1e-6)


def test_the_mean_future_is_the_mean_of_places_and_velocities():
    obs = crowded()
    prediction = Forks(3).predict(obs, 1)
    seen = mean_future(scene(obs, prediction))
    assert seen.crowd.velocity.shape == (6, 1, 4, 2)
    np.testing.assert_allclose(seen.crowd.position[:, 0, 1], prediction.position[:, :, 0].mean(axis=1))
    np.testing.assert_allclose(seen.crowd.velocity[:, 0], prediction.velocity[:, :, 0].mean(axis=1))
    np.testing.assert_allclose(seen.crowd.position[:, 0, 0], obs.pedestrians.position)


@pytest.mark.parametrize("shortlist", [82, 500])
def test_a_shortlist_of_all_commands_changes_nothing(shortlist):
    obs, net = crowded(12), network()
    options = {"limits": within(0.7), "explore": Exploration(0.1, 2)}
    planners = [ValuePlanner(Forks(3), net, shortlist=each, **options) for each in (None, shortlist)]
    every, listed = (made.plan(obs) for made in planners)
    assert np.array_equal(every, listed)


@pytest.mark.parametrize("shortlist", [pytest.param(1, marks=pytest.mark.slow), 5])
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
