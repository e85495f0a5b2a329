"""DRA-MPPI: probabilities against exact ones; what a sequence costs; that it drives around people and walls."""

import dataclasses

import numpy as np
import pytest
from lookahead_scenes import DT, Forks, Says, crowded, lone_vehicle
from scipy.stats import ncx2

from agents.planners import dra_mppi as dra
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.dynamics import Bicycle, Holonomic, Unicycle
from crowdbench.core.geometry import norm
from crowdbench.planners.driver import Driver
from crowdbench.planners.trials import propagate_vehicle
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError


def exact(centre, radius, mean, sigma):
    """The joint probability that somebody is in each circle: 1 - prod (1 - P), with mixtures P, `[sample]`."""
    squared = ((centre[:, None, None] - mean) ** 2).sum(axis=-1)
    each = ncx2.cdf((radius / sigma) ** 2, 2, squared / sigma**2).mean(axis=1)
    return 1.0 - np.prod(1.0 - each, axis=1)


def apart(rng, centre, number):
    """People who do not overlap, some of them near the samples, `[person, 2]` in metres."""
    people = np.empty((0, 2))
    while len(people) < number:
        near = centre[len(people)] + rng.normal(0.0, 1.0, 2)
        new = near if len(people) < number // 3 else rng.uniform([-2.0, -3.0], [9.0, 3.0])
        if (norm(people - new) > 0.6).all():
            people = np.vstack([people, new])
    return people


@pytest.mark.parametrize(("modes", "spread"), [(1, 0.0), (4, 0.4)])
def test_fewer_than_two_in_a_hundred_risky_samples_seem_to_be_below_the_threshold(modes, spread):
    # Section IV-A: "we misclassify the CP to be below the threshold less than 2% of the times"; 12 people, section V.
    rng, wrong, risky = np.random.default_rng(0), 0, 0
    for step in (1, 4, 8, 16, 20):
        for _ in range(4):
            centre = rng.normal([0.28 * step, 0.0], np.array([0.1, 0.08]) * step**0.7, (400, 2))
            mean = apart(rng, centre, 12) + rng.normal(0.0, spread, (modes, 12, 2))
            sigma = 0.3 * 0.2 * np.sqrt(step)
            found = dra.collision_probability(
                centre[None], np.array([0.6]), mean[None], np.full((1, 1), sigma), np.ones((1, 12), bool),
                rng.random((1, 2)), 2000,
            )[0]  # fmt: skip
            is_risky = exact(centre, 0.6, mean, sigma) > 0.05
            wrong, risky = wrong + (is_risky & (found <= 0.05)).sum(), risky + is_risky.sum()
    assert risky > 1000
    assert wrong < 0.02 * risky


def test_the_probability_of_one_person_is_exact_but_for_the_lattice():
    rng = np.random.default_rng(1)
    centre, mean = rng.normal(0.0, 0.7, (400, 2)), np.array([[[0.3, -0.2]], [[-0.5, 0.4]]])
    args = np.array([0.6]), mean[None], np.full((1, 1), 0.3), np.array([[True]]), np.array([[0.3, 0.8]])
    found = dra.collision_probability(centre[None], *args, 20000)[0]
    np.testing.assert_allclose(found, exact(centre, 0.6, mean, 0.3), atol=0.01)
    absent = *args[:3], np.array([[False]]), args[4]
    assert (dra.collision_probability(centre[None], *absent, 20000) == 0.0).all()


def test_the_temperature_lets_the_weights_sum_up_to_a_number():
    cost = np.random.default_rng(0).gamma(2.0, 30.0, (5, 200))
    excess = cost - cost.min(axis=1, keepdims=True)
    np.testing.assert_allclose(np.exp(-excess / dra.temperature(excess, 8.0)).sum(axis=1), 8.0, rtol=1e-6)


def test_splines_are_smooth_and_of_a_deviation_of_about_one():
    noise = dra.halton_splines(400, 16)
    assert noise.shape == (400, 16, 2)
    assert noise.std(axis=(0, 2)) == pytest.approx(1.0, abs=0.35)
    assert np.abs(np.diff(noise, axis=1)).mean() < 0.5


def costs(planner, obs, commands):
    futures = planner.predictor.predict(obs, len(commands[0])).position
    return planner.costs(obs, futures, np.array(commands, float)[None])[0]


