import dataclasses

import numpy as np
import pytest
from helpers import drive, trace

from crowdbench.core.types import Outcome
from crowdbench.metrics import registry as metrics
from crowdbench.metrics.registry import METRICS

STRAIGHT = [[[0.25 * t, 0], [1, 3 - 0.25 * t]] for t in range(5)]
"""The vehicle walks 1 m along x at 1 m/s; a pedestrian comes down at x = 1."""


def value(name, episode):
    return METRICS[name](episode)[0]


@pytest.mark.parametrize("outcome", [Outcome.SUCCESS, Outcome.COLLISION, Outcome.TIMEOUT])
def test_rates_tell_the_outcome(outcome):
    episode = trace(STRAIGHT, outcome)
    assert [value(name, episode) for name in ("success_rate", "collision_rate", "timeout_rate")] == [
        outcome == other for other in (Outcome.SUCCESS, Outcome.COLLISION, Outcome.TIMEOUT)
    ]


def test_success_is_weighted_by_the_time_of_the_straight_way():
    # 1 m at 1 m/s, of which the last 0.3 m lie within the goal: three steps at least, and four were driven.
    assert value("sct", trace(STRAIGHT, goal=[[1.0, 0], [9, 9]])) == 0.75
    assert value("sct", trace(STRAIGHT, goal=[[1.3, 0], [9, 9]])) == 1.0
    assert value("sct", trace(STRAIGHT, goal=[[0.0, 0], [9, 9]])) == 0.25
    assert value("sct", trace(STRAIGHT, Outcome.TIMEOUT, goal=[[1.3, 0], [9, 9]])) == 0.0


def test_times_of_success_and_failure():
    assert value("navigation_time", trace(STRAIGHT)) == 1.0
    assert value("navigation_time_or_limit", trace(STRAIGHT)) == 1.0
    failure = trace(STRAIGHT, Outcome.COLLISION)
    assert np.isnan(value("navigation_time", failure))
    assert value("navigation_time_or_limit", failure) == 25.0


def test_path_length_and_spl_of_a_detour():
    corner = [[[0, 0], [9, 9]], [[0, 0.3], [9, 9]], [[0.4, 0.3], [9, 9]]]
    episode = trace(corner, goal=[[0.6, 0.3 + 0.1], [9, 9]])
    assert value("path_length", episode) == pytest.approx(0.7)
    assert value("spl", episode) == pytest.approx((np.hypot(0.6, 0.4) - 0.3) / 0.7)
    assert value("spl", trace(corner, Outcome.COLLISION, goal=[[0.6, 0.4], [9, 9]])) == 0.0
    assert value("spl", trace(STRAIGHT, goal=[[1.3, 0], [0, 0]])) == 1.0


def test_who_starts_at_the_goal_wastes_nothing():
    for path, goal in ((STRAIGHT[:2], [[0.1, 0], [0, 0]]), ([STRAIGHT[0]] * 2, [[0.3, 0], [0, 0]])):
        assert value("spl", trace(path, goal=goal)) == 1.0


def test_intrusions_are_into_the_way_that_a_pedestrian_goes():
    # The vehicle stands; the pedestrian comes from 2 m by 0.25 m a step.
    comes = trace([[[0, 0], [2 - 0.25 * t, 0]] for t in range(7)])
    # Within five steps it is nearer than 0.6 m from the second state on, at last at 0.5 m.
    assert value("intrusion_time_ratio", comes) == pytest.approx(5 / 6)
    assert value("social_distance", comes) == pytest.approx(0.5)
    goes = trace([[[0, 0], [0.5 + 0.25 * t, 0]] for t in range(7)])
    assert value("intrusion_time_ratio", goes) == 0.0
    assert np.isnan(value("social_distance", goes))
    hidden = dataclasses.replace(comes, seen=np.zeros_like(comes.seen))
    assert value("intrusion_time_ratio", hidden) == 0.0
    other = dataclasses.replace(comes, person=np.arange(comes.person.shape[1])[None, :, None])
    assert value("intrusion_time_ratio", other) == 0.0


def test_changes_of_velocity_count_the_start_from_rest():
    # Velocities: rest, (1, 0), (0, 1), (0, 1).
    x = np.cumsum([[0, 0], [0.25, 0], [0, 0.25], [0, 0.25]], axis=0)
    episode = trace(np.stack([x, x + 5], axis=1))
    changes = [1, np.sqrt(2), 0]
    assert value("max_velocity_change", episode) == pytest.approx(np.sqrt(2))
    assert value("max_acceleration", episode) == pytest.approx(np.sqrt(2) / 0.25)
    assert value("mean_acceleration", episode) == pytest.approx(np.mean(changes) / 0.25)
    assert value("max_turn", episode) == pytest.approx(np.pi / 2)
    accelerations = np.array([[1, 0], [-1, 1], [0, 0]]) / 0.25
    assert value("jerk", episode) == pytest.approx(np.linalg.norm(np.diff(accelerations, axis=0), axis=1).mean() / 0.25)


