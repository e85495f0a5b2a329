"""The metrics of Francis et al. (2023), HuNavSim and manners, on traces whose figures are computed by hand."""

import dataclasses

import numpy as np
import pytest
from helpers import Still, drive, trace

from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import METRICS

FAR = [50.0, 50.0]


def value(name, episode):
    return METRICS[name](episode)[0]


def walk(start, velocity, steps, dt=0.25):
    """Positions `[time, 2]`."""
    return np.array(start) + dt * np.arange(steps + 1)[:, None] * np.array(velocity, float)


def together(*ways):
    """Positions `[time, agent, 2]` of several ways."""
    return np.stack(ways, axis=1)


def headed(episode, *headings):
    """The episode with these headings in radians."""
    heading = episode.heading.copy()
    heading[0, : len(headings)] = headings
    return dataclasses.replace(episode, heading=heading)


@pytest.mark.parametrize(
    ("outcome", "person", "wall"),
    [(Outcome.COLLISION, True, False), (Outcome.WALL_COLLISION, False, True), (Outcome.TIMEOUT, False, False)],
)
def test_collisions_with_persons_and_with_walls_are_told_apart(outcome, person, wall):
    episode = trace(together(walk([0, 0], [1, 0], 2), walk(FAR, [0, 0], 2)), outcome)
    assert (value("person_collision_rate", episode), value("wall_collision_rate", episode)) == (person, wall)
    assert value("collision_rate", episode) == (person or wall)


def test_a_vehicle_fails_to_progress_once_in_every_five_seconds_without_half_a_metre():
    # 1.25 m in 5 steps; 11 s at 1 cm a step: twice 5 s, the second of which begins anew; then on.
    slow = np.concatenate([walk([0, 0], [1, 0], 5), walk([1.25, 0], [0.04, 0], 44)[1:]])
    slow = np.concatenate([slow, walk(slow[-1], [1, 0], 4)[1:]])
    episode = trace(together(slow, walk(FAR, [0, 0], len(slow) - 1)), goal=[[9.0, 0], FAR])
    assert value("failures_to_progress", episode) == 2.0
    straight = together(walk([0, 0], [0.5, 0], 50), walk(FAR, [0, 0], 50))
    assert value("failures_to_progress", trace(straight, goal=[[9.0, 0], FAR])) == 0.0
    # Away from the goal is no progress: after 5 and 10 s.
    assert value("failures_to_progress", trace(straight, goal=[[-9.0, 0], FAR])) == 2.0


def test_what_is_long_because_it_succeeds_is_also_told_over_successes():
    way = together(np.array([[0, 0], [0.25, 0], [0.25, 0.25], [0.25, 0.25]], float), walk(FAR, [0, 0], 3))
    for outcome, defined in ((Outcome.SUCCESS, True), (Outcome.COLLISION, False)):
        episode = headed(trace(way, outcome), 0, 0, np.pi / 2, np.pi / 2)
        assert value("cumulative_heading_change", episode) == pytest.approx(np.pi / 2)
        for name, expected in (("path_length", 0.5), ("heading_change", np.pi / 2), ("stopped_time", 0.25)):
            found = value(f"success_{name}", episode)
            assert found == pytest.approx(expected) if defined else np.isnan(found)


def test_headings_change_the_short_way_round():
    episode = trace(together(walk([0, 0], [1, 0], 3), walk(FAR, [0, 0], 3)))
    episode = headed(episode, *np.radians([170, -170, -180, 175]))
    assert value("cumulative_heading_change", episode) == pytest.approx(np.radians(20 + 10 + 5))


def test_personal_space_is_half_a_metre_and_clearing_distance_is_to_walls():
    way = together(walk([0, 0], [1, 0], 4), walk(FAR, [0, 0], 4))
    episode = trace(way, gap=[0.5, 0.49, 3.0, np.inf])
    assert value("personal_space_compliance", episode) == 0.75
    assert np.isnan(value("clearing_distance", episode))
    walls = episode.wall_gap.copy()
    walls[0, :4] = [1.0, 0.3, 0.4, 2.0]
    assert value("clearing_distance", dataclasses.replace(episode, wall_gap=walls)) == 0.3


