import dataclasses
import math

import numpy as np
import pytest
from helpers import drive
from lookahead_scenes import Forks, Nearer, crowded, network, scene, slow_values, within

from crowdbench import load_planner
from crowdbench.core.dynamics.dynamics import speeds_and_headings
from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import METRICS
from crowdbench.planners.kce import ChangeCost, Exploration, Limits, PrintedShaping
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict import ConstantVelocity
from crowdbench.utils.errors import InputError

DT = 0.25

LIMITS = [Limits(), Limits(max_acceleration=2.0), Limits(max_turn=0.5), Limits(max_velocity_change=0.3)]


def at(obs, velocity):
    """The same, with the vehicles at these velocities."""
    vehicle = dataclasses.replace(obs.vehicle, velocity=np.array(velocity, float))
    return dataclasses.replace(obs, vehicle=vehicle)


def moving(velocity):
    """Scenes in which the vehicle has these velocities."""
    obs = at(crowded(2 + len(velocity)).take(slice(2, None)), velocity)
    return scene(obs, ConstantVelocity().predict(obs, 1))


def some_velocities(worlds=40, seed=2):
    """Random velocities up to 1 m/s, among them standing still and the fastest."""
    rng = np.random.default_rng(seed)
    angle, speed = rng.uniform(-np.pi, np.pi, worlds), rng.uniform(0.0, 1.0, worlds)
    speed[:2] = 0.0, 1.0
    return speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


# The filter.


def slow_allows(limits, velocity, command, dt):
    """Whether one vehicle can follow one command, by angles."""
    before, after = np.hypot(*velocity), np.hypot(*command)
    turn = math.atan2(*command[::-1]) - math.atan2(*velocity[::-1])
    turn = abs((turn + math.pi) % (2.0 * math.pi) - math.pi)
    return (
        abs(after - before) <= limits.max_acceleration * dt
        and (min(before, after) == 0.0 or turn <= limits.max_turn)
        and np.hypot(*(command - velocity)) <= limits.max_velocity_change
    )


@pytest.mark.parametrize("limits", LIMITS)
def test_the_filter_allows_what_brute_force_allows(limits):
    velocity = some_velocities()
    seen = moving(velocity)
    rng = np.random.default_rng(5)
    commands = np.concatenate([rng.uniform(-1.0, 1.0, (40, 50, 2)), speeds_and_headings(np.ones(40))], axis=1)
    allowed = limits.allow(seen.vehicle.velocity, commands, DT)
    expected = [[slow_allows(limits, v, c, seen.dt) for c in each] for v, each in zip(velocity, commands, strict=True)]
    assert np.array_equal(allowed, expected)
    assert not allowed.all()


def test_the_published_filter_bounds_turns_of_120_degrees_and_a_change_of_speed_of_1_6():
    def allowed(velocity, degrees, speed):
        turned = speed * np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
        return bool(Limits().allow(moving([velocity]).vehicle.velocity, turned[None, None], DT)[0, 0])

    assert allowed([1.0, 0.0], 119.9, 1.0)
    assert allowed([1.0, 0.0], -119.9, 1.0)
    assert not allowed([1.0, 0.0], 120.1, 1.0)
    assert not allowed([1.0, 0.0], -120.1, 0.01)
    assert allowed([0.0, 0.0], 0.0, 1.6)
    assert not allowed([0.0, 0.0], 0.0, 1.61)


@pytest.mark.parametrize("limits", LIMITS)
def test_from_and_to_standstill_only_the_speed_is_bounded(limits):
    fast, slow = 0.25 * min(limits.max_acceleration, 1.0), 0.29
    still = moving(np.zeros((1, 2)))
    around = fast * np.stack([np.cos(np.arange(7)), np.sin(np.arange(7))], axis=-1)
    assert limits.allow(still.vehicle.velocity, around[None], DT).all()
    assert limits.allow(np.array([[-slow, 0.0]]), np.zeros((1, 1, 2)), DT).all()


@pytest.mark.parametrize("limits", LIMITS)
def test_braking_is_allowed_and_as_hard_as_can_be(limits):
    velocity = some_velocities()
    seen = moving(velocity)
    braked = limits.brake(seen.vehicle.velocity, DT)
    assert limits.allow(seen.vehicle.velocity, braked[:, None], DT).all()
    speed, before = np.linalg.norm(braked, axis=1), np.linalg.norm(velocity, axis=1)
    np.testing.assert_allclose(speed[:, None] * velocity, before[:, None] * braked, atol=1e-12)
    harder = braked * (1.0 - 1e-3 / np.maximum(speed, 1e-3))[:, None]
    assert not limits.allow(seen.vehicle.velocity, harder[:, None], DT)[speed > 1e-3].any()


