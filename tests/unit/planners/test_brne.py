"""BRNE: weights and Gaussian process as by the authors' code; walls; a row is the same in company."""

import dataclasses

import numpy as np
import pytest
from lookahead_scenes import DT, crowded, lone_vehicle

from agents.planners import brne
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

TIME = DT * np.arange(1, 7)

# Printed by `weights_update_nb`, `costs_nb`, `brne_nav` and `get_Lmat_nb` of socnavbench/brne.py in the repository
# MurpheyLab/brne at 633a5cd, for `three_agents()`, and for the times above with noise of 1e-2 at time 0.
RISK = [9.9609376987e01, 2.9412904092e01, 1.1177088818e-01, 3.1970952774e-05, 2.5889956845e-09]
ONE_ROUND = [
    [4.0027613745e00, 2.6523610378e-01, 1.2826394642e-01, 3.3669108765e-01, 2.6704748770e-01],
    [4.7185961978e-22, 1.6225201725e-11, 1.0086160463e-06, 4.9900017405e-04, 4.9994999912e00],
    [5.8066293880e-08, 2.6902905136e-08, 4.9999999150e00, 4.6906557225e-12, 1.3072179641e-14],
]
TEN_ROUNDS = [
    [4.9999934022e00, 6.5977487342e-06, 5.6840940384e-15, 7.7743266864e-19, 2.4991668519e-11],
    [6.3161380165e-32, 3.1071860045e-26, 3.2839321598e-21, 4.8909362932e-10, 4.9999999995e00],
    [3.7441561555e-13, 7.8750402420e-12, 5.0000000000e00, 9.1118176318e-13, 9.6779229795e-17],
]
LAST_ROW = [0.775621149, 0.4594848029, 0.2722267966, 0.0631727981, 0.0221091952, 0.0055785137]


def three_agents():
    """Five trajectories each of three agents who meet, `[1, agent, sample, time, 2]`."""
    agent, sample = np.arange(3)[:, None, None], np.arange(5)[None, :, None]
    side = (sample - 2) * (0.25 + 0.1 * agent) + 0.05 * agent
    x = np.array([0.0, 2.4, 1.2])[:, None, None] + np.array([1.0, -0.9, 0.1])[:, None, None] * TIME + 0.2 * side * TIME
    y = np.array([0.0, 0.1, -1.3])[:, None, None] + np.array([0.0, 0.05, 1.1])[:, None, None] * TIME + side * TIME
    return np.stack([x, y], axis=-1)[None]


def weights(paths, present, free, rounds):
    radius = np.full(present.shape, 0.3)
    return brne.equilibrium(brne.risks(paths, radius, present, 10.0, 100.0), present, free, rounds)


def test_risks_and_weights_are_those_of_the_authors():
    paths, present, free = three_agents(), np.ones((1, 3), bool), np.ones((1, 3, 5))
    risk = brne.risks(paths, np.full((1, 3), 0.3), present, 10.0, 100.0)
    np.testing.assert_allclose(risk[0, 0, 0, 1], RISK, rtol=1e-6)
    np.testing.assert_allclose(weights(paths, present, free, 1)[0], ONE_ROUND, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(weights(paths, present, free, 10)[0], TEN_ROUNDS, rtol=1e-6, atol=1e-15)


def test_the_gaussian_process_is_that_of_the_authors():
    np.testing.assert_allclose(brne.gaussian_process(TIME, 0.13, 2.0)[-1], LAST_ROW, rtol=1e-6)


def test_who_is_absent_changes_nothing():
    paths, free = three_agents(), np.ones((1, 3, 5))
    alone = weights(paths[:, :2], np.ones((1, 2), bool), free[:, :2], 3)
    np.testing.assert_allclose(weights(paths, np.array([[True, True, False]]), free, 3)[:, :2], alone)


def test_risk_depends_on_the_distance_in_units_of_both_radii():
    paths, present = three_agents(), np.ones((1, 3), bool)
    small = brne.risks(paths, np.full((1, 3), 0.3), present, 10.0, 100.0)
    np.testing.assert_allclose(brne.risks(2.0 * paths, np.full((1, 3), 0.6), present, 10.0, 100.0), small)


def test_trajectories_into_a_wall_have_no_weight():
    wall = np.array([[[[-1.0, 1.1], [9.0, 1.1], [np.nan, np.nan]]]])
    free = brne.is_free(three_agents(), np.full((1, 3), 0.3), wall)
    highest = three_agents()[0, :, :, :, 1].max(axis=2)
    np.testing.assert_array_equal(free[0, :2], highest[:2] < 0.8)
    found = weights(three_agents(), np.ones((1, 3), bool), free, 10)
    assert (found[0, 0, free[0, 0] == 0.0] == 0.0).all()
    assert found.mean(axis=2) == pytest.approx(1.0)


def test_the_way_turns_at_waypoints():
    obs = lone_vehicle(goal=(4.0, 2.0))
    route = np.array([[[-1.0, 0.0], [3.0, 0.0], [np.nan, np.nan]]])
    obs = dataclasses.replace(obs, vehicle=dataclasses.replace(obs.vehicle, route=route, waypoint=np.array([1])))
    points = brne.along_route(obs, np.array([[1.0, 3.0, 3.0 + np.sqrt(5.0) / 2.0, 99.0]]))
    np.testing.assert_allclose(points[0], [[1.0, 0.0], [3.0, 0.0], [3.5, 1.0], [4.0, 2.0]], atol=1e-9)


def test_it_makes_way_for_somebody_who_comes():
    obs = lone_vehicle()
    obs.pedestrians.position[:], obs.pedestrians.velocity[:] = [2.5, 0.2], [-1.0, 0.0]
    mean = dataclasses.replace(obs, logs={})
    planner = load_planner("brne", {"penalty": 400.0})
    assert planner.plan(mean)[0, 0] > 0.0
    assert mean.logs["planned"][0, 5, 0, 1] < -0.1


def test_commands_are_no_faster_than_preferred_and_also_for_several_steps():
    obs, planner = crowded(), load_planner("brne", {"samples": 20, "horizon": 4})
    ways = planner.plan_ahead(obs, 6)
    assert ways.shape == (6, 6, 2)
    assert (np.linalg.norm(ways, axis=2) <= obs.vehicle.preferred_speed[:, None] * (1 + 1e-9)).all()
    np.testing.assert_array_equal(ways[:, 0], planner.plan(obs))


def test_a_case_is_the_same_alone_and_in_company():
    scenario = load_scenario("door_10", {"time_limit": 3.0})
    driver = Driver(load_planner("brne", {"samples": 20}), "brne")
    together = rollout(driver, scenario, Cases("val", 0, 4))
    for case in (3, 1):
        apart = rollout(driver, scenario, Cases("val", case, case + 1))
        np.testing.assert_array_equal(apart.command[0], together.command[case])


@pytest.mark.parametrize("name", ["samples", "people", "iterations", "horizon", "width", "zone"])
def test_wrong_options_are_refused(name):
    with pytest.raises(InputError, match=f"{name} is 0"):
        load_planner("brne", {name: 0})
