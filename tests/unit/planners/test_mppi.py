"""MPPI: what a sequence costs, worked out slowly; that sampling finds cheap ones; that a row is the same in company."""

import dataclasses

import numpy as np
import pytest
from lookahead_scenes import DT, Forks, Says, crowded, lone_vehicle

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.dynamics import Bicycle, Unicycle
from crowdbench.core.geometry import norm
from crowdbench.core.types import Outcome
from crowdbench.planners.driver import Driver
from crowdbench.planners.last_plans import LastPlans
from crowdbench.planners.mppi import SHOWN, MPPIPlanner, MPPISearch, MPPIWeights
from crowdbench.planners.scene import scene_of
from crowdbench.predict.linear import ConstantVelocity
from crowdbench.predict.predictor import Prediction
from crowdbench.record.decisions import marks_of
from crowdbench.record.explanation import legend_text
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

EXACT = np.zeros((1, 1, 1))
WEIGHTS = MPPIWeights(contact=50.0, uncertain=0.0, fading=0.9, near=4.0, margin=0.3, growth=0.2, change=0.5, jerk=0.25)


def cost(planner, obs, commands, halo=EXACT):
    """The cost of one sequence."""
    steps = len(commands)
    scene = scene_of(obs, planner.predictor.predict(obs, steps), 0, obs.vehicle, steps)
    costs, result = planner.costs(scene, np.array(commands, float)[None, None], halo)
    return costs[0, 0], result