def test_turns_cross_the_branch_cut_the_short_way():
    heading = np.radians([170, -170])
    x = np.cumsum(0.25 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    x = np.concatenate([[[0, 0]], x])
    assert value("max_turn", trace(np.stack([x, x + 5], axis=1))) == pytest.approx(np.radians(20))


def test_gaps_zones_and_discomfort():
    # The last step ends the episode: it is not in CrowdNav's count.
    episode = trace(STRAIGHT, Outcome.COLLISION, gap=[1.0, 0.3, 0.19, -0.05])
    assert value("discomfort_frequency", episode) == 0.25
    assert np.isnan(value("minimum_gap", episode))
    episode = dataclasses.replace(episode, outcome=np.array([Outcome.SUCCESS]))
    assert value("minimum_gap", episode) == -0.05
    assert value("discomfort", episode) == 0.5
    assert [value(name, episode) for name in ("intimate_zone", "personal_zone", "social_zone")] == [0.75, 1.0, 1.0]
    assert np.isnan(value("minimum_gap", trace(STRAIGHT, gap=[np.inf] * 4)))


def test_time_to_collision_of_a_head_on_meeting():
    # They approach at 2 m/s from 4 m; discs of 0.3 m touch after (4 - 0.6) / 2 s, less each step of 0.25 s.
    walk = [[[0.25 * t, 0], [4 - 0.25 * t, 0]] for t in range(4)]
    assert value("time_to_collision", trace(walk)) == pytest.approx(3.4 / 2 - 2 * 0.25)
    apart = [[[-0.25 * t, 0], [4 + 0.25 * t, 0]] for t in range(4)]
    assert np.isnan(value("time_to_collision", trace(apart)))
    past = [[[0.25 * t, 0], [4 - 0.25 * t, 0.61]] for t in range(4)]
    assert np.isnan(value("time_to_collision", trace(past)))


def test_stopped_time_counts_steps_slower_than_a_crawl():
    x = np.cumsum([[0, 0], [0.25, 0], [0.001, 0], [0, 0]], axis=0)
    assert value("stopped_time", trace(np.stack([x, x + 5], axis=1))) == 0.5


def test_discounted_return_pays_the_outcome_at_its_step():
    gamma = 0.9**0.25
    expected = gamma * (0.1 - 0.2) * 0.5 * 0.25 + gamma**3
    assert value("discounted_return", trace(STRAIGHT, gap=[1, 0.1, 1, 0.1])) == pytest.approx(expected)
    assert value("discounted_return", trace(STRAIGHT, Outcome.COLLISION)) == pytest.approx(-0.25 * gamma**3)


def test_deflection_is_the_mean_distance_from_the_undisturbed_walk():
    path = np.array(STRAIGHT, float)
    assert np.isnan(value("deflection", trace(path)))
    moved = path[:, 1:] + np.arange(5)[:, None, None] * [0.3, 0.4]
    assert value("deflection", trace(path, undisturbed=moved)) == pytest.approx(0.5 * np.mean([1, 2, 3, 4]))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["circle_crossing_5", "circle_crossing_5_visible"])
def test_a_metric_does_not_depend_on_the_batch(scenario):
    together = drive("orca", "12", scenario)
    alone = [drive("orca", f"{case}:{case + 1}", scenario) for case in range(12)]
    for name, metric in METRICS.items():
        values = metric(together)
        assert values.shape == (12,)
        singly = np.concatenate([metric(one) for one in alone])
        assert np.array_equal(values, singly, equal_nan=values.dtype != bool), name


@pytest.mark.parametrize("scenario", ["circle_crossing_5", "circle_crossing_5_visible"])
def test_an_empty_crowd_leaves_no_metric_infinite(scenario):
    episode = drive("orca", "2", scenario, pedestrians__number=0)
    assert (episode.outcome == Outcome.SUCCESS).all()
    for name, metric in METRICS.items():
        assert not np.isinf(metric(episode)).any(), name
    assert metrics.social_zone(episode).tolist() == [0.0, 0.0]


def test_an_episode_of_one_step_has_its_metrics():
    episode = trace(STRAIGHT[:2])
    values = {name: metric(episode)[0] for name, metric in METRICS.items()}
    assert values["navigation_time"] == 0.25
    assert values["max_turn"] == 0.0
    assert np.isnan(values["jerk"])
    assert values["discomfort_frequency"] == 0.0


