"""Limits of how fast pedestrians change their velocity, in the one place through which all of them move."""

import math

import numpy as np
import pytest
from helpers import Still, advance, drive, same, world

from crowdbench.catalog import load_scenario
from crowdbench.core.dynamics.kernels import limit_change
from crowdbench.core.types import Rules, WalkingLimits
from crowdbench.envs.parallel import parallel_env
from crowdbench.scenario.cases import Cases
from crowdbench.sim import kernels
from crowdbench.sim.presence import track_at
from crowdbench.sim.simulator import crowd_decisions, limit_velocities, step_pedestrians
from crowdbench.utils.errors import InputError

LIMITS = WalkingLimits(acceleration=1.5, braking=3.0, sideways=2.0)
DT = 0.25
TABLE = {"acceleration": 1.5, "braking": 3.0, "sideways": 2.0}


def reference(wanted, before, limits, dt):
    """The same for any number of pedestrians `[pedestrian, 2]`, from the rotation into the direction of walking."""
    speed, heading = np.hypot(*before.T), np.arctan2(before[:, 1], before[:, 0])
    change = wanted - before
    forward = np.cos(heading) * change[:, 0] + np.sin(heading) * change[:, 1]
    left = np.cos(heading) * change[:, 1] - np.sin(heading) * change[:, 0]
    walks = np.clip(speed / (limits.braking * dt), 0.0, 1.0)
    behind, beside = ((1 - walks) * limits.acceleration + walks * limit for limit in (limits.braking, limits.sideways))
    along = np.where(forward > 0.0, limits.acceleration, behind)
    share = 1.0 / np.maximum(np.sqrt((forward / along) ** 2 + (left / beside) ** 2) / dt, 1.0)
    return before + share[:, None] * change


def limited(wanted, before, limits=LIMITS, dt=DT):
    return np.array([limit_change(*one, *other, limits, dt) for one, other in zip(wanted, before, strict=True)])


@pytest.mark.parametrize("limits", [LIMITS, WalkingLimits(2.0, 1.0, 0.5), WalkingLimits(0.3, 4.0, 6.0)])
@pytest.mark.parametrize("dt", [0.1, 0.25])
def test_changes_are_shortened_into_the_ellipse(limits, dt):
    random = np.random.default_rng(0)
    before, wanted = random.normal(size=(2, 2000, 2)) * random.uniform(0.0, 2.0, (2, 2000, 1))
    before[:50] = 0.0
    after = limited(wanted, before, limits, dt)
    assert after == pytest.approx(reference(wanted, before, limits, dt), abs=1e-12)
    assert 0.0 < (after == wanted).all(axis=1).mean() < 1.0


def test_the_largest_changes_are_those_that_the_limits_say():
    walking, far = np.array([[1.0, 0.0]]), 100.0
    for way, change in (([far, 0], [1.5, 0]), ([-far, 0], [-3.0, 0]), ([0, far], [0, 2.0]), ([0, -far], [0, -2.0])):
        assert (limited(walking + np.array([way]), walking) - walking)[0] / DT == pytest.approx(change, abs=1e-9)
    angles = np.linspace(0.0, 6.0, 9)
    started = limited(far * np.stack([np.cos(angles), np.sin(angles)], axis=1), np.zeros((9, 2)))
    assert np.hypot(*started.T) / DT == pytest.approx(1.5)


def test_who_turns_round_stops_first_and_then_sets_out():
    slow, stops = 0.3, 0.3 / LIMITS.braking
    after = limited(np.array([[-9.0, 0.0]]), np.array([[slow, 0.0]]))
    assert after[0] == pytest.approx([-LIMITS.acceleration * (DT - stops), 0.0])


def test_only_pedestrians_who_are_present_and_not_recorded_have_limits():
    rules = Rules(walking=LIMITS._replace(exempt=1))
    start = world([[0, 0], [3, 0], [6, 0]], rules=rules).replace(policy=np.array([[0, 1]]))
    after = advance(start, np.full((1, 3, 2), [0.0, 1.0]))
    assert after.velocity[0].tolist() == [[0.0, 1.0], [0.0, 1.5 * DT], [0.0, 1.0]]
    assert after.position[0, 1].tolist() == [3.0, 1.5 * DT * DT]
    gone = start.replace(present=np.array([[True, False, False]]), velocity=np.ones((1, 3, 2)))
    assert not advance(gone, np.ones((1, 3, 2))).velocity[0, 1:].any()
    free = advance(start.replace(rules=Rules()), np.full((1, 3, 2), [0.0, 1.0]))
    assert free.velocity[0].tolist() == [[0.0, 1.0]] * 3


def test_recorded_cars_keep_to_their_tracks_among_people_with_limits(shared):
    scenario = load_scenario("dut_reactive", data=shared / "data" / "dut")
    now = scenario.worlds(Cases.parse("test:8:13"))
    cars, seen = now.policy == scenario.rules.walking.exempt, 0
    for _ in range(12):
        crowd, now = crowd_decisions(now, scenario.policies)
        now = step_pedestrians(now, crowd, scenario.post_step_rule)
        rows = cars & now.present[:, 1:]
        assert now.position[:, 1:][rows] == pytest.approx(track_at(now, now.step)[rows], abs=1e-9)
        seen += rows.sum()
    assert seen > 12


