"""Tools for compiled kernels: blocks of work for threads, arguments that are numbers or arrays."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from typing import no_type_check

import numpy as np
from jaxtyping import Shaped

from crowdbench.utils.compiled import njit, number_of_threads
from crowdbench.utils.threads import share


def in_blocks(work: Callable[[int, int], None], items: int, least: int, most: int) -> None:
    """Divide items into blocks, and process them in the threads of a pool if there are enough items.

    Results do not depend on the blocks if kernels compute each item independently. Kernels release Python's lock.

    Args:
        work: Called with the first item of each block, and with the one after its last.
        items: The number of items.
        least: Smallest number of items that is worth a thread.
        most: Largest number of items of a block.
    """
    if items < 2 * least and items <= most:
        work(0, items)
        return
    workers = number_of_threads()
    blocks = max(min(workers, items // least), 1)
    blocks *= math.ceil(items / (blocks * most))
    bounds = [items * k // blocks for k in range(blocks + 1)]
    share(lambda block: work(*block), itertools.pairwise(bounds), workers, None)


def writable(array: np.ndarray) -> np.ndarray:
    """Return the array, or a copy that is contiguous and writable: numba compiles a kernel again for other kinds."""
    return array if array.flags.carray else array.copy()


def per_agent(value: float | np.ndarray) -> Shaped[np.ndarray, "_ _"]:
    """Return a number for all agents, or an array `[world]` or `[world, agent]`, in the form in which `at` reads it.

    Args:
        value: The number or the array. An axis of length 1 holds one value for all.
    """
    if not isinstance(value, np.ndarray):
        return _number(value)
    array: np.ndarray = np.ascontiguousarray(value, np.float64)
    return array if array.ndim == 2 else array.reshape(-1, 1)


@functools.cache
def _number(value: float) -> Shaped[np.ndarray, "1 1"]:
    # Cached, because creating this array takes as long as a kernel call for one world.
    return np.full((1, 1), value, np.float64)


@no_type_check
@njit
def at(array, w, i):
    """Return one agent's value in an array of `per_agent`.

    Args:
        array (array): The array.
        w (int): Index of the world.
        i (int): Index of the agent.
    """
    return array[min(w, array.shape[0] - 1), min(i, array.shape[1] - 1)]
