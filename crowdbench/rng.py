"""Random streams keyed by (seed, split, case, purpose), so that a case is the same in any batch and order.

All streams come from Philox 4x64-10 (Salmon et al. 2011), a counter-based generator: NumPy's own where
a `Generator` is wanted, the same function compiled here where noise is drawn for whole batches.
"""

from __future__ import annotations

import functools
import hashlib
import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int, UInt
from numba import njit

SPLITS = ("train", "val", "test")
"""The splits of a scenario's cases; each has cases 0, 1, 2, ... without end."""


def case_keys(seed: int, split: str, cases: Int[np.ndarray, "world"]) -> UInt[np.ndarray, "world"]:
    """The 64-bit key from which all streams of each case start."""
    return _keys(np.uint64(seed), np.uint64(SPLITS.index(split)), cases.astype(np.uint64))


def generator(key: np.uint64, purpose: str) -> np.random.Generator:
    """A NumPy generator for one purpose in one case."""
    return np.random.Generator(np.random.Philox(key=np.array([key, _purpose(purpose)], np.uint64)))


def normal(
    key: UInt[np.ndarray, "world"], purpose: str, step: Int[np.ndarray, "world"], pedestrians: int, n: int
) -> Float[np.ndarray, "world pedestrian n"]:
    """Standard normal noise, a function of (key, purpose, step, pedestrian, index) alone."""
    out = np.empty((len(key), pedestrians, n))
    _normal(key, _purpose(purpose), step, out)
    return out


@functools.cache
def _purpose(name: str) -> np.uint64:
    return np.uint64(int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little"))


_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_MULTIPLIERS = (np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157))
_WEYL = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B))


@no_type_check
@njit(cache=True)
def _high_product(a, b):
    """The upper 64 bits of a * b."""
    a0, a1, b0, b1 = a & _LOW, a >> _HALF, b & _LOW, b >> _HALF
    middle = a1 * b0 + ((a0 * b0) >> _HALF)
    return a1 * b1 + (middle >> _HALF) + ((a0 * b1 + (middle & _LOW)) >> _HALF)


@no_type_check
@njit(cache=True)
def philox(c0, c1, c2, c3, k0, k1):
    """Four random 64-bit words for a 256-bit counter and a 128-bit key, all uint64."""
    for _ in range(10):
        c0, c1, c2, c3 = (
            _high_product(_MULTIPLIERS[1], c2) ^ c1 ^ k0,
            _MULTIPLIERS[1] * c2,
            _high_product(_MULTIPLIERS[0], c0) ^ c3 ^ k1,
            _MULTIPLIERS[0] * c0,
        )
        k0 += _WEYL[0]
        k1 += _WEYL[1]
    return c0, c1, c2, c3


@no_type_check
@njit(cache=True)
def _keys(seed, split, cases):
    zero = np.uint64(0)
    out = np.empty(len(cases), np.uint64)
    for w in range(len(cases)):
        out[w] = philox(cases[w], split, zero, zero, seed, zero)[0]
    return out


@no_type_check
@njit(cache=True)
def _pair(a, b):
    """Two normal numbers from two random words (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - (a >> np.uint64(11)) * 2.0**-53))
    angle = 2.0 * math.pi * ((b >> np.uint64(11)) * 2.0**-53)
    return radius * math.cos(angle), radius * math.sin(angle)


@no_type_check
@njit(cache=True)
def _normal(key, purpose, step, out):
    worlds, pedestrians, n = out.shape
    for w in range(worlds):
        for p in range(pedestrians):
            for start in range(0, n, 4):
                a, b, c, d = philox(np.uint64(start), np.uint64(p), np.uint64(step[w]), np.uint64(0), key[w], purpose)
                quad = (*_pair(a, b), *_pair(c, d))
                for i in range(min(4, n - start)):
                    out[w, p, start + i] = quad[i]
