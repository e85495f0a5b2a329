"""Tools for compiled kernels: blocks of work for threads, fields of tuples, arguments that are numbers or arrays."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable
from typing import Any, no_type_check

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


class FlatKernel:
    """Kernel of named tuples that Python calls with the fields of the tuples as arguments.

    numba takes about a microsecond to receive a named tuple of arrays. Passed as named tuples, the arguments of a step
    would take a third of its time in one world.

    Attributes:
        compiled: The kernel that takes the fields.
    """

    def __init__(self, kernel: Callable[..., None], *kinds: type) -> None:
        fields = [[f"{kind.__name__}_{field}" for field in kind._fields] for kind in kinds]  # type: ignore[attr-defined]
        calls = [f"{kind.__name__}({', '.join(names)})" for kind, names in zip(kinds, fields, strict=True)]
        scope: dict[str, Any] = {kind.__name__: kind for kind in kinds}
        scope |= {"__name__": kernel.__module__, "inner": njit(kernel, inline="always")}
        name = kernel.__name__
        exec(f"def {name}({', '.join(itertools.chain(*fields))}):\n    inner({', '.join(calls)})", scope)
        self.compiled = njit(scope[name], nogil=True)

    def __call__(self, *tuples: Iterable[Any]) -> None:
        """Call the kernel with its named tuples."""
        self.compiled(*itertools.chain(*tuples))


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
