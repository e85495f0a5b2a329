"""The space around the vehicle in which nobody starts or comes in."""

import numpy as np
import pytest
from helpers import drive

from crowdbench import load_scenario
from crowdbench.scenario.clear_space import ClearSpace
from crowdbench.utils.errors import InputError

SPACE = {"distance": 1.5, "time": 1.5}
KEY = "pedestrians.clear_space"


def gaps(world):
    """Distances between the rims of the vehicle, a disc, and of pedestrians, infinite in the padding."""
    far = np.linalg.norm(world.position[:, 1:] - world.position[:, :1], axis=2)
    return np.where(world.present[:, 1:], far - world.radius[:, 1:] - world.radius[:, :1], np.inf)


@pytest.mark.parametrize("name", ["circle_20_blind", "door_10"])
def test_nobody_starts_in_it(name):
    cases = np.arange(15)
    without, there = (load_scenario(name, changes).draw("test", cases) for changes in ({KEY: None}, {KEY: SPACE}))
    assert gaps(without).min() < 1.0
    assert gaps(there).min() >= 1.5
    np.testing.assert_array_equal(there.radius, without.radius)
    # Cases that were clear before start as they did.
    same = (there.position == without.position).all(axis=(1, 2))
    assert not same[gaps(without).min(axis=1) < 1.5].any()
    again = load_scenario(name, {KEY: SPACE}).draw("test", cases[11:12])
    np.testing.assert_array_equal(again.position[0], there.position[11][: again.position.shape[1]])


@pytest.mark.slow
def test_nobody_comes_in_near_the_vehicle():
    """Who has come in was not there in the state before."""
    least = {}
    for clear in (None, SPACE):
        changes = {"vehicle__radius": 0.05, "pedestrians__clear_space": clear}
        trace = drive("orca_margin", "10", "streets_16_blind", **changes)
        row, before, pedestrian = np.nonzero(np.diff(trace.person, axis=1) > 0)
        after = before + 1
        way = trace.position[row, after, pedestrian + 1] - trace.position[row, after, 0]
        reach = trace.radius[row, after, pedestrian + 1] + trace.radius[row, after, 0]
        assert len(row) > 30
        least[clear is None] = np.nanmin(np.linalg.norm(way, axis=1) - reach)
    assert least[True] < 1.0
    assert least[False] >= 1.5


@pytest.mark.parametrize(
    ("position", "velocity", "clear"),
    [
        ([3.0, 0.0], [0.0, 0.0], True),
        ([2.0, 0.0], [0.0, 0.0], False),  # 1.4 m
        ([4.0, 0.0], [-1.0, 0.0], True),  # they touch after 1.7 s
        ([3.5, 0.0], [-1.0, 0.0], False),  # after 1.45 s
        ([3.5, 0.7], [-1.0, 0.0], True),  # they pass
        ([-3.5, 0.0], [-1.0, 0.0], True),  # it drives away from him
    ],
)
def test_there_is_space_where_nobody_is_near_or_soon_touches(position, velocity, clear):
    people = np.array([[20.0, 20.0], position]), np.array([[0.0, 0.0], velocity]), np.array([0.6, 0.6])
    assert ClearSpace(**SPACE).holds(np.zeros((1, 2)), np.array([1.0, 0.0]), *people) == clear


def test_the_whole_body_counts():
    given = np.array([[0.0, 0.0], [0.0, 2.0]]), np.zeros(2), np.array([[0.0, 3.9]]), np.zeros((1, 2)), np.array([0.6])
    assert not ClearSpace(distance=1.5, time=0.0).holds(*given)
    assert ClearSpace(distance=1.2, time=0.0).holds(*given)


def test_what_cannot_be_gets_one_sentence():
    with pytest.raises(InputError, match="somebody is in the clear_space in all 1000 placemen"):
        load_scenario("circle_20_blind", {KEY: {"distance": 20.0, "time": 0.0}}).draw("test", np.arange(1))
    with pytest.raises(InputError, match="clear_space is given, but must be left out where crowdnav_cases is not 0"):
        load_scenario("circle_crossing_5", {KEY: SPACE})
    with pytest.raises(InputError, match=r"clear_space\.time is missing"):
        load_scenario("circle_20_blind", {KEY: {"distance": 1.5}})
