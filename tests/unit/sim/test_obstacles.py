import dataclasses

import numpy as np
import pytest
from helpers import trace, with_walkers, world

from crowdbench.core.geometry import local_goals, polygons
from crowdbench.core.reward import reward
from crowdbench.core.types import Outcome
from crowdbench.sim.episode import stopping_gap
from crowdbench.sim.obstacles import slide, touches_in_step, wall_gap_in_step
from crowdbench.sim.pedestrians import ORCA, social_force
from crowdbench.sim.routes import follow_routes, goals_in_trace, next_waypoints
from crowdbench.sim.simulator import step


def social_force_velocities(*inputs, **options):
    """The function of that name, with agents and parameters as arguments."""
    return with_walkers(social_force.social_force_velocities, social_force.PARAMETERS, *inputs, **options)


WALL = np.array([[[-1.0, 0.0], [1.0, 0.0], [np.nan, np.nan], [np.nan, np.nan]]])
BLOCK = np.array([[[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]]])
BOTH = np.concatenate([WALL, BLOCK])


def slow_gap(point, motion, radius, obstacles):
    """The gap by sampling motion and edges densely."""
    share = np.linspace(0.0, 1.0, 101)[:, None]
    centres = point + share * motion
    least = np.inf
    for corners in polygons(obstacles):
        for first, second in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge = first + share * (second - first)
            least = min(least, np.linalg.norm(centres[:, None] - edge[None], axis=-1).min())
        if len(corners) > 2 and ((corners.min(0) < centres) & (centres < corners.max(0))).all(axis=1).any():
            least = 0.0
    return least - radius


def test_the_gap_to_walls_is_that_of_dense_sampling():
    rng = np.random.default_rng(0)
    for _ in range(60):
        point, motion = rng.uniform([-2.0, -1.0], [4.0, 3.0]), rng.normal(0.0, 0.5, 2)
        got = wall_gap_in_step(*point, *motion, 0.3, BOTH)
        assert got == pytest.approx(slow_gap(point, motion, 0.3, BOTH), abs=0.02)


def test_a_disc_touches_where_its_gap_is_not_positive():
    rng = np.random.default_rng(1)
    found = []
    for _ in range(300):
        point, motion, radius = rng.uniform([-2.0, -1.0], [4.0, 3.0]), rng.normal(0.0, 1.0, 2), rng.choice([0.0, 0.3])
        found.append(touches_in_step(*point, *motion, radius, BOTH))
        assert found[-1] == (wall_gap_in_step(*point, *motion, radius, BOTH) <= 0.0)
    assert 50 < sum(found) < 250
    assert touches_in_step(2.0, 1.5, 0.0, 0.0, 0.0, BLOCK)  # inside


def test_without_obstacles_the_gap_is_infinite():
    assert wall_gap_in_step(0.0, 0.0, 1.0, 0.0, 0.3, np.empty((0, 0, 2))) == np.inf
    assert wall_gap_in_step(0.0, 0.0, 1.0, 0.0, 0.3, np.full((1, 2, 2), np.nan)) == np.inf


def test_a_disc_that_jumps_over_a_wall_in_one_step_hits_it():
    assert wall_gap_in_step(0.0, -5.0, 0.0, 10.0, 0.3, WALL) == -0.3


def test_a_disc_within_a_block_overlaps_it():
    assert wall_gap_in_step(2.0, 1.5, 0.0, 0.0, 0.1, BLOCK) == -0.1


def test_nobody_slides_into_a_wall_or_farther_than_the_step():
    rng = np.random.default_rng(1)
    met = 0
    for _ in range(500):
        point, motion = rng.uniform([-2.0, -1.0], [4.0, 3.0]), rng.normal(0.0, 0.7, 2)
        if wall_gap_in_step(*point, 0.0, 0.0, 0.3, BOTH) < 0.0:
            continue
        touched, x, y = slide(*point, *motion, 0.3, BOTH)
        assert wall_gap_in_step(x, y, 0.0, 0.0, 0.3, BOTH) >= -1e-9
        assert np.hypot(x - point[0], y - point[1]) <= np.hypot(*motion) + 1e-9
        assert touched == (wall_gap_in_step(*point, *motion, 0.3, BOTH) < 1e-9)
        if not touched:
            assert (x, y) == (point[0] + motion[0], point[1] + motion[1])
        met += touched
    assert met > 50