def test_a_risk_above_the_threshold_costs_most():
    planner = dataclasses.replace(load_planner("dra_mppi", {"predictor": "constant_velocity"}), horizon=4)
    planner.predictor = Says([[[1.0, 0.0]]] * 4)
    obs = lone_vehicle()
    stands, goes = costs(planner, obs, [[[0.0, 0.0]] * 4, [[1.0, 0.0]] * 4])
    assert stands < planner.hard < goes
    planner.predictor = Says([[[1.0, 5.0]]] * 4)
    stands, goes = costs(planner, obs, [[[0.0, 0.0]] * 4, [[1.0, 0.0]] * 4])
    assert stands == pytest.approx(sum(DT * t for t in (1, 2, 3, 4)) + 4 * planner.speed, abs=1e-6)
    assert goes == pytest.approx(planner.change, abs=1e-6)


def drive(planner, obs, steps=60):
    """The positions of a vehicle whose pedestrians stand, up to its goal."""
    planner.reset(obs.row)
    vehicle, ways = obs.vehicle, [obs.vehicle.position[0]]
    for step in range(steps):
        command = planner.plan(dataclasses.replace(obs, vehicle=vehicle, step=np.array([step])))
        assert vehicle.dynamics.is_within(command, vehicle.preferred_speed).all()
        vehicle = propagate_vehicle(vehicle, command, obs)
        ways.append(vehicle.position[0])
        if norm(vehicle.goal - vehicle.position)[0] < 0.3:
            return np.array(ways)
    raise AssertionError(f"at {vehicle.position} after {steps} steps")


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", [Holonomic(), Holonomic(1.0), Unicycle(), Bicycle(1.0)])
def test_without_anybody_it_drives_to_the_goal(dynamics):
    obs = lone_vehicle()
    obs = dataclasses.replace(obs, vehicle=dataclasses.replace(obs.vehicle, dynamics=dynamics))
    assert np.abs(drive(load_planner("dra_mppi", {"predictor": "constant_velocity"}), obs, 24)[:, 1]).max() < 0.4


@pytest.mark.parametrize("dynamics", [Holonomic(), Unicycle()])
def test_it_drives_around_somebody_who_stands_in_the_way(dynamics):
    obs = lone_vehicle()
    obs = dataclasses.replace(obs, vehicle=dataclasses.replace(obs.vehicle, dynamics=dynamics))
    obs.pedestrians.position[:] = [2.0, 0.1]
    planner = load_planner("dra_mppi", {"predictor": "constant_velocity"})
    planner.predictor = Says([[[2.0, 0.1]]] * planner.horizon)
    assert norm(drive(planner, obs) - [2.0, 0.1]).min() > 0.6


def test_it_drives_around_a_block():
    block = np.array([[1.5, -0.9], [2.5, -0.9], [2.5, 0.3], [1.5, 0.3]])[None]
    route = np.array([[[1.5, 0.65], [2.5, 0.65]]])
    obs = dataclasses.replace(lone_vehicle(), obstacles=block[None])
    obs = dataclasses.replace(obs, vehicle=dataclasses.replace(obs.vehicle, route=route))
    planner = load_planner("dra_mppi", {"predictor": "constant_velocity"})
    ways = drive(planner, obs)
    gap = dra.distance_to_walls(ways[None], obs.obstacles)
    assert gap.min() > 0.3


def test_a_case_is_the_same_alone_and_in_company():
    scenario = load_scenario("door_10", {"time_limit": 3.0})
    options = {"predictor": "constant_velocity_sampled", "samples": 30, "points": 400}
    driver = Driver(load_planner("dra_mppi", options), "dra_mppi")
    together = rollout(driver, scenario, Cases("val", 0, 4))
    for case in (3, 1):
        alone = rollout(driver, scenario, Cases("val", case, case + 1))
        np.testing.assert_array_equal(alone.command[0], together.command[case])


def test_several_commands_are_the_start_of_one_plan():
    obs, planner = crowded(), load_planner("dra_mppi", {"predictor": "constant_velocity"})
    planner.predictor = Forks(3)
    planner.reset(obs.row)
    several = planner.plan_ahead(obs, 20)
    planner.reset(obs.row)
    np.testing.assert_array_equal(several[:, 0], planner.plan(obs))
    assert several.shape == (len(obs), 20, 2)


@pytest.mark.parametrize(
    ("name", "value"),
    [("samples", 2), ("horizon", 0), ("points", 3), ("threshold", 0.0), ("noise", 0.0), ("effective", 1.0)],
)
def test_wrong_options_are_refused(name, value):
    with pytest.raises(InputError, match=f"{name} is {value}"):
        load_planner("dra_mppi", {name: value, "predictor": "constant_velocity"})
