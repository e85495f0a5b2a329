"""Groups, people who stop and go, who give way to nobody, who stand."""

import math

import numpy as np
import pytest
from helpers import Still, drive, failed_checks, fixture, same, to_walkers

from crowdbench.catalog import PEDESTRIANS, load_scenario
from crowdbench.check.checks import Subject
from crowdbench.check.drives import POLICY
from crowdbench.core import rng
from crowdbench.core.geometry import norm
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.groups import draw_groups, group_reach, member_offsets
from crowdbench.sim.pedestrians import ORCA, SocialForce
from crowdbench.sim.pedestrians.group_force import ATTRACTION, GAZE, REPULSION, group_force
from crowdbench.sim.pedestrians.social_force import social_force_velocities
from crowdbench.utils.errors import InputError

GROUPS = {"1": 0.2, "2": 0.4, "3": 0.4}


def crowd(cases=30, **overrides):
    changes = {"layout.circle_radius": 7.0, "pedestrians.groups": GROUPS}
    changes |= {key.replace("__", "."): value for key, value in overrides.items()}
    return load_scenario("circle_crossing_10", changes).worlds(Cases("val", 0, cases))


def groups_of(world):
    """Row and agents of each group of several."""
    for row, group in enumerate(world.group):
        for number in np.unique(group[group >= 0]):
            yield row, np.flatnonzero(group == number) + 1


def test_groups_have_the_sizes_that_are_asked_for():
    streams = [rng.generator(np.uint64(case), "groups") for case in range(3000)]
    sizes = [
        size
        for stream in streams
        for size in np.unique(draw_groups(stream, {1: 2.0, 3: 2.0}, 8), return_counts=True)[1][:2].tolist()
    ]
    assert set(sizes) == {1, 3}
    assert np.mean(np.array(sizes) == 3) == pytest.approx(0.5, abs=0.03)
    assert draw_groups(streams[0], {3: 1.0}, 8).tolist() == [0, 0, 0, 3, 3, 3, 6, 6]


def test_members_start_side_by_side_and_walk_to_goals_side_by_side_at_one_speed():
    world = crowd(pedestrians__preferred_speed={"mean": 1.0, "std": 0.2, "low": 0.6, "high": 1.4})
    found = list(groups_of(world))
    assert {len(agents) for _, agents in found} == {2, 3}
    for row, agents in found:
        start, goal = world.position[row, agents], world.goal[row, agents]
        assert norm(np.diff(start, axis=0)) == pytest.approx(0.8)
        assert goal - start == pytest.approx(np.tile(goal[0] - start[0], (len(agents), 1)))
        assert abs((start[1] - start[0]) @ (goal[0] - start[0])) < 1e-9
        assert len(np.unique(world.preferred_speed[row, agents])) == 1
    gap = norm(world.position[:, :, None] - world.position[:, None]) + 10.0 * np.eye(11)
    assert gap.min() >= 0.8 - 1e-9


def test_nobody_in_a_crowd_without_groups_is_placed_otherwise():
    plain = load_scenario("circle_crossing_10", {"layout.circle_radius": 7.0}).worlds(Cases("val", 0, 5))
    alone = crowd(5, pedestrians__groups={"1": 1.0})
    assert (alone.group == -1).all()
    assert np.allclose(alone.position, plain.position, rtol=0.0, atol=1e-12)


def test_groups_walk_among_walls():
    place = load_scenario(fixture("traffic"), {"pedestrians.groups": {"2": 1.0}, "layout.width": 8.0})
    world = place.worlds(Cases("val", 0, 5))
    assert (world.group >= 0).any()
    assert np.isfinite(world.route[:, 1:, 0]).any()


def test_who_stands_is_on_the_way_in_a_circle_and_stays():
    trace = drive(
        Still(), "10", "circle_crossing_10", pedestrians__policy={"orca": 0.5, "standing": 0.5},
        pedestrians__groups={"3": 1.0}, pedestrians__number=9, layout__circle_radius=8.0,
        pedestrians__arrival="respawn", pedestrians__goal_change={"period": 1.0, "chance": 1.0}, time_limit=8.0,
    )  # fmt: skip
    stands = (trace.goal[:, 0] == trace.position[:, 0])[:, 1:].all(axis=2)
    assert stands.any()
    assert not stands.all()
    row, pedestrian = np.nonzero(stands)
    path = trace.position[row, :, pedestrian + 1]
    assert all((way[np.isfinite(way[:, 0])] == way[0]).all() for way in path)
    assert norm(path[:, 0]).min() < 4.0
    for number in np.unique(row):
        members = trace.position[number, 0, 1:][stands[number]].reshape(-1, 3, 2)
        apart = norm(members - np.roll(members, 1, axis=1))
        assert apart == pytest.approx(0.8)
    assert (trace.person[row] == trace.person[row, :1])[:, :, 0].shape[0] == len(row)
    assert not (np.diff(trace.person.swapaxes(1, 2)[stands], axis=1) != 0).any()