def test_who_walks_slantwise_into_a_wall_goes_on_along_it():
    assert slide(-0.5, -0.4, 0.4, 0.4, 0.3, WALL) == (True, pytest.approx(-0.1), pytest.approx(-0.3))


def test_who_overlaps_a_wall_can_leave_it_and_not_go_deeper():
    assert slide(0.0, -0.1, 0.0, 0.2, 0.3, WALL) == (True, 0.0, -0.1)
    assert slide(0.0, -0.1, 0.1, -0.2, 0.3, WALL) == (False, 0.1, pytest.approx(-0.3))


def walled(obstacles, **changes):
    """A vehicle at the origin that goes to (4, 0), and a pedestrian at (0, 2) that goes to (4, 2), among obstacles."""
    made = world([[0.0, 0.0], [0.0, 2.0]], goal=[[4.0, 0.0], [4.0, 2.0]])
    return made.replace(obstacles=np.array([obstacles], float), **changes)


def test_a_vehicle_that_hits_a_wall_ends_in_a_wall_collision_and_its_price():
    before = walled([[[0.5, -1.0], [0.5, 1.0]]])
    after, check = step(before, np.array([[1.0, 0.0]]), np.zeros((1, 1, 2)))
    assert check.outcome == [Outcome.WALL_COLLISION]
    assert check.wall_gap == pytest.approx([-0.05])
    assert reward(check.outcome, check.gap, 0.25) == [-0.25]
    assert after.position[0, 0].tolist() == [0.25, 0.0]


def test_a_pedestrian_that_is_pushed_into_a_wall_stops_at_it():
    before = walled([[[0.5, 1.0], [0.5, 3.0]]])
    after, check = step(before, np.zeros((1, 2)), np.array([[[0.9, 0.2]]]))
    assert after.position[0, 1] == pytest.approx([0.2, 2.05])
    assert after.velocity[0, 1] == pytest.approx([0.8, 0.2])
    assert check.outcome == [Outcome.RUNNING]


def test_the_next_waypoint_is_the_last_one_in_sight():
    obstacles = np.array([[[[2.0, -1.0], [2.0, 9.0]]]])
    goal, route = np.array([[[4.0, 2.0]]]), np.array([[[[1.5, -1.5], [2.5, -1.5]]]])
    for position, last, expected in [
        ([0.0, 2.0], 0, 0),
        ([1.5, -1.5], 0, 1),
        ([2.5, -1.5], 1, 2),
        ([3.0, 2.0], 2, 2),
        # Pushed back behind the wall, it heads for the waypoints before it again.
        ([0.0, 2.0], 2, 0),
    ]:
        found, _ = next_waypoints(np.array([[position]]), goal, route, np.array([[last]]), np.array([[0.3]]), obstacles)
        assert found == expected


def test_without_obstacles_a_waypoint_is_done_within_a_metre_of_it():
    goal, route = np.array([[[4.0, 0.0]]]), np.array([[[[2.0, 0.0], [np.nan, np.nan]]]])
    nothing = np.empty((1, 0, 0, 2))
    for x, expected in [(0.9, 0), (1.1, 1)]:
        found, _ = next_waypoints(np.array([[[x, 0.0]]]), goal, route, np.array([[0]]), np.array([[0.3]]), nothing)
        assert found == expected


