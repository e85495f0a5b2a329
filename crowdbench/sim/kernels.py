"""Tools for compiled kernels: loops for one thread and for all, and arguments that are a number or an array."""

from __future__ import annotations

import functools
import threading
import types
from collections.abc import Callable
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Shaped

from crowdbench.utils.compiled import njit

_ONE_AT_A_TIME = threading.Lock()


def serial_and_parallel(loop: types.FunctionType) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Compile a function twice.

    Args:
        loop: A function with a loop over `prange`.

    Returns:
        The function compiled for one thread, and for all threads. Calls of the second one wait for each other.
    """
    # The second one gets another name, because the cache removes what another version of a kernel has left.
    twin = types.FunctionType(loop.__code__, loop.__globals__, f"{loop.__name__}_parallel", None, loop.__closure__)
    twin.__module__, twin.__qualname__ = loop.__module__, twin.__name__
    parallel = njit(error_model="numpy", parallel=True)(twin)

    def in_turn(*arguments: Any) -> None:
        # numba's threading layer workqueue ends the process when two threads enter it. The others lose nothing by
        # waiting, because each call uses all cores.
        with _ONE_AT_A_TIME:
            parallel(*arguments)

    return njit(error_model="numpy")(loop), in_turn


def writable(array: np.ndarray) -> np.ndarray:
    """The array, or a copy of it, that lies in order and can be written: for other kinds a kernel is compiled again."""
    return array if array.flags.carray else array.copy()


def per_agent(value: float | np.ndarray, dtype: type = np.float64) -> Shaped[np.ndarray, "_ _"]:
    """A number for all agents, or an array `[world]` or `[world, agent]`, in the form in which `at` reads it.

    Args:
        value: The number or the array. An axis of length 1 holds one value for all.
        dtype: What the result holds: a kernel is compiled for each kind of array that it is given.
    """
    if not isinstance(value, np.ndarray):
        return _number(value, dtype)
    array: np.ndarray = np.ascontiguousarray(value, dtype)
    return array if array.ndim == 2 else array.reshape(-1, 1)


@functools.cache
def _number(value: float, dtype: type) -> Shaped[np.ndarray, "1 1"]:
    # Cached, because making this array takes as long as a kernel does for one world.
    return np.full((1, 1), value, dtype)


@no_type_check
@njit
def at(array, w, i):
    """One agent's value in an array that `per_agent` made.

    Args:
        array (array): The array.
        w (int): Index of the world.
        i (int): Index of the agent.
    """
    # The index of a prange is unsigned, and numba compares unsigned with signed integers as floats.
    return array[min(np.int64(w), array.shape[0] - 1), min(i, array.shape[1] - 1)]
