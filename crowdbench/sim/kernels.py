"""What compiled kernels are built with: arguments that are a number or an array, loops for one thread and for all."""

from __future__ import annotations

import functools
import types
from collections.abc import Callable
from typing import Any, no_type_check

import numpy as np
from numba import njit


def serial_and_parallel(loop: types.FunctionType) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """A function with a loop over `prange`, compiled for one thread and for all."""
    # Under a name of its own: numba's cache on disk tells functions apart by name and line, not by options,
    # and would hand out one's machine code for the other.
    twin = types.FunctionType(loop.__code__, loop.__globals__, f"{loop.__name__}_parallel")
    twin.__module__, twin.__qualname__ = loop.__module__, twin.__name__
    return njit(cache=True, error_model="numpy")(loop), njit(cache=True, error_model="numpy", parallel=True)(twin)


def per_agent(value: float | np.ndarray, dtype: type = np.float64) -> np.ndarray:
    """A number, or an array [world] or [world, agent], in the form in which kernels read it by `at`."""
    if not isinstance(value, np.ndarray):
        return _number(value, dtype)
    array: np.ndarray = np.ascontiguousarray(value, dtype)
    return array if array.ndim == 2 else array.reshape(-1, 1)


@functools.cache
def _number(value: float, dtype: type) -> np.ndarray:
    # Kept, because a kernel's call for one world takes microseconds, and so would making these.
    return np.full((1, 1), value, dtype)


@no_type_check
@njit(cache=True)
def at(array, w, i):
    """The value for agent i of world w: an axis of length 1 stands for all."""
    # The index of a prange is unsigned, and numba compares unsigned with signed as floats.
    return array[min(np.int64(w), array.shape[0] - 1), min(i, array.shape[1] - 1)]