def test_a_local_goal_is_as_far_away_as_the_goal_is_along_the_route():
    route = np.array([[[1.0, 0.0], [1.0, 1.0], [np.nan, np.nan]]])
    goal = np.array([[3.0, 1.0]])
    assert local_goals(np.zeros((1, 2)), goal, route, np.array([0])) == pytest.approx(np.array([[4.0, 0.0]]))
    assert local_goals(np.array([[1.0, 0.0]]), goal, route, np.array([0])) == pytest.approx(np.array([[1.0, 3.0]]))
    assert local_goals(np.array([[1.0, 0.5]]), goal, route, np.array([1])) == pytest.approx(np.array([[1.0, 3.0]]))
    assert np.array_equal(local_goals(np.array([[1.3, 0.7]]), goal, route, np.array([2])), goal)
    assert local_goals(np.zeros((1, 2)), goal, np.empty((1, 0, 2)), np.array([0])) is goal


def test_nobody_slows_down_at_a_waypoint_in_between():
    before = walled([[[9.0, 9.0], [9.5, 9.0]]], route=np.array([[[[0.1, 0.0]], [[0.1, 2.0]]]], float))
    asked = ORCA().velocities(before, before.parameters["orca"])
    assert np.hypot(*asked[0, 0]) == pytest.approx(1.0)


def test_a_pedestrian_behind_a_wall_is_avoided_as_in_rvo2_unless_asked_otherwise():
    wall = [[[0.6, -3.0], [0.6, 3.0]]]
    before = world([[9.0, 9.0], [0.0, 0.0], [1.2, 0.8]], goal=[[9.0, 9.0], [0.0, 4.0], [-4.0, 0.5]])
    before = before.replace(obstacles=np.array([wall]), velocity=np.array([[[0, 0], [0, 0.5], [-1.0, 0.1]]], float))
    parameters = {name: value.copy() for name, value in before.parameters["orca"].items()}
    through = ORCA().velocities(before, parameters)[0, 0]
    parameters["line_of_sight"][:] = 1.0
    hidden = ORCA().velocities(before, parameters)[0, 0]
    alone = before.replace(present=np.array([[True, True, False]]))
    assert np.array_equal(hidden, ORCA().velocities(alone, parameters)[0, 0])
    assert not np.allclose(through, hidden)


def test_a_border_repels_as_in_the_formula_of_helbing_and_molnar():
    dt, tau, strength, reach, distance = 0.01, 0.5, 10.0, 0.2, 0.7
    zero = np.zeros((1, 1, 2))
    arguments = (zero, zero, zero, np.full((1, 1), 0.3), np.full((1, 1), 100.0), zero)
    wall = np.array([[[[distance, -50.0], [distance, 50.0]]]])
    got = social_force_velocities(*arguments, time_step=dt, fluctuation=0.0, obstacles=wall)
    pushed = -strength / reach * np.exp(-distance / reach) * tau * (1.0 - np.exp(-dt / tau))
    assert got[0, 0] == pytest.approx([pushed, 0.0], abs=1e-12)


def test_braking_takes_the_way_of_the_square_of_the_speed_over_twice_the_deceleration():
    disc = np.zeros(1)
    gap = stopping_gap(disc, 2.0, 0.0, -1.0, 0.0, 1.0, np.pi / 2, 0.3, WALL)
    assert gap == pytest.approx(1.0 - 0.25 - 0.3)
    assert stopping_gap(disc, 0.5, 0.0, -1.0, 0.0, 1.0, np.pi / 2, 0.3, WALL) == pytest.approx(-0.3)
    assert stopping_gap(np.array([0.0, 0.5]), 2.0, 0.0, -1.0, 0.0, 1.0, np.pi / 2, 0.3, WALL) == pytest.approx(-0.05)
    assert stopping_gap(disc, np.inf, 0.0, -1.0, 0.0, 1.0, np.pi / 2, 0.3, WALL) == np.inf


