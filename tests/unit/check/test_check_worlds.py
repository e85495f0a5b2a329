"""`crowdbench check` on scenarios: a way out of the walls, people who never arrive, exact symmetry."""

import dataclasses
import functools

import numpy as np
import pytest
from helpers import failed_checks, fixture

from crowdbench.catalog import load_scenario
from crowdbench.check.checks import Subject
from crowdbench.check.drives import SCENARIO
from crowdbench.check.worlds import check_worlds
from crowdbench.core.geometry import pad_points
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.placement import LayoutCall, Placement

ROOM = [(-3.0, -6.0), (3.0, -6.0), (3.0, 6.0), (-3.0, 6.0)]


def findings(layout, cases="val:2", **changes):
    """What is found in the worlds of a layout, by the names of the checks."""
    place = load_scenario("circle_crossing_5", {"pedestrians.policy": "orca", **changes})
    place = dataclasses.replace(place, starts=dataclasses.replace(place.starts, layout=LayoutCall(layout)))
    found = check_worlds(place, Cases.parse(cases))
    return {result.name: result for result in found}


def broken(found):
    return {name for name, result in found.items() if not result.passed}


def in_room(rng, radius, speed, *, gap=0.0):
    """A room with a gap in its last wall, to the left; people in a row."""
    start = np.stack([np.arange(len(radius)) - 2.0, np.full(len(radius), -4.0)], axis=1) + 0.1 * rng.random()
    walls = [[first, second] for first, second in zip(ROOM, ROOM[1:] + ROOM[:1], strict=True)]
    walls[-1][1] = (-3.0, -6.0 + gap)
    return Placement(start, start + np.array([0.0, 8.0]), obstacles=pad_points(walls))


@pytest.mark.parametrize(("gap", "is_open"), [(0.0, False), (0.55, False), (0.7, True), (5.0, True)])
def test_a_gap_through_which_the_vehicle_leaves_is_found(gap, is_open):
    found = findings(functools.partial(in_room, gap=gap), **{"pedestrians.number": 3})
    assert broken(found) == ({"bounds"} if is_open else set())
    said = found["bounds"].observation
    assert ("in case 0, the vehicle can leave the walls around it, at (-3." if is_open else "2 of 2 cases have") in said


def narrow_corner(rng, radius, speed):
    """A corridor of 1.1 m with a corner, and two groups who meet in it."""
    far, side = 9.0, 0.55
    corners = [(-side, -far), (-side, side), (far, side), (far, -side), (side, -side), (side, -far)]
    walls = [[first, second] for first, second in zip(corners, corners[1:] + corners[:1], strict=True)]
    place = 1.5 + np.arange(len(radius) - 1) // 2 * 0.8 + 0.05 * rng.random()
    below, right = (np.stack(pair, axis=1) for pair in ((0 * place, -place), (place, 0 * place)))
    up = (np.arange(len(place)) % 2 == 0)[:, None]
    vehicle, end = np.array([[0.0, -8.5]]), np.array([[8.5, 0.0]])
    start = np.concatenate([vehicle, np.where(up, below, right)])
    goal = np.concatenate([end, np.where(up, right + np.array([4.0, 0.0]), below - np.array([0.0, 4.0]))])
    return Placement(start, goal, obstacles=pad_points(walls))


def test_groups_who_block_each_other_are_named():
    found = findings(narrow_corner, **{"pedestrians.number": 8, "pedestrians.arrival": "leave"})
    assert broken(found) == {"arrivals"}
    assert found["arrivals"].observation.endswith(": they block each other, or have too little time")
    alone = findings(narrow_corner, **{"pedestrians.number": 1, "pedestrians.arrival": "leave"})
    assert alone["arrivals"].observation == "2 of 2 pedestrians arrive in time without a vehicle, 1 of 1 in case 0"


def ring(rng, radius, speed, *, noise=0.0, with_vehicle=False):
    """Everybody, or all pedestrians, equally spaced on a circle, with opposite goals."""
    first = 0 if with_vehicle else 1
    angle = np.arange(len(radius) - first) / (len(radius) - first) * 2.0 * np.pi + 0.3
    start = np.full((len(radius), 2), 20.0)
    start[first:] = 4.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + noise * rng.normal(size=(len(angle), 2))
    return Placement(start, np.where(start == 20.0, 30.0, -start))


@pytest.mark.parametrize("number", [3, 4, 6, 8])
def test_people_in_exact_symmetry_are_named(number):
    found = findings(ring, **{"pedestrians.number": number})
    assert broken(found) == {"symmetry", "arrivals"}
    assert f"a turn by {360 // number} degrees maps {number} agents onto each other" in found["symmetry"].observation
    assert found["arrivals"].observation.startswith(f"0 of {2 * number} pedestrians arrive")
    assert not broken(findings(functools.partial(ring, noise=0.3), **{"pedestrians.number": number}))
    whole = findings(functools.partial(ring, with_vehicle=True), **{"pedestrians.number": number - 1})
    assert "symmetry" in broken(whole)


def test_people_of_different_sizes_are_not_symmetric():
    found = findings(ring, **{"pedestrians.number": 4, "pedestrians.radius": {"low": 0.2, "high": 0.4}})
    assert "symmetry" not in broken(found)


@pytest.mark.parametrize("name", ["corridor", "doorway", "traffic"])
def test_shipped_layouts_pass(name):
    place = load_scenario(fixture(name))
    assert not failed_checks(Subject(SCENARIO, lambda: place, name, {"": place}), "val:2")
