"""Personal space: a distance that ORCA adds between pedestrians, and that differs between people."""

import numpy as np
import pytest
from helpers import world

from agents.pedestrians.orca_people import ORCAPeople
from crowdbench.core.types import Intention, Rules
from crowdbench.sim.pedestrians import ORCA
from crowdbench.sim.pedestrians.orca import Agents, Avoidance, avoid
from crowdbench.sim.simulator import INTENTION, crowd_decisions, init_memories

LIMITS = Avoidance(*(np.array([[value]]) for value in (10.0, 10.0, 3.0, 1.0, 0.0)))
WALL = np.array([[[[-5.0, 1.0], [5.0, 1.0], [5.0, 1.2], [-5.0, 1.2]]]])
NO_WALLS = np.empty((1, 0, 0, 2))
ALL = np.ones((1, 1), bool)


def decide(position, velocity, space, first=1, walls=NO_WALLS):
    """The velocities of agents with a radius of 0.3 m that want to keep theirs."""
    position, velocity = (np.array([rows], float) for rows in (position, velocity))
    size = np.full(position.shape[:2], 0.3)
    crowd = Agents(position, velocity, velocity, size, np.full_like(size, 1.5), ALL, ALL, np.array([[space]]))
    return avoid(first, crowd, 0.25, walls, LIMITS)[0]


PASSING = [[0.0, 50.0], [0.0, 0.0], [3.0, 0.7]], [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]]


def test_those_who_pass_far_enough_for_their_bodies_evade_for_more_space():
    assert decide(*PASSING, space=0.0) == pytest.approx(np.array([[1.0, 0.0], [-1.0, 0.0]]))
    evading = decide(*PASSING, space=0.4)
    assert evading[0, 1] < -0.01
    assert evading[1, 1] > 0.01


def test_negative_space_lets_others_come_nearer():
    position, velocity = [[0.0, 50.0], [0.0, 0.0], [3.0, 0.5]], PASSING[1]
    assert decide(position, velocity, space=0.0)[0, 1] < -0.005
    assert decide(position, velocity, space=-0.2) == pytest.approx(np.array([[1.0, 0.0], [-1.0, 0.0]]))


def test_the_vehicle_and_walls_are_avoided_without_it():
    with_vehicle = [[3.0, 0.5], [0.0, 0.0]], [[-1.0, 0.0], [1.0, 0.0]]
    assert np.array_equal(decide(*with_vehicle, space=0.4), decide(*with_vehicle, space=0.0))
    at_a_wall = [[0.0, 50.0], [0.0, 0.6]], [[0.0, 0.0], [1.0, 0.2]]
    near, far = (decide(*at_a_wall, space=space, walls=WALL) for space in (0.0, 0.4))
    assert near[0, 1] < 0.2
    assert np.array_equal(near, far)


def test_people_keep_their_own_space():
    scene = world(*PASSING, [[0.0, 50.0], [9.0, 0.0], [-9.0, 0.7]])
    policy = ORCAPeople()

    def evasions(spaces):
        table = {name: np.full(scene.radius.shape, value, float) for name, value in policy.parameters.items()}
        table["personal_space"] = np.array([[1.0, *spaces]])
        return np.abs(policy.velocities(scene, table)[0, :, 1])

    narrow, wide = evasions((0.9, 2.5))
    assert narrow < 0.1 < wide
    assert evasions((2.5, 0.9)) == pytest.approx([wide, narrow])


def test_inertias_differ_by_their_spread():
    people = 2000
    y = 9.0 * np.arange(people + 1)
    start = np.column_stack([0.0 * y, y])
    rules = Rules(dt=0.25, intentions=(Intention(0.1, 1.0, 2.0, 0.5),))
    now = init_memories(world(start, goal=start + np.array([50.0, 0.0]), rules=rules), {"orca": ORCA()})
    for _ in range(2):  # a person keeps its own
        _, now = crowd_decisions(now, {"orca": ORCA()})
        factors = np.log(now.memory[INTENTION]["inertia"][0] / 2.0)
        assert abs(factors).max() <= 1.0 + 1e-9
        assert factors.std() == pytest.approx(0.5 * 0.96, rel=0.05)  # limited to two standard deviations
        assert factors.mean() == pytest.approx(0.0, abs=0.04)


def test_nobody_is_avoided_by_less_than_its_centre():
    position, velocity = [[0.0, 50.0], [0.0, 0.0], [3.0, 0.1]], PASSING[1]
    assert np.array_equal(decide(position, velocity, space=-0.7), decide(position, velocity, space=-0.6))