def grouped(ways, *groups, **options):
    episode = trace(together(*ways), **options)
    return dataclasses.replace(episode, group=np.broadcast_to(np.array(groups), episode.person.shape))


def test_between_the_members_of_a_group_is_within_it():
    # The vehicle passes along x; two stand 1 m to its left and right at x = 1: within 0.3 m of their line at 0.75,
    # 1.0 and 1.25 m.
    vehicle, left, right = walk([0, 0], [1, 0], 8), walk([1, 1], [0, 0], 8), walk([1, -1], [0, 0], 8)
    assert value("group_intrusion", grouped((vehicle, left, right), 0, 0)) == 3 / 8
    assert value("group_intrusion", grouped((vehicle, left, walk([1, 0.4], [0, 0], 8)), 0, 0)) == 0.0
    assert np.isnan(value("group_intrusion", grouped((vehicle, left, right), -1, -1)))
    assert np.isnan(value("group_intrusion", trace(together(vehicle, left, right))))
    # Who is farther than 3.6 m apart is no group any more.
    apart = walk([1, 2], [0, 0], 8), walk([1, -1.61], [0, 0], 8)
    assert value("group_intrusion", grouped((vehicle, *apart), 0, 0)) == 0.0


def test_the_middle_of_a_group_is_within_it():
    # A triangle around the origin of 1.5 m, whose sides are 0.75 m away from the vehicle that stands in its middle.
    corners = [1.5 * np.array([np.cos(a), np.sin(a)]) for a in np.radians([90, 210, 330])]
    ways = [walk([0, 0], [0, 0], 4), *(walk(corner, [0, 0], 4) for corner in corners)]
    assert value("group_intrusion", grouped(ways, 0, 0, 0)) == 1.0
    assert value("group_intrusion", grouped(ways, 0, 0, -1)) == 0.0
    outside = [walk([2.0, 2.0], [0, 0], 4), *ways[1:]]
    assert value("group_intrusion", grouped(outside, 0, 0, 0)) == 0.0
    two = [*ways, walk([0.0, 0.5], [0, 0], 4), walk([0.0, -0.5], [0, 0], 4)]
    assert value("group_intrusion", grouped(two, -1, 7, -1, 7, 9)) == 0.0
    assert value("group_intrusion", grouped(two, -1, -1, -1, 9, 9)) == 1.0


def test_groups_are_in_traces_where_there_are_some():
    episode = drive("orca", "val:3", "groups_12", time_limit=6.0)
    assert episode.group is not None
    assert (episode.group >= 0).any()
    assert episode.group.shape == episode.person.shape
    assert drive("orca", "val:2").group is None


def moussaid(between, relative, strength=2.1, weight=2.0, gamma=0.35, n=2.0, prime=3.0):
    """The force on who is at the origin, written out (Moussaïd et al. 2009, equations 4 to 6)."""
    distance = np.hypot(*between)
    e = np.array(between) / distance
    d = weight * np.array(relative) + e
    t = d / np.hypot(*d)
    theta = np.arctan2(t[0] * e[1] - t[1] * e[0], t @ e)
    b = gamma * np.hypot(*d)
    decay = np.exp(-distance / b)
    left = np.array([-t[1], t[0]])
    along, aside = np.exp(-((prime * b * theta) ** 2)), np.sign(theta) * np.exp(-((n * b * theta) ** 2))
    return -strength * decay * (along * t + aside * left)


def test_social_work_is_the_forces_on_the_vehicle_and_by_it():
    # At the only state after the start: the vehicle at (0.25, 0) with (1, 0), others at (1.5, 0.2) with (-1, 0), and
    # at (0, -1) at rest.
    ways = walk([0, 0], [1, 0], 1), walk([1.75, 0.2], [-1, 0], 1), walk([0, -1], [0, 0], 1)
    forces = [moussaid([1.25, 0.2], [2, 0]), moussaid([-0.25, -1], [1, 0])]
    back = [moussaid([-1.25, -0.2], [-2, 0]), moussaid([0.25, 1], [-1, 0])]
    expected = np.hypot(*sum(forces)) + sum(np.hypot(*force) for force in back)
    episode = trace(together(*ways))
    assert value("social_work", episode) == pytest.approx(0.25 * expected)
    walls = np.where(np.isnan(episode.wall_gap), np.nan, 0.2)
    found = value("social_work", dataclasses.replace(episode, wall_gap=walls))
    assert found == pytest.approx(0.25 * (expected + 10 * np.exp(-1)))