def test_those_who_come_new_walk():
    place = load_scenario("circle_crossing_10", {"pedestrians.policy": {"orca": 0.25, "standing": 0.75}})
    assert dict(place.crowd.walking().shares) == {"orca": 0.25, "standing": 0.0}


@pytest.mark.parametrize("arrival", ["new_goal", "respawn", "back_and_forth"])
def test_a_group_goes_on_together(arrival):
    trace = drive(
        Still(), "6", "circle_crossing_10", pedestrians__policy="social_force", pedestrians__groups={"3": 1.0},
        pedestrians__number=6, layout__circle_radius=5.0, pedestrians__arrival=arrival, time_limit=30.0,
        pedestrians__goal_change={"period": 5.0, "chance": 0.3},
    )  # fmt: skip
    changed = (np.diff(trace.goal[:, :, 1:], axis=1) != 0.0).any(axis=3)
    assert changed.sum() > 20
    first, second = changed[:, :, :3], changed[:, :, 3:]
    for group in (first, second):
        assert (group.all(axis=2) == group.any(axis=2)).all()
    assert ((np.diff(trace.person, axis=1) != 0).any(axis=(0, 1))).all() == (arrival == "respawn")
    goals = trace.goal[:, :, 1:4]
    assert norm(np.diff(goals, axis=2)) == pytest.approx(0.8)


def test_a_case_with_groups_is_the_same_alone_and_in_a_batch():
    settings = {
        "pedestrians__policy": {"social_force": 0.7, "standing": 0.3},
        "pedestrians__groups": GROUPS,
        "pedestrians__arrival": "respawn",
        "layout__circle_radius": 7.0,
    }
    together = drive("orca", "4", "circle_crossing_mixed", **settings)
    alone = drive("orca", "2:3", "circle_crossing_mixed", **settings)
    assert np.array_equal(alone.position[0], together.position[2], equal_nan=True)


def force(position, velocity, group=(0, 0)):
    position, velocity = (np.array(values, float) for values in (position, velocity))
    n = len(position)
    return group_force(
        0, position, velocity, np.full(n, 0.3), np.ones(n, bool), np.array(group), GAZE, ATTRACTION, REPULSION
    )


def test_group_forces_are_those_of_the_paper():
    assert force([[0, 0], [0.9, 0]], [[0, 1], [0, 1]]) == (0.0, 0.0)
    assert force([[0, 0], [0.5, 0]], [[0, 1], [0, 1]]) == (-REPULSION, 0.0)
    assert force([[0, 0], [3, 0]], [[0, 1], [0, 1]]) == pytest.approx((ATTRACTION, 0.0))
    # The other is 45 degrees further behind than the eye sees.
    assert force([[0, 0], [0.6, -0.6]], [[0, 1], [0, 1]]) == pytest.approx((0.0, -GAZE * math.pi / 4))
    # The centre of three may be twice as far away.
    assert force([[0, 0], [1.3, 0], [1.3, 0.9]], [[0, 1]] * 3, (0, 0, 0)) == (0.0, 0.0)
    assert force([[0, 0], [3, 0]], [[0, 1], [0, 1]], (-1, -1)) == (0.0, 0.0)
    assert force([[0, 0], [3, 0]], [[0, 1], [0, 1]], (0, 2)) == (0.0, 0.0)


def test_social_forces_hold_groups_together():
    world = crowd(1, pedestrians__number=2, pedestrians__groups={"2": 1.0}, pedestrians__policy="social_force")
    apart = world.position.copy()
    apart[0, 1] += [0.0, 3.0]

    def walked(group):
        position, velocity = apart.copy(), np.zeros_like(apart)
        for _ in range(40):
            seen = np.array([[False, True, True]])
            walkers = to_walkers(position, velocity, world.goal, world.radius, world.preferred_speed, seen)
            velocity = social_force_velocities(walkers, np.zeros_like(position), group)
            position = position + 0.25 * velocity
        return math.dist(position[0, 1], position[0, 2])

    assert walked(np.array([[0, 0]])) < 1.3 < walked(None)