def test_a_long_vehicle_collides_with_its_foremost_disc():
    # Discs at 0 and 1 m ahead of its position: the front is 1 m nearer to who comes from ahead.
    walk = [[[0.25 * t, 0], [4 - 0.25 * t, 0]] for t in range(4)]
    episode = trace(walk)
    long = dataclasses.replace(episode, rules=dataclasses.replace(episode.rules, body=(0.0, 1.0)))
    assert value("time_to_collision", long) == pytest.approx(2.4 / 2 - 2 * 0.25)


def passing(*gaps):
    """Positions of a vehicle that stands, and of a pedestrian at these gaps in turn."""
    return np.array([[[0, 0], [0, gap + 0.6]] for gap in gaps])


def test_an_encounter_is_a_near_miss_once():
    # Three near steps are one near miss. The second encounter has none: its steps are slow and far.
    episode = trace(passing(0.1, 0.1, 0.19, 3.0, 4.0, 4.0, 3.5, 3.4, 3.3))
    assert value("near_misses", episode) == pytest.approx(1 / 2)
    assert value("near_misses_per_hour", episode) == pytest.approx(3600 / (8 * 0.25))
    # Somebody else in the same place begins an encounter of its own.
    person = episode.person.copy()
    person[:, 2:] = 7
    assert value("near_misses", dataclasses.replace(episode, person=person)) == pytest.approx(2 / 3)
    assert np.isnan(value("near_misses", trace(passing(9.0, 9.0))))
    # From 2 m at 4 m/s: a touch within 0.5 s; at 1 m/s it is 2 s away.
    assert value("near_misses", trace(passing(2.0, 1.0))) == 1.0
    assert value("near_misses", trace(passing(2.0, 1.75))) == 0.0


def test_turns_along_the_route_are_not_irregular():
    corner = np.array([[[0, 0], [9, 9]], [[1, 0], [9, 9]], [[1, 1], [9, 9]]], float)
    episode = trace(corner, goal=[[1, 1], [9, 9]])
    heading = episode.heading.copy()
    heading[0, :3] = [0, 0, np.pi / 2]
    straight = dataclasses.replace(episode, heading=heading)
    # Straight to the goal, by a turn of 45 degrees; along a route with a corner, by one of 90.
    assert value("path_irregularity", straight) == pytest.approx(np.pi / 4 / 2)
    route = np.array([[[1.0, 0.0], [np.nan, np.nan]]])
    assert value("path_irregularity", dataclasses.replace(straight, route=route)) == pytest.approx(0.0)
    heading = heading.copy()
    heading[0, 1] = -0.1
    swerves = dataclasses.replace(straight, route=route, heading=heading)
    assert value("path_irregularity", swerves) == pytest.approx(0.2 / 2)


def test_the_time_between_two_on_the_same_place_is_that_of_the_nearest_pass_of_their_paths():
    # Along x and down x = 1 at 1 m/s, the pedestrian 2 s behind: discs of 0.3 m come to the same place
    # 2 s - 2 sqrt(2) 0.3 s apart. The first to leave may be either.
    paths = np.array([[[0.1 * t, 0], [1, 3 - 0.1 * t]] for t in range(41)])
    for positions in (paths, paths[:, ::-1]):
        episode = trace(positions, dt=0.1)
        assert value("post_encroachment_time", episode) == pytest.approx(2 - 0.6 * np.sqrt(2))
        assert value("paths_apart", episode) == 0.0
    parallel = trace(paths * [1, 0] + [[0, 0], [0, 0.7]], dt=0.1)
    assert np.isnan(value("post_encroachment_time", parallel))
    assert value("paths_apart", parallel) == 1.0
    for name in ("post_encroachment_time", "paths_apart"):
        assert np.isnan(value(name, trace(paths, Outcome.TIMEOUT, dt=0.1)))


def test_somebody_else_in_the_place_of_a_pedestrian_has_walked_no_way_between():
    paths = np.array([[[0.25 * t, 0], [1, 3 - 0.25 * t]] for t in range(8)])
    paths[:, 1, 1] = [3, 3, 3, 3, -3, -3, -3, -3]
    episode = trace(paths)
    jump = np.broadcast_to((np.arange(episode.person.shape[1]) > 3)[None, :, None], episode.person.shape)
    assert value("paths_apart", episode) == 0.0
    assert value("paths_apart", dataclasses.replace(episode, person=jump.astype(np.int64))) == 1.0


def test_only_steps_near_pedestrians_count_in_the_speed_near_them():
    episode = trace([[[x, 0], [9, 9]] for x in (0, 0.25, 0.35, 0.4)], gap=[1.3, 1.1, 0.5])
    assert value("speed_near_pedestrians", episode) == pytest.approx((0.4 + 0.2) / 2)
    assert np.isnan(value("speed_near_pedestrians", trace(STRAIGHT, gap=[1.3] * 4)))