# The shaped reward.


@pytest.mark.parametrize(
    ("outcome", "gap", "added"),
    [
        (Outcome.COLLISION, -0.1, -0.35),
        (Outcome.RUNNING, 0.19, -0.35),
        (Outcome.SUCCESS, 3.0, -0.35),
        (Outcome.RUNNING, 0.2, 0.0),
        (Outcome.RUNNING, np.inf, 0.0),
    ],
)
def test_the_printed_shaping_acts_in_three_branches_of_four(outcome, gap, added):
    found = PrintedShaping(0.05)(np.array([[outcome]]), np.array([[gap]]), np.array([0.4]))
    assert found == pytest.approx(added, abs=1e-15)


def test_every_change_has_its_cost_wherever_it_is_made():
    outcome = np.array([[Outcome.RUNNING, Outcome.COLLISION], [Outcome.SUCCESS, Outcome.RUNNING]])
    found = ChangeCost(0.1)(outcome, np.array([[1.0, -0.1], [0.1, 0.1]]), np.array([0.5, 2.0]))
    np.testing.assert_allclose(found, [[-0.05, -0.05], [-0.2, -0.2]])


@pytest.mark.parametrize("shaping", [PrintedShaping(0.1), ChangeCost(0.2)])
def test_shaping_is_added_to_the_value_of_a_command(shaping):
    obs, net = crowded(), network()
    predictor = ConstantVelocity()
    seen = scene(obs, predictor.predict(obs, 1))
    commands = speeds_and_headings(obs.vehicle.preferred_speed)
    plain, shaped = (
        ValuePlanner(predictor, net, shaping=each).score(seen, commands).values for each in (None, shaping)
    )
    outcomes = slow_values(seen, commands, net)[1][..., 0]
    change = np.linalg.norm(commands - obs.vehicle.velocity[:, None], axis=-1)
    added = shaped - plain
    if isinstance(shaping, ChangeCost):
        np.testing.assert_allclose(added, -0.2 * change, atol=1e-6)
    else:
        acts = np.isclose(added, 0.1 - change, atol=1e-6)
        assert acts[outcomes != Outcome.RUNNING].all()
        assert (acts | (added == 0.0)).all()
        assert (added == 0.0).any()


# The refined set.


def cases_of_exploration():
    """Scenes and best commands: moving and standing, at full speed, on the goal."""
    velocity = np.repeat(some_velocities(4), 3, axis=0)
    seen = moving(velocity)
    seen.vehicle.goal[5] = seen.vehicle.position[5]
    velocity[5] = 0.0
    fastest = np.stack([seen.vehicle.preferred_speed, np.zeros(12)], axis=1)
    command = np.where((np.arange(12) % 3 == 0)[:, None], 0.0, velocity)
    return seen, np.where((np.arange(12) % 3 == 1)[:, None], fastest, command)


@pytest.mark.parametrize(("epsilon", "n"), [(0.1, 1), (0.05, 2), (0.4, 3)])
def test_the_refined_set_is_a_grid_around_the_command_within_the_speeds(epsilon, n):
    seen, command = cases_of_exploration()
    refined = Exploration(epsilon, n)(seen, command)
    assert refined.shape == (12, (2 * n + 1) ** 2, 2)
    assert np.isfinite(refined).all()
    speed = np.linalg.norm(refined, axis=-1)
    assert (speed <= seen.vehicle.preferred_speed[:, None] * (1.0 + 1e-12)).all()
    np.testing.assert_allclose(np.abs(refined - command[:, None]).max(axis=-1).min(axis=1), 0.0, atol=1e-12)
    for w in np.flatnonzero(np.linalg.norm(command, axis=1) > 0.0):
        before, heading = np.hypot(*command[w]), math.atan2(*command[w, ::-1])
        for i in range(-n, n + 1):
            fast = min(max(before + i * epsilon, 0.0), seen.vehicle.preferred_speed[w])
            for j in range(-n, n + 1):
                turned = fast * np.array([math.cos(heading + j * epsilon), math.sin(heading + j * epsilon)])
                assert np.abs(refined[w] - turned).max(axis=1).min() < 1e-12


