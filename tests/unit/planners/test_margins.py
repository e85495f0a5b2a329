"""Margins of reactive planners: none from walls, or one that follows the width, so that no door is closed by it."""

import numpy as np
import pytest
from helpers import drive, world

from agents.planners.social_force import SocialForcePlanner, wall_traits
from crowdbench.core.types import Outcome
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.sim.sensor import observe


@pytest.mark.parametrize("planner", ["orca_margin", "social_force"])
@pytest.mark.parametrize(("scenario", "width"), [("door_10", 1.0), ("door_10", 0.7), ("door_narrow", 0.9)])
def test_a_door_that_is_wide_enough_is_passed_where_nobody_else_is(planner, scenario, width):
    alone = {"pedestrians__number": 0, "layout__door_width": width}
    assert (drive(planner, "val:3", scenario, **alone).outcome == Outcome.SUCCESS).all()


@pytest.mark.parametrize("make", [ORCAPlanner, SocialForcePlanner])
def test_walls_far_away_leave_the_margin_to_people_as_it_is(make):
    """An open world, and the same one with a wall that nobody can reach."""
    open_world = world([[0.0, 0.0], [2.0, 0.3]], [[1.0, 0.0], [-1.0, 0.0]], goal=[[9.0, 0.0], [-9.0, 0.0]])
    walled = open_world.replace(obstacles=np.array([[[[-90.0, 80.0], [90.0, 80.0]]]]))
    for margin in (0.0, 0.2, 0.5):
        planner = make(safety_space=margin)
        np.testing.assert_allclose(planner.plan(observe(walled)), planner.plan(observe(open_world)), atol=1e-9)
    near, far = (make(safety_space=margin).plan(observe(walled)) for margin in (0.0, 0.5))
    assert np.abs(near - far).max() > 0.05


def box(x, y, half=0.5):
    return [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]]


@pytest.mark.parametrize(
    ("obstacles", "width"),
    [
        ([], None),
        ([[[-9.0, 0.5], [9.0, 0.5]]], None),  # a single wall
        ([[[-9.0, 0.3], [9.0, 0.3]], [[-9.0, -0.5], [9.0, -0.5]]], 0.8),
        ([[[0.6, 0.45], [0.6, 9.0]], [[0.6, -0.45], [0.6, -9.0]]], 0.9),  # a door ahead
        ([[[0.3, 0.3], [0.3, 9.0]], [[0.3, 0.3], [9.0, 0.3]]], None),  # an outer corner
        ([box(0.0, 1.0), box(0.0, -1.1)], 1.1),
        ([box(1.0, 1.0), box(1.0, 2.1)], None),  # both ahead
        ([[[-9.0, 2.0], [9.0, 2.0]], [[-9.0, -2.0], [9.0, -2.0]]], None),  # wide
    ],
)
def test_the_force_of_walls_follows_the_free_width(obstacles, width):
    rows = [np.concatenate([each, np.full((5 - len(each), 2), np.nan)]) for each in obstacles]
    walls = np.array(rows).reshape(1, -1, 5, 2)
    padded = np.concatenate([walls, np.full((1, 2, 5, 2), np.nan)], axis=1)
    for polygons in (walls, padded):
        seen = observe(world([[0.0, 0.0], [5.0, 5.0]]).replace(obstacles=polygons))
        share = wall_traits(seen)["wall_range"][0, 0] / 0.2
        assert share == pytest.approx(1.0 if width is None else width / 1.28)
