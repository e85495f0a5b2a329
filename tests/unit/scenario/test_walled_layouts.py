"""The built-in layouts with walls: room for everybody, and ways around what stands in between."""

import numpy as np
import pytest
import shapely
from helpers import drive, fixture

from crowdbench.catalog import load_scenario
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

WALLED = ("blind_corner", "corridor", "doorway", "intersection", "room", "traffic")
CASES = Cases.parse("val:20")


def walls(obstacles):
    """The edges of the obstacles of one world."""
    corners = [polygon[np.isfinite(polygon[:, 0])] for polygon in obstacles]
    return shapely.GeometryCollection([shapely.LineString([*each, each[0]]) for each in corners if len(each)])


def gaps(points, radius):
    """Distances between the rims of discs."""
    gap = np.linalg.norm(points[:, None] - points, axis=2) - radius[:, None] - radius
    return gap[np.triu_indices(len(points), 1)]


@pytest.mark.parametrize("name", WALLED)
def test_everybody_has_room_at_the_start_and_at_the_goal(name):
    start = load_scenario(fixture(name), {"pedestrians.number": 6}).worlds(CASES)
    for case in range(len(start)):
        around = walls(start.obstacles[case])
        for points in (start.position[case], start.goal[case]):
            assert gaps(points, start.radius[case]).min() >= 0.2 - 1e-9
            assert (shapely.distance(shapely.points(points), around) >= start.radius[case] + 0.2 - 1e-9).all()


@pytest.mark.parametrize("name", WALLED)
def test_the_vehicles_way_is_some_eight_metres(name):
    start = load_scenario(fixture(name)).worlds(CASES)
    for case in range(len(start)):
        waypoints = start.route[case, 0][np.isfinite(start.route[case, 0, :, 0])]
        way = shapely.LineString([start.position[case, 0], *waypoints, start.goal[case, 0]])
        assert 7.5 < way.length < 9.5
        assert way.distance(walls(start.obstacles[case])) >= 0.3


def test_in_a_doorway_and_around_a_corner_people_come_from_both_sides():
    for name, axis in (("doorway", 1), ("blind_corner", 0), ("corridor", 1)):
        start = load_scenario(fixture(name)).worlds(CASES)
        ahead = (start.goal - start.position)[:, 1:, axis] > 0
        assert 0.2 < ahead.mean() < 0.8


@pytest.mark.parametrize("against", [0.0, 1.0])
def test_the_share_of_people_against_the_vehicle_is_an_option(against):
    start = load_scenario(fixture("traffic"), {"layout.against": against}).worlds(CASES)
    assert ((start.goal[:, 1:, 1] < start.position[:, 1:, 1]) == bool(against)).all()


def test_two_streams_cross_in_the_intersection():
    start = load_scenario(fixture("intersection")).worlds(CASES)
    way = (start.goal - start.position)[:, 1:]
    across = np.abs(way[..., 0]) > np.abs(way[..., 1])
    assert 0.3 < across.mean() < 0.7
    assert len(np.unique(np.sign(way[across][:, 0]))) == len(np.unique(np.sign(way[~across][:, 1]))) == 2


def test_a_room_has_as_many_blocks_as_asked_and_others_in_every_case():
    obstacles = load_scenario(fixture("room"), {"layout.blocks": 3}).worlds(CASES).obstacles
    assert obstacles.shape[1] == 4 + 3
    assert len(np.unique(obstacles[:, 4, 0, 0])) == len(obstacles)


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("doorway", {"door_width": 12.0}, "layout.door_width is 12 m, but must be below layout.width, 10 m"),
        ("doorway", {"door_width": 0.63}, "no way leads the vehicle from .* it needs gaps of at least 0.64 m"),
        ("traffic", {"against": 1.5}, "layout.against is 1.5, but must be a share from 0 to 1"),
        ("room", {"blocks": 60}, "block .* of 60 finds no room: lower layout.blocks or raise layout.width"),
        pytest.param(
            *("corridor", {"width": 0.9}, "pedestrian 1 of 5 finds no room on one end of a corridor of 0.9 m"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_options_that_leave_no_room_are_told_with_the_case(name, options, sentence):
    place = load_scenario(fixture(name), {f"layout.{option}": value for option, value in options.items()})
    with pytest.raises(InputError, match=f"{name}.toml: in case test/0, {sentence}"):
        place.worlds(Cases.parse("1"))


def test_a_way_has_a_waypoint_at_least_every_metre():
    for name in ("doorway", "blind_corner"):
        start = load_scenario(fixture(name)).worlds(Cases.parse("3"))
        for w, agent in np.ndindex(start.route.shape[:2]):
            way = np.concatenate([start.position[w, agent, None], start.route[w, agent], start.goal[w, agent, None]])
            legs = np.diff(way[np.isfinite(way[:, 0])], axis=0)
            assert np.hypot(*legs.T).max() <= 1.0 + 1e-9


def faces_around(points, obstacles):
    """What edges enclose all of these points."""
    faces = shapely.polygonize(shapely.get_parts(shapely.unary_union(walls(obstacles))))
    return [face for face in shapely.get_parts(faces) if face.contains(points).all()]


@pytest.mark.parametrize("name", WALLED)
def test_walls_enclose_everybody_far_behind_starts_and_goals(name):
    start = load_scenario(fixture(name)).worlds(Cases.parse("5"))
    for case in range(len(start)):
        points = shapely.points(np.concatenate([start.position[case], start.goal[case]]))
        around = faces_around(points, start.obstacles[case])
        assert len(around) == 1
        if name not in ("room", "doorway"):  # there is a lane, in which people push the vehicle back beyond their goals
            assert shapely.get_coordinates(points)[:, 1].min() - around[0].bounds[1] >= 2.0


@pytest.mark.parametrize(
    ("planner", "name", "cases"),
    [
        ("orca_margin", "street_8", "val:30"),
        ("orca_margin", "corner_5", "val:10"),
        ("orca_margin", "streets_16_blind", "val:1:2"),
        ("dwa", "street_8", "val:5:8"),
    ],
)
def test_a_vehicle_that_people_push_back_stays_in_its_world(planner, name, cases):
    trace = drive(planner, cases, name)
    for row, steps in enumerate(trace.steps):
        assert faces_around(shapely.points(trace.position[row, : steps + 1, 0]), trace.obstacles[row])