def delayed(real, alone, goal, outcome=Outcome.SUCCESS):
    """Figures of one pedestrian's way, and of that without the vehicle."""
    vehicle = walk([-20, 0], [1, 0], len(real) - 1)
    episode = trace(together(vehicle, real), outcome, goal=[FAR, goal], undisturbed=np.array(alone)[:, None])
    return episode, value("imposed_delay", episode), value("imposed_detour", episode)


def test_who_waits_is_delayed_and_who_goes_around_walks_farther():
    alone = walk([0, 0], [1, 0], 12)
    waits = np.concatenate([alone[:3], [alone[2]] * 4, alone[3:9]])
    # A second of 3 s.
    assert delayed(waits, alone, [9.0, 0])[1:] == pytest.approx((1 / 3, 0.0))
    around = alone.copy()
    around[6, 1] = 0.4
    detour = 2 * np.hypot(0.25, 0.4) - 0.5
    assert delayed(around, alone, [9.0, 0])[1:] == pytest.approx((0.0, detour))
    # Without the vehicle he arrives after 1.75 s, 0.25 m before the goal, and with it a second later. What he does then
    # does not count: he is 1.05 m short of where he would be.
    late = np.concatenate([[alone[0]] * 4, alone[:9]])
    episode, delay, detour = delayed(late, alone, [2.0, 0])
    assert delay == pytest.approx((2.0 - 0.75 - 0.3) / 1.75)
    assert detour == pytest.approx(-0.05)  # he walked 0.05 m too far without the vehicle
    assert np.isnan(value("imposed_delay", dataclasses.replace(episode, undisturbed=None)))


def test_a_delay_is_what_all_pedestrians_lose_per_second():
    alone = walk([0, 0], [1, 0], 8)
    waits = np.concatenate([alone[:1], alone[:-1]])
    vehicle, goal = walk([-20, 0], [1, 0], 8), [FAR, [9.0, 0], [9.0, 5.0], [9.0, 9.0]]
    five, nine = np.array([0, 5.0]), np.array([0, 9.0])
    undisturbed = together(alone, alone + five, alone + nine)
    episode = trace(together(vehicle, waits, waits + five, alone + nine), goal=goal, undisturbed=undisturbed)
    assert value("imposed_delay", episode) == pytest.approx(2 * 0.25 / (3 * 2.0))
    # The third one gains as much as each of the others loses.
    fast = np.concatenate([alone[:1], alone[2:], alone[-1:] + np.array([0.25, 0])])
    episode = trace(together(vehicle, waits, waits + five, fast + nine), goal=goal, undisturbed=undisturbed)
    assert value("imposed_delay", episode) == pytest.approx(0.25 / 6.0)
    assert value("imposed_delay_positive", episode) == pytest.approx(0.5 / 6.0)


def test_only_ways_that_begin_alike_are_compared():
    # From the fifth state on, the pedestrian is on another way, which begins elsewhere without the vehicle.
    real = np.concatenate([walk([0, 0], [1, 0], 4), walk([5, 5], [-1, 0], 4)])
    alone = np.concatenate([walk([0, 0], [1, 0], 4), walk([7, 7], [-1, 0], 4)])
    episode, delay, _ = delayed(real, alone, [9.0, 0])
    goal = episode.goal.copy()
    goal[:, 5:, 1] = [-9.0, 5.0]
    assert value("imposed_delay", dataclasses.replace(episode, goal=goal)) == pytest.approx(0.0)
    assert delay != pytest.approx(0.0)
    person = episode.person.copy()
    person[:, 5:] = 8
    assert value("imposed_delay", dataclasses.replace(episode, person=person)) == pytest.approx(0.0)


