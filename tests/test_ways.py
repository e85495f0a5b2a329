"""Shortest ways around obstacles, against lengths that are known."""

import itertools

import numpy as np
import pytest

from crowdbench.scenario.visibility_graph import CLEARANCE, LEAST_CLEARANCE, SIDES, find_routes
from crowdbench.utils.errors import InputError

RADIUS = 0.3
WALL = np.array([[[-5.0, 0.0], [1.0, 0.0]]])


def way(start, goal, obstacles, radius=RADIUS):
    """All points of a way, the start and the goal too."""
    route = find_routes(np.array([start], float), np.array([goal], float), np.array([radius]), obstacles)[0]
    return np.vstack([start, route[np.isfinite(route[:, 0])], goal])


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def rotated(points, angle):
    return points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def door(width, angle=0.0):
    """A wall with a door in its middle."""
    return rotated(np.array([[[-6.0, 0.0], [-width / 2, 0.0]], [[width / 2, 0.0], [6.0, 0.0]]]), angle)


def blocks():
    """Four blocks, a wall, and a polygon of padding."""
    square = np.array([[-0.6, -0.6], [0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]])
    polygons = np.full((6, 4, 2), np.nan)
    for i, middle in enumerate([(-1.5, 0.0), (1.5, 0.0), (0.0, 2.6), (0.0, -2.7)]):
        polygons[i] = square + middle
    polygons[4, :2] = [[-3.5, 2.5], [-3.5, -1.0]]
    return polygons


def test_a_way_around_the_end_of_a_wall_is_two_tangents_and_an_arc():
    points = way((0, -4), (0, 4), WALL)
    reach, distance = RADIUS + CLEARANCE, np.hypot(1, 4)
    behind = 2 * (np.arctan2(4, 1) + np.arccos(reach / distance))
    arc = reach * (2 * np.pi - behind)
    shortest = 2 * np.sqrt(distance**2 - reach**2) + arc
    assert shortest <= length(points) < shortest + 0.03 * reach
    assert len(points) < SIDES


def test_nobody_is_sent_around_what_is_not_in_the_way():
    assert len(way((2, -4), (2, 4), WALL)) == 2
    assert len(way((0, -4), (-6, -4), WALL)) == 2
    assert find_routes(np.zeros((2, 2)), np.ones((2, 2)), np.full(2, 0.3), np.empty((0, 0, 2))).shape == (2, 0, 2)


def test_a_way_keeps_its_clearance_from_every_corner():
    obstacles = blocks()
    corners = obstacles[np.isfinite(obstacles[..., 0])]
    for start, goal in (((-5, 0.2), (5, -0.3)), ((0, 5), (0.1, -5)), ((-5, 5), (5, -4))):
        points = way(start, goal, obstacles)
        steps = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(points)])
        gap = np.linalg.norm(steps[:, None] - corners, axis=2).min() - RADIUS
        assert gap > CLEARANCE - 1e-3
        assert len(points) > 2


def test_a_way_is_the_same_backwards_and_in_a_turned_world():
    start, goal = np.array([-5.0, 0.2]), np.array([5.0, -0.3])
    there = length(way(start, goal, blocks()))
    assert length(way(goal, start, blocks())) == pytest.approx(there, abs=1e-9)
    turned = length(way(rotated(start, 0.4), rotated(goal, 0.4), rotated(blocks(), 0.4)))
    assert turned == pytest.approx(there, abs=0.05)


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, 1.0])
@pytest.mark.parametrize("width", [0.65, 0.8, 1.5])
def test_a_way_leads_through_a_door_that_is_wide_enough(angle, width):
    start, goal = rotated(np.array([[2.0, -3.0], [-2.0, 3.0]]), angle)
    assert length(way(start, goal, door(width, angle))) < 7.3


def test_no_way_leads_through_a_door_that_is_too_narrow():
    narrow = 2 * (RADIUS + LEAST_CLEARANCE) - 0.001
    around = length(way((2, -3), (-2, 3), door(narrow)))
    assert around > 10
    box = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]], float)
    with pytest.raises(InputError, match=r"no way leads the vehicle from \(2, -3\) to its goal at \(0, 0\)"):
        way((2, -3), (0, 0), np.stack([box[:-1], box[1:]], axis=1))


def test_starts_and_goals_close_to_walls_can_be_left_and_reached():
    for gap in (0.0, 0.01, 0.1, 0.19):
        beside = RADIUS + gap
        points = way((0.5, -beside), (0.5, beside), WALL)
        assert 2.0 < length(points) < 2.7


def test_agents_of_all_sizes_have_their_own_ways_and_none_leads_over_the_start_of_another():
    start = np.array([[0.0, -4.0], [1.5, 0.0], [0.0, -4.0], [-3.0, -1.0]])
    goal = np.array([[0.0, 4.0], [1.5, 5.0], [0.0, 4.0], [-3.0, 1.0]])
    radius = np.array([0.3, 0.3, 0.6, 0.3])
    together = find_routes(start, goal, radius, WALL)
    for agent in range(4):
        alone = way(start[agent], goal[agent], WALL, radius[agent])[1:-1]
        assert np.array_equal(together[agent][np.isfinite(together[agent, :, 0])], alone)
    assert together[2, 0, 0] > together[0, 0, 0]