def test_a_way_costs_its_time_and_the_changes_of_its_commands():
    planner = MPPIPlanner(Says([[[9.0, 9.0]]] * 3), weights=WEIGHTS)
    found, _ = cost(planner, lone_vehicle(), [[1.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    left = 4.0 - 2 * DT
    assert found == pytest.approx(3 * DT + left + 0.5 * (1.0 + 0.0 + 1.0) + 0.25 * (1.0 + 1.0))
    arrived, result = cost(planner, lone_vehicle(goal=(0.7, 0.0)), [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    assert result.outcome[0, 0, 0] == Outcome.SUCCESS
    assert arrived == pytest.approx(2 * DT + 0.5 + 0.25)


def test_a_gap_inside_the_margin_costs_and_a_contact_costs_more_the_sooner_it_is():
    near = 0.3 + 0.3 + 0.1
    planner = MPPIPlanner(Says([[[0.0, near]]] * 2), weights=WEIGHTS)
    obs = lone_vehicle()
    obs.pedestrians.position[:] = [0.0, near]
    found, _ = cost(planner, obs, [[0.0, 0.0]] * 2)
    inside = (1.0 - 0.1 / 0.3) ** 2 + 0.9 * (1.0 - 0.1 / (0.3 + 0.2 * DT)) ** 2
    assert found == pytest.approx(2 * DT + 4.0 + 4.0 * inside)
    planner = MPPIPlanner(Says([[[0.0, 9.0]], [[0.0, 0.5]]]), weights=WEIGHTS)
    obs.pedestrians.position[:] = [0.0, 9.0]
    found, result = cost(planner, obs, [[0.0, 0.0]] * 2)
    assert result.steps[0, 0, 0] == 2
    assert found == pytest.approx(2 * DT + 4.0 + 0.9 * 4.0 + 50.0 * 0.9)


def test_a_halo_costs_by_its_depth_and_is_no_contact():
    weights = dataclasses.replace(WEIGHTS, uncertain=7.0)
    planner = MPPIPlanner(Says([[[0.0, 0.8]]] * 2), weights=weights)
    obs = lone_vehicle()
    obs.pedestrians.position[:] = [0.0, 0.8]
    found, result = cost(planner, obs, [[0.0, 0.0]] * 2, np.array([[[0.1], [0.5]]]))
    np.testing.assert_allclose(result.gap[0, 0, 0], [0.1, -0.3])
    assert result.outcome[0, 0, 0] == Outcome.RUNNING
    near = 4.0 * (1.0 - 0.1 / 0.3) ** 2 + 0.9 * (4.0 + 7.0 * 0.3)
    assert found == pytest.approx(2 * DT + 4.0 + near)


@pytest.mark.parametrize(("worst", "futures"), [(1.0, 4), (0.5, 2), (0.2, 1)])
def test_of_several_futures_the_mean_over_the_worst_share_counts(worst, futures):
    obs, planner = crowded(), MPPIPlanner(Forks(4), worst=worst)
    commands = np.random.default_rng(0).normal(0.0, 0.3, (len(obs), 5, 4, 2))
    answer = Forks(4).predict(obs, 4)

    def costs(modes):
        some = Prediction(answer.position[:, modes], answer.velocity[:, modes])
        return planner.costs(scene_of(obs, some, 0, obs.vehicle, 4), commands, EXACT)[0]

    each = np.sort([costs(slice(mode, mode + 1)) for mode in range(4)], axis=0)
    np.testing.assert_allclose(costs(slice(None)), each[-futures:].mean(axis=0))
    assert (each[0] < each[-1]).any()


@pytest.mark.parametrize("dynamics", [None, Unicycle(), Bicycle(1.0)])
def test_without_anybody_it_drives_to_the_goal(dynamics):
    planner, obs = MPPIPlanner(ConstantVelocity()), lone_vehicle()
    planner.reset(obs.row)
    vehicle = dataclasses.replace(obs.vehicle, **({"dynamics": dynamics} if dynamics else {}))
    for step in range(24):
        commands = planner.plan(dataclasses.replace(obs, vehicle=vehicle, step=np.array([step])))
        assert vehicle.dynamics.is_within(commands, vehicle.preferred_speed).all()
        vehicle = dataclasses.replace(
            vehicle, **vehicle.dynamics.step(vehicle.state, commands, vehicle.preferred_speed, DT)._asdict()
        )
        if norm(vehicle.goal - vehicle.position)[0] < 0.3:
            break
    assert norm(vehicle.goal - vehicle.position)[0] < 0.3


def test_a_case_is_the_same_alone_and_in_company():
    scenario = load_scenario("unicycle", {"time_limit": 3.0})
    driver = Driver(load_planner("mppi", {"search": {"samples": 20}}), "mppi")
    together = rollout(driver, scenario, Cases("val", 0, 4))
    for case in (3, 1):
        apart = rollout(driver, scenario, Cases("val", case, case + 1))
        np.testing.assert_array_equal(apart.command[0], together.command[case])


def test_the_next_decision_starts_from_the_rest_of_the_last_plan():
    obs, plans = crowded(), LastPlans(4)
    plans.reset(obs.row)
    otherwise = np.full((len(obs), 4, 2), 7.0)
    np.testing.assert_array_equal(plans.remaining(obs, otherwise), otherwise)
    made = np.random.default_rng(0).normal(size=(len(obs), 4, 2))
    plans.store(obs, made)
    later = dataclasses.replace(obs.take(slice(2, 4)), step=obs.step[2:4] + np.array([1, 3]))
    found = plans.remaining(later, otherwise[:2])
    np.testing.assert_array_equal(found[0], made[2, [1, 2, 3, 3]])
    np.testing.assert_array_equal(found[1], made[3, [3, 3, 3, 3]])


def test_the_predicted_and_the_sampled_ways_are_logged():
    obs = dataclasses.replace(crowded(), logs={})
    planner = MPPIPlanner(Forks(2), MPPISearch(samples=30), horizon=5)
    planner.reset(obs.row)
    planner.plan(obs)
    assert obs.logs["predicted"].shape == (len(obs), 2, 5, 4, 2)
    assert obs.logs["sampled"].shape == (len(obs), 5, SHOWN, 3)
    assert np.isfinite(obs.logs["sampled"]).all()
    assert (np.diff(obs.logs["sampled"][:, 0, :, 2], axis=1) <= 0.0).all()  # the best ones, the first is the best
    assert obs.logs["planned"].shape == (len(obs), 5, 1, 2)


def test_a_recording_says_what_the_lines_mean():
    driver = Driver(load_planner("mppi", {"search": {"samples": 20}}), "mppi")
    scenario = load_scenario("circle_crossing_5", {"time_limit": 1.5})
    trace = rollout(driver, scenario, Cases("val", 0, 1), keep_logs=True)
    assert marks_of(trace) == {"predicted", "considered", "planned"}
    legend = legend_text(trace, 0)
    assert "brown lines | the best 12 of the paths that were considered" in legend
    assert "star" not in legend


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ({"search": {"samples": 0}}, "samples is 0, but must be a whole number, 1 or more"),
        ({"search": {"temperature": 0.0}}, "temperature is 0.0, but must be a number above 0"),
        ({"weights": {"margin": 0.0}}, "margin is 0.0, but must be above 0"),
        ({"worst": 0.0}, "worst is 0.0, but must be above 0, and 1 at most"),
    ],
)
def test_wrong_options_are_refused(wrong, right):
    with pytest.raises(InputError, match=right):
        load_planner("mppi", wrong)


def test_a_wall_counts_where_a_contact_is_predicted_in_the_same_step():
    obs = dataclasses.replace(lone_vehicle(), obstacles=np.array([[[[0.45, -2.0], [0.45, 2.0]]]]))
    planner = MPPIPlanner(Says([[[0.5, 0.0]]] * 2), weights=WEIGHTS)
    obs.pedestrians.position[:] = [0.5, 0.0]
    found, into = cost(planner, obs, [[1.0, 0.0]] * 2)
    away, back = cost(planner, obs, [[-1.0, 0.0]] * 2)
    assert into.outcome[0, 0, 0] == Outcome.WALL_COLLISION
    assert back.outcome[0, 0, 0] == Outcome.COLLISION
    assert found > away + WEIGHTS.wall - WEIGHTS.contact - 10.0
