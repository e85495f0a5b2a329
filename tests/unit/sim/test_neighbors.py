"""Neighbours from cells are the same, in the same order, as among all others."""

import numpy as np
import pytest

from crowdbench.sim import neighbors
from crowdbench.sim.neighbors import cells_of, nearest_in_cells, nearest_of_all
from crowdbench.sim.obstacles import touches_in_step
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
def neighbors_of_everybody(everywhere, position, seen, cells, reach, limit, polygons=None):
    room = len(position[0])
    neighbor, distance = np.empty((room, room), np.int64), np.full((room, room), np.nan)
    number = np.empty(room, np.int64)
    for i in range(room):
        if everywhere:
            number[i] = nearest_of_all(0, i, position, seen, reach, limit, neighbor[i], distance[i])
        else:
            number[i] = nearest_in_cells(0, i, position, cells, reach, limit, polygons, neighbor[i], distance[i])
        neighbor[i, number[i] :] = -1
        distance[i, number[i] :] = -1.0
    return neighbor, distance


def agree(position, seen=None, reach=10.0, limit=10):
    position = position[None].copy()
    seen = np.ones((1, 1), bool) if seen is None else seen[None]
    cells = cells_of(position, seen)
    results = [neighbors_of_everybody(everywhere, position, seen, cells, reach, limit) for everywhere in (True, False)]
    return all(np.array_equal(*pair, equal_nan=True) for pair in zip(*results, strict=True))


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


@pytest.mark.slow
def test_walls_hide_others_in_cells_too():
    wall, position, seen = np.array([[[12.0, 0.0], [12.0, 20.0]]]), CROWDS["even"][None].copy(), np.ones((1, 1), bool)
    cells = cells_of(position, seen)
    everybody, _ = neighbors_of_everybody(True, position, seen, cells, 10.0, 160)
    visible, _ = neighbors_of_everybody(False, position, seen, cells, 10.0, 10, wall)
    for i, (x, y) in enumerate(position[0]):
        others = [(j, position[0, j] - (x, y)) for j in everybody[i] if j >= 0]
        expected = [j for j, way in others if not touches_in_step(x, y, *way, 0.0, wall)][:10]
        assert [j for j in visible[i] if j >= 0] == expected


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_one_cell_holds_all_where_nobody_is_seen_or_a_position_is_not_finite(number):
    position = CROWDS["even"].copy()
    assert agree(position, np.zeros(160, bool))
    position[7, 1] = number
    assert cells_of(position[None], np.ones((1, 1), bool)).size.tolist() == [[1, 1]]
    assert agree(position)


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
