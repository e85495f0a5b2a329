"""The study of validity: the periodic corridor, lanes, the door, and what the policies that ship do there."""

import dataclasses
import functools
import itertools

import numpy as np
import pytest

from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError
from studies.validity import door, experiments, page
from studies.validity.corridor import corridor, forward_speed, lane_order, people_of, spread, walk
from studies.validity.door import STILL, Passages
from studies.validity.experiments import DEFAULT, MEASURED, POINTS, Setting, crowd, run_experiment
from studies.validity.page import weidmann_speed
from studies.validity.run import validity

FEW = dataclasses.replace(DEFAULT, densities=(0.5,), per_metre=(0.8,))


def start(number, length, people=MEASURED, backward=0.5, worlds=1, policy="orca"):
    scenario = crowd(policy, people, 2 * number, corridor(length, 2.4, backward))
    return scenario.worlds(Cases("test", 0, worlds)), scenario.policies


@pytest.mark.parametrize(("number", "radius"), [(1, 0.3), (12, 0.3), (60, 0.3), (96, 0.2), (72, 0.01)])
def test_people_have_room_at_the_start(number, radius):
    places = spread(np.random.default_rng(0), number, radius, 10.0, 2.4)
    assert (places >= [radius - 1e-9, radius - 1.2 - 1e-9]).all()
    assert (places <= [10.0 - radius + 1e-9, 1.2 - radius + 1e-9]).all()
    apart = np.hypot(*(places[:, None] - places).T) + 10.0 * np.eye(number)
    assert apart.min() >= 2.0 * radius - 1e-9


def test_too_many_people_are_refused():
    with pytest.raises(InputError, match=r"65 people of radius 0.3 m have no room on 10 m x 2.4 m"):
        spread(np.random.default_rng(0), 65, 0.3, 10.0, 2.4)


def test_a_corridor_of_twice_the_length_with_the_crowd_twice_is_the_same():
    """Nobody feels the seam: what is a step across it in the short corridor is one in its middle in the long one."""
    short, policies = start(20, 10.0)
    long, _ = start(40, 20.0)
    who = people_of(short)
    twice = np.concatenate([short.position[:, who], short.position[:, who] + [10.0, 0.0]], axis=1)
    images = twice + np.where(twice[..., :1] < 10.0, [20.0, 0.0], [-20.0, 0.0])
    position = np.concatenate([long.position[:, :1], twice, images], axis=1)
    ahead = (short.goal - short.position)[:, who]
    goal = position + np.concatenate([long.goal[:, :1] - long.position[:, :1], *[ahead] * 4], axis=1)
    speed = np.tile(short.preferred_speed[:, who], 4)
    speed = np.concatenate([short.preferred_speed[:, :1], speed], axis=1)
    long = long.replace(position=position, goal=goal, preferred_speed=speed)
    crossed = 0
    for one, two in zip(walk(short, policies, 10.0, 30), walk(long, policies, 20.0, 30), strict=True):
        np.testing.assert_allclose(forward_speed(two), np.tile(forward_speed(one), 2), atol=1e-6)
        crossed += (np.abs(one.history[:, -1, :20, 0] - one.history[:, -2, :20, 0]) > 5.0).sum()
        assert (one.position[:, who, 0] >= 0.0).all()
        assert (one.position[:, who, 0] < 10.0).all()
    assert crossed == 0  # the history moves with its person
    assert np.abs(one.position[:, who] - short.position[:, who]).max() > 5.0  # somebody has crossed the seam


def test_who_walks_alone_has_its_preferred_speed():
    world, policies = start(1, 10.0, backward=0.0, worlds=3)
    *_, last = walk(world, policies, 10.0, 80)
    np.testing.assert_allclose(forward_speed(last), last.preferred_speed[:, 1:2])


def test_in_single_file_nobody_leaves_the_middle():
    world, policies = start(10, 10.0, people=DEFAULT, backward=0.0, policy="social_force")
    for after in walk(world, policies, 10.0, 10, single_file=True):
        assert (after.position[:, people_of(after), 1] == 0.0).all()