@pytest.mark.parametrize("name", ["mixed_20", "street_8", pytest.param("thousand", marks=pytest.mark.slow)])
def test_bits_do_not_depend_on_other_cases_or_threads(name, monkeypatch):
    changes, cases = {"pedestrians__limits": TABLE}, "val:3" if name != "thousand" else "val:2"
    together = drive("orca_margin", cases, name, **changes)
    last = Cases.parse(cases).stop - 1
    alone = drive("orca_margin", f"val:{last}:{last + 1}", name, **changes)
    for field in ("position", "velocity"):
        assert np.array_equal(getattr(together, field)[-1:], getattr(alone, field), equal_nan=True)
    for number in (1, 5):
        monkeypatch.setattr(kernels, "number_of_threads", lambda number=number: number)
        assert same(drive("orca_margin", cases, name, **changes), together)


def largest_acceleration(velocity):
    """The largest change of velocity, `[world, time, ...]`, per second."""
    return np.nanmax(np.linalg.norm(np.diff(velocity, axis=1), axis=-1)) / DT


@pytest.mark.parametrize("policy", ["orca", "social_force", "power_law", "stop_and_go", "straight"])
def test_every_policy_keeps_them_with_and_without_the_vehicle(policy):
    changes = {"pedestrians__policy": policy, "vehicle__visible": True}
    tight = {"acceleration": 0.5, "braking": 1.0, "sideways": 0.7}
    free = drive(Still(), "val:4", "circle_crossing_10", **changes)
    trace = drive(Still(), "val:4", "circle_crossing_10", pedestrians__limits=tight, **changes)
    assert largest_acceleration(free.velocity) > 1.2
    assert largest_acceleration(trace.velocity) <= 1.0 + 1e-9
    assert largest_acceleration(np.diff(trace.undisturbed, axis=1) / DT) <= 1.0 + 1e-9


def test_what_is_foreseen_is_what_happens():
    scenario = load_scenario("mixed_20", {"pedestrians.limits": TABLE})
    now = scenario.worlds(Cases.parse("val:3"))
    for _ in range(20):
        crowd, now = crowd_decisions(now, scenario.policies)
        ahead = limit_velocities(now, crowd)
        now = step_pedestrians(now, crowd, None)
        assert np.array_equal(now.velocity[:, 1:], ahead)
    assert not np.array_equal(ahead, crowd)


@pytest.mark.parametrize("policy", ["orca", "social_force"])
def test_pedestrians_that_learn_have_them_too(policy):
    changes = {"pedestrians.limits": TABLE, "pedestrians.policy": policy}
    env = parallel_env(load_scenario("circle_crossing_5", changes))
    env.reset(options={"case": "val/0"})
    assert (env._compiled is None) == (policy != "orca")
    env.step({"vehicle": np.zeros(2), "pedestrian_2": np.array([0.6, 0.8])})
    velocity = (env._compiled.world if env._compiled else env._world).velocity[0, 3]
    assert velocity == pytest.approx([0.6 * 1.5 * DT, 0.8 * 1.5 * DT])


def test_they_are_a_part_of_the_scenario():
    free, full = (load_scenario("circle_crossing_5", {"pedestrians.limits": limits}) for limits in (None, TABLE))
    assert free.digest == load_scenario("circle_crossing_5").digest
    assert free.rules.walking is None
    assert full.rules.walking == (*LIMITS[:3], 1)  # of policies, orca comes before recorded people
    assert full.table["pedestrians"]["limits"] == TABLE
    weaker = load_scenario("circle_crossing_5", {"pedestrians.limits": TABLE | {"braking": 2.0}})
    assert len({free.digest, full.digest, weaker.digest}) == 3
    for rules in (free.rules, full.rules):
        assert Rules.of_table(rules.to_table()) == rules


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"braking": 3.0}, "pedestrians.limits.acceleration is missing, but must be a number above 0"),
        (TABLE | {"braking": 0.0}, "pedestrians.limits.braking is 0.0, but must be a number above 0 and below 1000"),
        (TABLE | {"acceleration": math.inf}, "pedestrians.limits.acceleration is inf, but must be"),
        (
            TABLE | {"turning": 1.0},
            "unknown key pedestrians.limits.turning; the keys here are acceleration, braking, sideways",
        ),
        (1.5, "pedestrians.limits is 1.5, but must be a table with the keys of { acceleration = 1.5"),
    ],
)
def test_a_bad_limit_gets_one_sentence(limits, words):
    with pytest.raises(InputError) as error:
        load_scenario("circle_crossing_5", {"pedestrians.limits": limits})
    assert words in str(error.value)
    assert "\n" not in str(error.value)
