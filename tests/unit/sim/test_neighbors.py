"""Neighbours from cells are the same, in the same order, as among all others."""

import numpy as np
import pytest

from crowdbench.sim import neighbors
from crowdbench.sim.neighbors import cells_of, nearest_in_cells, nearest_of_all
from crowdbench.sim.pedestrians import orca
from crowdbench.utils.compiled import njit

RANDOM = np.random.default_rng(0)


def lattice(n):
    side = int(np.ceil(np.sqrt(n)))
    return np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)[:n].astype(float)


CROWDS = {
    "even": RANDOM.uniform(0.0, 25.0, (160, 2)),
    "ties": RANDOM.permutation(lattice(169)),
    "far ones": np.concatenate([RANDOM.normal(size=(157, 2)), [[1e6, 0.0], [-40.0, 3e5], [0.0, 900.0]]]),
    "two crowds": np.concatenate([RANDOM.normal(size=(100, 2)), 1e4 + RANDOM.normal(size=(60, 2))]),
    "a line": np.stack([RANDOM.uniform(0.0, 60.0, 150), np.full(150, 7.0)], axis=1),
    "one place": np.full((140, 2), 3.0),
    "tiny distances": 1e5 + 1e-9 * lattice(144),
}


@njit
def found(everywhere, position, seen, cells, reach, limit, polygons):
    room = len(position[0])
    neighbor, distance = np.empty((room, room), np.int64), np.full((room, room), np.nan)
    number = np.empty(room, np.int64)
    for i in range(room):
        if everywhere:
            number[i] = nearest_of_all(0, i, position, seen, reach, limit, polygons, neighbor[i], distance[i])
        else:
            number[i] = nearest_in_cells(0, i, position, cells, reach, limit, polygons, neighbor[i], distance[i])
        neighbor[i, number[i] :] = -1
        distance[i, number[i] :] = -1.0
    return neighbor, distance


def agree(position, seen=None, reach=10.0, limit=10, polygons=None):
    position = position[None].copy()
    seen = np.ones((1, 1), bool) if seen is None else seen[None]
    polygons = np.empty((0, 0, 2)) if polygons is None else polygons
    cells = cells_of(position, seen)
    assert cells.size[0, 0] > 0
    one, other = (found(all_, position, seen, cells, reach, limit, polygons) for all_ in (True, False))
    return all(map(np.array_equal, one, other))


@pytest.fixture(autouse=True)
def _cells_always(monkeypatch):
    monkeypatch.setattr(neighbors, "CELLS_FROM", 0)


@pytest.mark.parametrize("crowd", CROWDS)
@pytest.mark.parametrize(("reach", "limit"), [(10.0, 10), (2.0, 3), (1e9, 400), (np.inf, 1), (0.0, 10), (10.0, 0)])
def test_cells_find_the_neighbours_that_a_search_among_all_finds(crowd, reach, limit):
    assert agree(CROWDS[crowd], reach=reach, limit=limit)


def test_some_are_not_seen_and_may_be_far_away():
    position = np.concatenate([CROWDS["ties"], [[-500.0, 3.0], [3.0, 1e5], [1e7, 1e7]]])
    seen = RANDOM.random(len(position)) < 0.6
    seen[-3:] = False
    assert agree(position, seen)


def test_walls_hide_others_in_cells_too():
    wall = np.array([[[12.0, 0.0], [12.0, 20.0]]])
    assert agree(CROWDS["even"], polygons=wall)


def test_nobody_is_seen_or_a_position_is_not_finite():
    position = CROWDS["even"][None].copy()
    assert cells_of(position, np.zeros((1, 160), bool)).size[0, 0] < 0
    position[0, 7, 1] = np.nan
    assert cells_of(position, np.ones((1, 1), bool)).size[0, 0] < 0


@pytest.mark.parametrize("block", [(10**9, 10**9), (1, 50)])
def test_orca_is_the_same_from_cells_in_any_batch(block, monkeypatch):
    worlds = [CROWDS[name][:140] for name in ("even", "ties", "two crowds", "a line")]
    position = np.stack(worlds)
    position[2, 3] = np.nan  # of somebody that nobody sees
    seen = RANDOM.random(position.shape[:2]) < 0.9
    seen[2, 3] = False
    velocity, preferred = RANDOM.normal(size=(2, *position.shape))
    size, speed = np.full((2, *position.shape[:2]), [[[0.3]], [[1.0]]])
    moves = np.isfinite(position[:, :, 0])
    inputs = position, velocity, preferred, size, speed
    monkeypatch.setattr(orca, "BLOCK_AGENTS", block)
    got = orca.orca_velocities(*inputs, seen=seen, moves=moves)
    alone = [
        orca.orca_velocities(*(a[w : w + 1] for a in (*inputs,)), seen=seen[w : w + 1], moves=moves[w : w + 1])
        for w in range(4)
    ]
    monkeypatch.setattr(neighbors, "CELLS_FROM", 10**9)
    assert np.array_equal(got, orca.orca_velocities(*inputs, seen=seen, moves=moves))
    assert np.array_equal(got, np.concatenate(alone))
