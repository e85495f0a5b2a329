"""Kernels give the same bits with any number of threads, from several threads at once, and in a forked process."""

import multiprocessing
import os
import threading

import numpy as np
import pytest
from helpers import to_walkers

import crowdbench
from agents.pedestrians import power_law
from crowdbench.sim import kernels, neighbors
from crowdbench.sim.pedestrians import forces, orca, social_force

WORLDS, AGENTS = 40, 6


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch):
    """Blocks of few agents, so that small crowds are divided too."""
    monkeypatch.setattr(orca, "BLOCK_AGENTS", (1, 7))
    monkeypatch.setattr(forces, "BLOCK_PAIRS", 1)


def scene():
    position = np.random.default_rng(0).normal(size=(WORLDS, AGENTS, 2)) * 3.0
    return position, position * 0.0, -position, np.full((WORLDS, AGENTS), 0.3), np.ones((WORLDS, AGENTS))


def avoid():
    return orca.orca_velocities(*scene())


def avoid_among_walls():
    walls = np.array([[[[-1.0, 0.0], [1.0, 0.0]], [[0.0, 2.0], [3.0, 4.0]]]])
    return orca.orca_velocities(*scene(), obstacles=walls, line_of_sight=True)


def push():
    walkers = to_walkers(*scene())
    return social_force.social_force_velocities(walkers, np.zeros((WORLDS, AGENTS, 2)))


def foresee():
    return power_law.power_law_velocities(to_walkers(*scene()))


WORK = {"orca": avoid, "walls": avoid_among_walls, "social force": push, "power law": foresee}


@pytest.mark.parametrize("name", WORK)
def test_any_number_of_threads_gives_the_same_bits(name, monkeypatch):
    results = []
    for number in (1, 2, 5):
        monkeypatch.setattr(kernels, "number_of_threads", lambda number=number: number)
        results.append(WORK[name]())
    assert all(np.array_equal(result, results[0]) for result in results)


def test_cells_are_the_same_with_any_number_of_threads(monkeypatch):
    monkeypatch.setattr(neighbors, "CELLS_FROM", 0)
    results = []
    for number in (1, 3):
        monkeypatch.setattr(kernels, "number_of_threads", lambda number=number: number)
        results.append(avoid())
    assert np.array_equal(*results)


def test_several_threads_may_run_the_simulator_at_once(monkeypatch):
    monkeypatch.setattr(kernels, "number_of_threads", lambda: 2)
    expected, results = avoid(), []

    def compute():
        for _ in range(30):
            results.append(avoid())

    callers = [threading.Thread(target=compute) for _ in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert len(results) == 120
    assert all(np.array_equal(result, expected) for result in results)


def margins(_=None):
    return crowdbench.run("orca_margin", "circle_crossing_5", cases="test:0:100").episodes.outcome.tolist()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked here")
def test_a_forked_process_runs_what_its_parent_has_run(monkeypatch):
    monkeypatch.setattr(kernels, "number_of_threads", lambda: 2)
    expected = avoid()
    before = margins()
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map_async(margins, range(2)).get(timeout=120) == [before, before]
        assert np.array_equal(pool.apply_async(avoid).get(timeout=60), expected)


def test_blocks_cover_all_items_once(monkeypatch):
    monkeypatch.setattr(kernels, "number_of_threads", lambda: 3)
    for items in (0, 1, 5, 100, 1000):
        seen = np.zeros(items, int)

        def count(begin, end, seen=seen):
            assert end - begin <= 64
            seen[begin:end] += 1

        kernels.in_blocks(count, items, 10, 64)
        assert (seen == 1).all()
