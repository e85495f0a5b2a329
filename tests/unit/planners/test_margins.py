"""Margins of reactive planners: kept from people, and none from walls, so that a door they fit through is open."""

import numpy as np
import pytest
from helpers import drive, world

from crowdbench.core.types import Outcome
from crowdbench.planners.reactive import ORCAPlanner, SocialForcePlanner
from crowdbench.sim.sensor import observe


@pytest.mark.parametrize("planner", ["orca_margin", "social_force"])
@pytest.mark.parametrize(("scenario", "width"), [("doorway_8", 1.0), ("doorway_8", 0.7), ("door_narrow", 0.9)])
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