def test_who_leaves_when_he_arrives_is_delayed_by_when_he_leaves():
    # As before, but he is gone in the state in which he would be within 0.3 m of his goal.
    alone, gone = walk([0, 0], [1, 0], 6), np.full((6, 2), np.nan)
    late = np.concatenate([[alone[0]] * 4, alone, gone[:2]])
    episode, delay, detour = delayed(late, np.concatenate([alone, gone]), [2.0, 0])
    # He was there without the vehicle for six steps, and is four steps behind then.
    assert (delay, detour) == pytest.approx((1.0 / 1.5, 0.0))
    present, person, goal = episode.present.copy(), episode.person.copy(), episode.goal.copy()
    present[:, 11:, 1], person[:, 11:], goal[:, 11:, 1] = False, -1, 0.0
    left = dataclasses.replace(episode, present=present, person=person, goal=goal)
    assert value("imposed_delay", left) == pytest.approx(1.0 / 1.5)


@pytest.mark.parametrize("arrival", ["walk_on", "leave", "respawn"])
def test_nobody_is_delayed_by_a_vehicle_that_is_far(arrival):
    episode = drive(
        Still(), "val:4", "circle_crossing_5", vehicle__visible=True, time_limit=15.0, pedestrians__arrival=arrival,
        layout__circle_radius=4.0, pedestrians__orca__neighbor_distance=0.1,
    )  # fmt: skip
    episode = dataclasses.replace(episode, outcome=np.full(len(episode), Outcome.SUCCESS))
    assert np.array_equal(METRICS["imposed_delay_positive"](episode), np.zeros(4))
    assert np.array_equal(METRICS["imposed_detour"](episode), np.zeros(4))


def frozen(pedestrian, steps=12, goal=(9.0, 0), **changes):
    way = together(walk([0, 0], [0, 0], steps), pedestrian)
    episode = trace(way, Outcome.TIMEOUT, goal=[goal, FAR])
    return value("frozen_time", dataclasses.replace(episode, **changes))


def test_frozen_is_who_stands_although_the_way_is_open():
    # Of 12 steps the first 5 have 2 s of known future.
    assert frozen(walk(FAR, [0, 0], 12)) == 5 * 0.25
    assert frozen(walk([1.5, 0], [0, 0], 12)) == 0.0
    # He walks ahead as fast as the vehicle would, 0.25 m before it: the way is open; 0.1 m before it, it is not.
    assert frozen(walk([0.85, 0], [1, 0], 12)) == 5 * 0.25
    assert frozen(walk([0.7, 0], [1, 0], 12)) < 5 * 0.25
    # Who stands 0.75 m aside leaves 0.15 m, at 0.85 m he leaves 0.25 m.
    assert frozen(walk([1.0, 0.75], [0, 0], 12)) == 0.0
    assert frozen(walk([1.0, 0.85], [0, 0], 12)) == 5 * 0.25
    # Beyond the goal, or after 2 s, nobody is in the way.
    assert frozen(walk([2.0, 0], [0, 0], 12), goal=(1.0, 0)) == 5 * 0.25
    assert frozen(walk([2.9, 0], [0, 0], 12)) == 5 * 0.25
    around = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    walls = np.stack([around, np.roll(around, 1, axis=0)], axis=1)[None]
    assert frozen(walk(FAR, [0, 0], 12), obstacles=walls) == 0.0
    moving = trace(together(walk([0, 0], [1, 0], 12), walk(FAR, [0, 0], 12)), goal=[[9.0, 0], FAR])
    assert value("frozen_time", moving) == 0.0


def test_only_the_steps_in_which_the_way_was_open_count():
    # The pedestrian crosses at x = 1 m, downwards from y = 3 m at 1 m/s. Seen from a vehicle that starts after t it
    # moves along a line at 45 degrees, which passes it at |2 s - t| / sqrt(2) metres: 0.8 m or more up to 0.86 s, that
    # is in four states. Of 16 steps the first 9 have 2 s of known future.
    assert frozen(walk([1.0, 3.0], [0, -1], 16), steps=16) == 4 * 0.25