@pytest.mark.parametrize("limits", [*LIMITS, Limits(max_acceleration=0.2, max_turn=0.05, max_velocity_change=0.03)])
@pytest.mark.parametrize("explore", [None, Exploration(0.1, 2), Exploration(0.5, 1)])
def test_what_is_commanded_is_within_the_limits_for_any_velocity(limits, explore):
    for seed in range(4):
        obs = crowded(12, seed=seed)
        obs = at(obs, some_velocities(12, seed) * obs.vehicle.preferred_speed[:, None])
        made = ValuePlanner(Forks(2), Nearer(), limits=limits, explore=explore)
        command = made.plan(obs)
        assert limits.allow(obs.vehicle.velocity, command[:, None], obs.dt).all()


def test_a_vehicle_that_can_follow_no_command_brakes_as_hard_as_it_can():
    obs = crowded()
    made = ValuePlanner(ConstantVelocity(), network(), limits=within(0.01))
    velocity = obs.vehicle.velocity
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    np.testing.assert_allclose(made.plan(obs), velocity * (1.0 - 0.01 / speed), atol=1e-12)


# Planners' options.


@pytest.mark.slow
def test_all_of_kce_keeps_its_bound_in_whole_episodes_and_arrives():
    trace = drive(load_planner("sarl_sgan_kce_bounded", {"predictor": "constant_velocity"}), "val:5")
    assert METRICS["success_rate"](trace).mean() >= 0.8
    assert METRICS["max_velocity_change"](trace).max() <= 0.8 + 1e-6


def parts(name, **options):
    """The parts of KCE in a planner that is made with options, as they are written in TOML."""
    made = load_planner(name, options)
    return made.limits, made.shaping, made.explore


@pytest.mark.parametrize("name", ["sarl", "sarl_lin", "sarl_cvm", "sarl_sgan"])
def test_each_part_of_kce_can_be_had_by_itself(name):
    assert parts(name) == (None, None, None)
    assert parts(name, limits={}) == (Limits(), None, None)
    assert parts(name, limits={"max_velocity_change": 1.0}) == (Limits(max_velocity_change=1.0), None, None)
    assert parts(name, shaping={"cost": 0.01}) == (None, ChangeCost(0.01), None)
    assert parts(name, shaping={"threshold": 0.2}) == (None, PrintedShaping(0.2), None)
    assert parts(name, explore={"epsilon": 0.2, "n": 1}) == (None, None, Exploration(0.2, 1))
    assert parts(name, limits={}, explore={}) == (Limits(), None, Exploration())


def test_of_the_papers_method_each_part_can_be_changed_or_left_out():
    own = (Limits(), ChangeCost(0.006), Exploration(0.1, 2))
    assert parts("sarl_sgan_kce") == parts("sarl_sgan_kce", limits={}, shaping={}, explore={}) == own
    assert parts("sarl_sgan_kce", limits=False) == (None, *own[1:])
    assert parts("sarl_sgan_kce", shaping=False) == (own[0], None, own[2])
    assert parts("sarl_sgan_kce", explore=False) == (*own[:2], None)
    slow = Limits(max_acceleration=2.0, max_velocity_change=0.8)
    assert parts("sarl_sgan_kce_bounded", limits={"max_acceleration": 2.0}) == (slow, *own[1:])
    assert parts("sarl_sgan_kce", shaping={"threshold": 0.05}) == (own[0], PrintedShaping(0.05), own[2])
    assert parts("sarl_sgan_kce", explore={"epsilon": 0.2}) == (*own[:2], Exploration(0.2, 2))
    assert load_planner("sarl_sgan_kce", {"shortlist": False}).shortlist is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kce": "all"}, "sarl_cvm has no option 'kce'; its options are: .*limits, shaping, explore"),
        ({"explore": {"epsilon": 0}}, "in explore, epsilon is 0.0, but must be a number above 0"),
        ({"explore": True}, "explore is True, but must be false or a table with epsilon, n"),
        ({"shaping": {"cost": 1, "threshold": 1}}, "but must be false or a table with cost or a table with threshold"),
        ({"limits": {"max_velocity_change": -1.0}}, "in limits, max_velocity_change is -1.0, but must be a number abo"),
        ({"limits": {"max_speed": 1.0}}, "limits is {'max_speed': 1.0}, but must be false or a table with max_accele"),
        ({"shortlist": 0}, "shortlist is 0, but must be a whole number, 1 or more"),
    ],
)
def test_an_impossible_option_gets_one_sentence(options, message):
    with pytest.raises(InputError, match=message):
        load_planner("sarl_cvm", options)


def test_a_turn_of_more_than_half_a_circle_is_refused():
    with pytest.raises(InputError, match=r"max_turn is 3\.2, but must be pi at most"):
        Limits(max_turn=3.2)