def test_couples_keep_a_metre_between_them():
    trace = drive(
        Still(), "10", "circle_crossing_10", pedestrians__policy="social_force", pedestrians__groups={"2": 1.0},
        pedestrians__number=8, layout__circle_radius=7.0, pedestrians__arrival="respawn", time_limit=12.0,
    )  # fmt: skip
    distance = norm(trace.position[:, 8:40, 1::2] - trace.position[:, 8:40, 2::2])
    assert np.nanmedian(distance) == pytest.approx(1.0, abs=0.1)


def test_a_crowd_without_groups_is_moved_as_before():
    world = crowd(3, pedestrians__groups={"1": 1.0}, pedestrians__policy="social_force")
    policy, table = SocialForce(), world.parameters["social_force"]
    strong = {**table, "group_attraction": table["group_attraction"] + 9.0}
    assert np.array_equal(policy.velocities(world, table), policy.velocities(world, strong))


def test_who_stops_and_goes_pauses_for_its_share_of_each_period():
    table = {"period": 4.0, "pause": 0.25}
    trace = drive(
        Still(), "30", "circle_crossing_5", pedestrians__policy="stop_and_go", pedestrians__stop_and_go=table,
        layout__circle_radius=30.0, time_limit=25.0,
    )  # fmt: skip
    stands = (trace.velocity[:, 1:, 1:] == 0.0).all(axis=3)[:, :96]
    assert (stands.sum(axis=1) == 24).all()
    begins = (np.diff(stands.astype(int), axis=1) == 1).argmax(axis=1) % 16
    assert len(np.unique(begins)) == 16


def test_the_other_parameters_of_who_stops_and_goes_are_those_of_its_walk():
    policy = PEDESTRIANS.load("stop_and_go")[1]
    assert policy.parameters == {**ORCA.parameters, "period": 8.0, "pause": 0.25}


def test_who_gives_way_to_nobody_walks_straight():
    trace = drive(Still(), "3", "circle_crossing_5", pedestrians__policy="straight", time_limit=6.0)
    start, goal = trace.position[:, 0, 1:], trace.goal[:, 0, 1:]
    expected = start + (goal - start) * (3.0 / norm(goal - start)[..., None])
    assert trace.position[:, 12, 1:] == pytest.approx(expected)


@pytest.mark.parametrize(
    "name", ["stop_and_go", "straight", "standing", pytest.param("learned", marks=pytest.mark.slow)]
)
def test_policies_of_habits_pass(name):
    place = load_scenario("circle_crossing_mixed", {"vehicle.visible": True, "time_limit": 3.5}, name)
    subject = Subject(POLICY, lambda: PEDESTRIANS.load(name)[1], name, {"": place}, neural=False)
    assert not failed_checks(subject, "val:5")


@pytest.mark.parametrize(
    ("groups", "sentence"),
    [
        ({"2": -1.0}, r"pedestrians.groups is {'2': -1.0}"),
        ({"0": 1.0}, "shares of groups"),
        ({"6": 1.0}, "from 1 to 5"),
        ({}, "shares"),
        ({"two": 1.0}, "shares"),
    ],
)
def test_impossible_groups_are_refused(groups, sentence):
    with pytest.raises(InputError, match=sentence):
        load_scenario("circle_crossing_5", {"pedestrians.groups": groups})


def test_a_group_fits_into_its_disc():
    for n in range(1, 6):
        radius = np.full(n, 0.3)
        for stands in (False, True):
            place = member_offsets(np.array([1.0, 2.0]), radius, stands)
            assert norm(place).max() + 0.3 <= group_reach(radius) + 1e-9
            assert place.mean(axis=0) == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("scenario", ["mixed_20", fixture("companions")])
def test_scenarios_of_people_are_the_same_again(scenario):
    trace = drive("orca_margin", "3", scenario)
    assert same(trace, drive("orca_margin", "3", scenario))
    assert (np.diff(trace.goal[:, :, 1:], axis=1) != 0.0).any()