def test_who_touches_a_wall_looks_along_the_line_of_its_centre():
    obstacles = np.array([[[[-5.0, 0.0], [-0.75, 0.0]], [[0.75, 0.0], [5.0, 0.0]]]])
    goal, route = np.array([[[0.0, 4.0]]]), np.array([[[[0.0, -1.0], [0.0, 0.5], [0.0, 2.0]]]])
    beside = np.array([[[-3.0, -0.3]]])
    found, _ = next_waypoints(beside, goal, route, np.array([[3]]), np.array([[0.3]]), obstacles)
    assert found == 0
    ahead = local_goals(beside, goal, route, found)
    assert ahead[0, 0, 0] > 0.0 > ahead[0, 0, 1]


BEHIND = np.array([[[[-20.0, 1.0], [6.0, 1.0]]]])
"""A wall; the route leads along its lower side, and from its upper side nothing of it is in sight."""
START, GOAL, ROUTE = np.array([[[0.0, 2.0]]]), np.array([[[4.0, 0.0]]]), np.array([[[[-1.0, 0.0], [1.0, 0.0]]]])
SIZES = np.array([[0.3]]), BEHIND, np.array([[True]])


def way_from(position, route):
    """The positions of a disc that follows its route for 20 s at 1 m/s, and its local goals."""
    waypoint, positions, goals = np.array([[0]]), [], []
    for _ in range(80):
        positions.append(position[0])
        goals.append(local_goals(position, GOAL, route, waypoint)[0])
        offset = goals[-1] - position if len(goals) > 1 else np.zeros((1, 1, 2))
        position = position + 0.25 * offset / max(np.linalg.norm(offset), 0.25)
        route, waypoint = follow_routes(position, GOAL, route, waypoint, *SIZES)
    return np.array(positions), np.array(goals)


def test_who_is_pushed_behind_a_wall_plans_the_route_anew():
    positions, goals = way_from(START, ROUTE)
    assert np.linalg.norm(positions[-1] - GOAL[0]) < 0.1
    assert min(wall_gap_in_step(*point[0], 0.0, 0.0, 0.3, BEHIND[0]) for point in positions) > 0.0
    assert np.isnan(ROUTE).sum() == 0  # the old route is as it was
    # The trace holds the route at the start alone.
    made = dataclasses.replace(trace(positions, goal=GOAL[0]), route=ROUTE[0], obstacles=BEHIND)
    np.testing.assert_array_equal(goals_in_trace(made)[0, : len(goals)], goals[:, 0])


def test_a_route_is_planned_anew_in_a_batch_as_alone():
    three = [np.concatenate([array, array + 0.0, array]) for array in (START, GOAL, ROUTE)]
    three[0][1] = [[0.0, 0.0]]  # sees its route
    three[2][1] += [[[0.5, 0.0]]]
    arguments = [np.zeros((3, 1), int), np.full((3, 1), 0.3), np.repeat(BEHIND, 3, axis=0), np.ones((3, 1), bool)]
    route, waypoint = follow_routes(*three, *arguments)
    for w in range(3):
        alone, at = follow_routes(*(array[w : w + 1] for array in (*three, *arguments)))
        np.testing.assert_array_equal(route[w, :, : alone.shape[2]], alone[0])
        assert np.isnan(route[w, :, alone.shape[2] :]).all()
        assert at == waypoint[w]
    assert route.shape[2] > 2
    assert waypoint[:, 0].tolist() == [0, 2, 0]


def test_who_finds_no_way_or_is_not_there_keeps_the_route():
    closed = np.concatenate([BEHIND, [[[[-20.0, 1.0], [-20.0, 9.0]], [[-20.0, 9.0], [6.0, 9.0]]]]], axis=1)
    closed = np.concatenate([closed, [[[[6.0, 1.0], [6.0, 9.0]]]]], axis=1)
    for obstacles, there in ((closed, True), (BEHIND, False)):
        sizes = SIZES[0], obstacles, np.array([[there]])
        route, waypoint = follow_routes(START, GOAL, ROUTE, np.array([[1]]), *sizes)
        np.testing.assert_array_equal(route, ROUTE)
        assert waypoint == 1