@pytest.mark.parametrize("policy", ["orca", "social_force"])
@pytest.mark.parametrize("experiment", ["two ways", "door"])
def test_a_world_does_not_depend_on_those_beside_it(policy, experiment, monkeypatch):
    monkeypatch.setattr(door, "TIME", 10.0)
    setting = Setting(experiment, policy, MEASURED, 1.0)
    alone, many = (run_experiment(setting, worlds, 5.0) for worlds in (1, 3))
    for name, values in vars(many).items():
        of_one = values[:1] if isinstance(values, np.ndarray) else values
        np.testing.assert_array_equal(getattr(alone, name), of_one)


def test_lanes_of_one_direction_have_order_1():
    across = np.array([[0.0, 0.1, 0.2, 1.0, 1.1, 1.2]])
    assert lane_order(across, np.array([[1.0, 1, 1, -1, -1, -1]]), 0.2) == pytest.approx(1.0)
    assert lane_order(across, np.array([[1.0, 1, -1, 1, -1, -1]]), 0.2) < 0.0


def test_mixed_directions_have_order_0_on_average():
    across = np.array([[0.0, 0.2, 0.35, 0.9, 1.0, 2.0]])
    ways = sorted(set(itertools.permutations([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])))
    orders = lane_order(np.repeat(across, len(ways), axis=0), np.array(ways), 0.2)
    assert len(ways) == 20
    assert orders.mean() == pytest.approx(0.0, abs=1e-12)


def test_the_flow_goes_from_the_first_passage_to_the_last():
    all_through, one_left, nobody = [4, 8, 12, 16], [4, 8, 12, -1], [-1, -1, -1, -1]
    passages = Passages(np.array([all_through, one_left, nobody]), 0.25, 480)
    np.testing.assert_allclose(passages.flow(), [3 / 3.0, 2 / (475 * 0.25), np.nan])
    np.testing.assert_allclose(passages.share, [1.0, 0.75, 0.0])
    assert passages.blocked.tolist() == [False, True, True]
    late = Passages(np.array([[4, 479 - int(STILL), -1]]), 0.25, 480)
    assert not late.blocked[0]


def speed(policy, people, density):
    return run_experiment(Setting("one way", policy, people, density), 2, 20.0).speed.mean()


@pytest.mark.slow
def test_the_limits_that_the_page_names_are_there(monkeypatch):
    """If one of these fails because a policy has become better, mend `page.LIMITS` and print the page again."""
    monkeypatch.setattr(door, "TIME", 40.0)
    assert speed("orca", DEFAULT, 1.5) > 0.99  # does not slow down
    assert speed("orca", MEASURED, 2.0) > 1.5 * weidmann_speed(2.0)  # slows down too little
    assert speed("social_force", DEFAULT, 1.5) < 0.0  # walks backwards
    assert speed("social_force", POINTS, 1.0) > 0.5  # as points it goes on
    assert run_experiment(Setting("two ways", "orca", DEFAULT, 2.0), 2, 20.0).stuck.all()
    assert run_experiment(Setting("two ways", "social_force", POINTS, 0.5), 2, 40.0).order.max() < 0.2  # no lanes
    assert run_experiment(Setting("two ways", "orca", MEASURED, 0.5), 2, 40.0).order.min() > 0.5
    assert run_experiment(Setting("door", "social_force", MEASURED, 0.8), 2).share.max() < 0.5
    assert run_experiment(Setting("door", "orca", MEASURED, 1.6), 2).share.min() == 1.0


def test_the_command_prints_the_page(monkeypatch, capsys):
    for module in (experiments, page):
        monkeypatch.setattr(module, "EVERYBODY", (FEW,))
    monkeypatch.setattr(experiments, "DOORS", (1.6,))
    monkeypatch.setattr(experiments, "run_experiment", functools.partial(run_experiment, worlds=2, time=3.0))
    validity(["orca"])
    printed = capsys.readouterr().out
    assert printed.splitlines()[2].startswith("Printed by `python studies/validity/run.py orca`.")
    assert "a mean over 2 worlds" in printed
    assert "**orca**: " in printed
    assert "**social_force**: " not in printed
    speeds = printed.split("| people per m² | 0.5 |\n")[1].splitlines()
    assert [line.split(" | ")[0] for line in speeds[1:4]] == ["| published", "| orca", "| overlapping"]
    assert [line.split(" | ")[1:3] for line in printed.splitlines() if " 1.6 m " in line] == [["1.6 m", "-"]]
