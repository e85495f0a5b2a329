"""Scans of a lidar: geometry against a slow reference, legs, disturbances, and every agent."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import world

from crowdbench.catalog import load_scenario
from crowdbench.core.types import Lidar, Rules, Sensor
from crowdbench.scenario.cases import Cases
from crowdbench.sim.lidar import DEFAULT_LIDAR, LEG_OFFSET, LEG_RADIUS, STEP_RATE, scan, scan_of
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.utils.errors import InputError

REACH = 8.0


def edges(obstacles):
    for polygon in obstacles:
        corners = polygon[~np.isnan(polygon[:, 0])].tolist()
        for k in range(len(corners) if len(corners) > 2 else len(corners) - 1):
            yield *corners[k], *corners[(k + 1) % len(corners)]


def slow_scan(x, y, heading, discs, obstacles, beams, reach):
    """Cast each beam at each edge and at each disc, in the order of operations of lidars before legs."""
    distances = []
    for k in range(beams):
        angle = heading + 2.0 * math.pi * k / beams
        ux, uy = math.cos(angle), math.sin(angle)
        share, dx, dy = 1.0, reach * ux, reach * uy
        for x1, y1, x2, y2 in edges(obstacles):
            ax, ay = x1 - x, y1 - y
            ex, ey = x2 - x - ax, y2 - y - ay
            turn = dx * ey - dy * ex
            if turn != 0.0 and 0.0 <= (ax * dy - ay * dx) / turn <= 1.0 and (ax * ey - ay * ex) / turn >= 0.0:
                share = min(share, (ax * ey - ay * ex) / turn)
        least = reach * share
        for cx, cy, radius in discs:
            dx, dy = cx - x, cy - y
            along, aside = dx * ux + dy * uy, dx * uy - dy * ux
            root = radius * radius - aside * aside
            if root > 0.0 and along + math.sqrt(root) > 0.0 and math.sqrt(dx * dx + dy * dy) - radius < reach:
                least = min(least, max(along - math.sqrt(root), 0.0))
        distances.append(least)
    return distances


def slow_scans(worlds, beams, reach):
    """Scan as the vehicle with `slow_scan`."""
    for w in range(len(worlds)):
        there = worlds.present[w, 1:]
        people = np.concatenate([worlds.position[w, 1:], worlds.radius[w, 1:, None]], axis=1)[there].tolist()
        x, y = worlds.position[w, 0].tolist()
        yield slow_scan(x, y, float(worlds.heading[w]), people, worlds.obstacles[w], beams, reach)


@pytest.mark.parametrize("name", ["circle_crossing_10", "door_10", "shop_10"])
@pytest.mark.parametrize("beams", [1, 7, 60])
def test_every_bit_of_a_scan_is_that_of_beams_cast_at_all_people_and_walls(name, beams):
    worlds = load_scenario(name).worlds(Cases("val", 0, 6))
    rng = np.random.default_rng(0)
    for shift in (0.0, 0.5, 3.0):
        position = worlds.position + rng.normal(0.0, shift, worlds.position.shape)
        position[:2, 1] = position[:2, 0] + 0.1  # the vehicle overlaps a person
        moved = worlds.replace(position=position, heading=rng.uniform(-7.0, 7.0, len(worlds)))
        expected = list(slow_scans(moved, beams, REACH))
        np.testing.assert_array_equal(scan(moved, Lidar(beams=beams, range=REACH))[:, 0], expected)


@pytest.mark.parametrize("place", [(1.0, 1.0), (2.0, 1.0), (1.0 + 1e-9, 1.0), (2.0, 1.0 + 1e-9)])
def test_a_scan_from_a_wall_is_that_of_beams_cast_at_it(place):
    made = world([place, [9.0, 9.0]])
    walls = np.array([[[[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]]]])
    made = made.replace(obstacles=walls)
    expected = list(slow_scans(made, 36, REACH))
    np.testing.assert_array_equal(scan(made, Lidar(beams=36, range=REACH))[:, 0], expected)


def car_world():
    """A world after some steps with a car of several discs that people see."""
    scenario = load_scenario("car_28", {"vehicle.visible": True})
    worlds = scenario.worlds(Cases("val", 0, 2))
    for _ in range(3):
        worlds, _ = step(worlds, np.tile([1.0, 0.2], (2, 1)), crowd_velocities(worlds, scenario.policies))
    return worlds


def test_every_agent_scans_the_others_along_its_heading_and_people_scan_the_body_of_the_vehicle():
    worlds = car_world()
    agents, body = worlds.radius.shape[1], np.array(worlds.rules.body)
    assert len(body) > 1
    scans = scan(worlds, Lidar(beams=24, range=REACH), agents)
    for w in range(len(worlds)):
        ahead = np.array([math.cos(worlds.heading[w]), math.sin(worlds.heading[w])])
        discs = {0: [(*(worlds.position[w, 0] + offset * ahead), worlds.radius[w, 0]) for offset in body]}
        discs |= {a: [(*worlds.position[w, a], worlds.radius[w, a])] for a in range(1, agents) if worlds.present[w, a]}
        for a in discs:
            heading = math.atan2(*worlds.velocity[w, a, ::-1]) if a else worlds.heading[w]
            others = [disc for owner, parts in discs.items() if owner != a for disc in parts]
            x, y = worlds.position[w, a]
            expected = slow_scan(x, y, heading, others, worlds.obstacles[w], 24, REACH)
            np.testing.assert_allclose(scans[w, a], expected, atol=1e-9)


def test_people_do_not_scan_an_invisible_vehicle():
    made = world([[0.0, 0.0], [3.0, 0.0]])
    assert scan(made, Lidar(beams=4, range=REACH), 2)[0].tolist() == [[2.7, 8.0, 8.0, 8.0], [8.0] * 4]
    seen = made.replace(rules=dataclasses.replace(made.rules, visible=True))
    assert scan(seen, Lidar(beams=4, range=REACH), 2)[0, 1] == pytest.approx([8.0, 8.0, 2.7, 8.0])


def feet(speed, steps, dt=0.1):
    """Return the positions along x of both feet of a person who walks along x below the lidar."""
    found, lidar = [], Lidar(beams=3600, range=REACH, legs=True)
    for k in range(steps):
        made = world([[speed * k * dt, -3.0], [speed * k * dt, 0.0]], [[0.0, 0.0], [speed, 0.0]], rules=Rules(dt=dt))
        distance = scan(made.replace(step=np.array([k])), lidar)[0, 0]
        angle = 2.0 * np.pi * np.arange(3600) / 3600
        x, y = speed * k * dt + distance * np.cos(angle), distance * np.sin(angle) - 3.0
        hit = distance < REACH
        left, right = (x[hit & side].mean() for side in (y > 0.0, y < 0.0))
        found.append((left, right))
    return np.array(found)


def test_the_legs_of_a_person_who_stands_are_side_by_side():
    made = world([[0.0, -3.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]).replace(heading=np.array([np.pi / 2]))
    distance = scan(made, Lidar(beams=720, range=REACH, legs=True))[0, 0]
    assert distance[0] == pytest.approx(3.0 - LEG_OFFSET - LEG_RADIUS)  # the right leg hides the left one
    assert (distance < REACH).sum() == pytest.approx(2 * math.degrees(math.asin(LEG_RADIUS / 2.9)) * 2, abs=2)


def test_a_foot_stays_in_place_while_the_other_one_makes_two_steps():
    speed, period = 1.3, 2.0 / STEP_RATE
    moves = np.diff(feet(speed, 22), axis=0)
    # The hit points of a round leg differ from its centre by its radius at most.
    stands = np.abs(moves) < 0.03
    assert stands.any(axis=1).mean() > 0.7
    assert moves.max() == pytest.approx(2.0 * speed * 0.1, abs=0.08)
    assert moves[: round(period / 0.1)].sum(axis=0) == pytest.approx(speed * period, abs=0.2)


def test_two_people_have_gaits_of_different_phases_and_the_same_person_one_of_its_own():
    made = world([[0.0, 0.0], [3.0, 0.0], [-3.0, 0.0]], [[0.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    lidar = Lidar(beams=720, range=REACH, legs=True)
    distance = scan(made, lidar)[0, 0]
    assert not np.allclose(np.roll(distance, 360), distance)
    swapped = made.replace(position=made.position[:, [0, 2, 1]], person=made.person[:, ::-1].copy())
    np.testing.assert_array_equal(scan(swapped, lidar)[0, 0], distance)


def surrounded(worlds=40, **disturbances):
    """Return scans of a lidar in a square room, exact and disturbed."""
    made = world([[0.0, 0.0], [90.0, 0.0]])
    room = np.array([[[[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]]]])
    many = made.replace(obstacles=room).take(np.zeros(worlds, int)).replace(key=np.arange(worlds, dtype=np.uint64))
    exact, disturbed = (scan(many, Lidar(beams=500, range=REACH, **kind))[:, 0] for kind in ({}, disturbances))
    return exact, disturbed


def test_distances_have_normal_noise():
    exact, noisy = surrounded(noise=0.05)
    error = (noisy - exact)[exact < REACH]
    assert error.mean() == pytest.approx(0.0, abs=0.002)
    assert error.std() == pytest.approx(0.05, rel=0.03)
    assert (np.abs(error) > 0.1).mean() == pytest.approx(0.0455, abs=0.006)


def test_lost_echoes_return_the_range_and_false_ones_less_than_the_distance():
    exact, lost = surrounded(dropout=0.1)
    assert (lost == REACH).mean() == pytest.approx(0.1, abs=0.01)
    assert set(np.unique((lost == exact) | (lost == REACH))) == {True}
    exact, false = surrounded(false_returns=0.2)
    is_false = false != exact
    assert is_false.mean() == pytest.approx(0.2, abs=0.01)
    share = (false / exact)[is_false]
    np.testing.assert_allclose(np.quantile(share, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.03)


def test_a_beam_that_meets_nothing_has_no_noise():
    made = world([[0.0, 0.0], [3.0, 0.0]])
    distance = scan(made, Lidar(beams=360, range=REACH, noise=0.5, dropout=0.5))[0, 0]
    assert (distance[20:-20] == REACH).all()


DISTURBED = {"beams": 30, "range": REACH, "legs": True, "noise": 0.1, "dropout": 0.1, "false_returns": 0.1}


def test_a_scan_is_the_same_alone_and_in_any_batch_and_differs_between_cases_steps_and_agents():
    scenario = load_scenario("door_10", {"sensor.lidar": DISTURBED})
    worlds = scenario.worlds(Cases("val", 0, 5))
    together = observe(worlds).lidar
    alone = [observe(scenario.worlds(Cases("val", k, k + 1))).lidar[0] for k in (3, 0)]
    np.testing.assert_array_equal(together[[3, 0]], alone)
    np.testing.assert_array_equal(together, scan(worlds, scenario.rules.sensor.lidar, 5)[:, 0])
    same_place = worlds.take(np.array([0, 0])).replace(key=worlds.key[:2])
    assert (np.diff(observe(same_place).lidar, axis=0) != 0.0).any()
    later = worlds.replace(step=worlds.step + 1)
    noisy = Lidar(beams=30, range=REACH, noise=0.1)
    assert (scan(later, noisy) != scan(worlds, noisy)).any()


def test_what_planners_see_does_not_determine_the_noise():
    worlds = load_scenario("door_10", {"sensor.lidar": DISTURBED}).worlds(Cases("val", 0, 3))
    other = worlds.replace(noise_key=worlds.noise_key + np.uint64(1))
    np.testing.assert_array_equal(observe(worlds).lidar, observe(other).lidar)


def test_the_default_lidar_measures_the_people_in_the_observation():
    worlds = load_scenario("door_10").worlds(Cases("val", 0, 3))
    np.testing.assert_array_equal(scan_of(observe(worlds)), scan(worlds, DEFAULT_LIDAR)[:, 0])
    disturbed = load_scenario("door_10", {"sensor.lidar": DISTURBED}).worlds(Cases("val", 0, 3))
    np.testing.assert_array_equal(scan_of(observe(disturbed)), observe(disturbed).lidar)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("beams", 10**9),
        ("beams", 0),
        ("beams", True),
        ("range", math.inf),
        ("noise", -0.1),
        ("noise", math.nan),
        ("dropout", 1.0),
        ("false_returns", 10**400),
        ("legs", 1),
        ("legs", "yes"),
    ],
)
def test_impossible_lidars_are_refused_with_their_key(key, value):
    with pytest.raises(InputError, match=rf"sensor\.lidar\.{key} is .* but must be "):
        load_scenario("circle_crossing_5", {"sensor.lidar": {"beams": 9, "range": 3.0, key: value}})


def test_defaults_that_are_written_out_change_no_digest():
    plain = {"beams": 9, "range": 3.0}
    written = plain | {"legs": False, "noise": 0.0, "dropout": 0.0, "false_returns": 0.0}
    digests = {load_scenario("circle_crossing_5", {"sensor.lidar": lidar}).digest for lidar in (plain, written)}
    assert len(digests) == 1
    for key, value in (("legs", True), ("noise", 0.1), ("dropout", 0.1), ("false_returns", 0.1)):
        digests.add(load_scenario("circle_crossing_5", {"sensor.lidar": plain | {key: value}}).digest)
    assert len(digests) == 5
    assert Sensor(lidar=Lidar(**plain)) == Sensor(lidar=Lidar(**written))
