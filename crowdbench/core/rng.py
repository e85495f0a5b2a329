"""Random numbers keyed by seed, split, case and purpose, so that a case is the same in any batch and order.

All of them come from Philox 4x64-10 (Salmon et al. 2011), a counter-based generator: a function of a key and a counter.
`generator` uses NumPy's implementation. Noise for whole batches is drawn by a compiled implementation in this module,
because the construction of a NumPy generator per case is slow.
"""

from __future__ import annotations

import functools
import hashlib
import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int, UInt

from crowdbench.utils.compiled import njit
from crowdbench.utils.errors import InputError

LEADING, LEADING_BITS = 3, 21
"""Axes of noise before the last two, and bits of an index along one of them: all fit in 64 bits of a counter."""

MOST_NORMAL = math.sqrt(2.0 * 53.0 * math.log(2.0))
"""Largest normal number that compiled code can draw: its radius is computed from a number of 53 bits."""

SPLITS = ("train", "val", "test")
"""The splits of a scenario's cases. Each has the cases 0, 1, 2, ... without an upper limit."""


def case_keys(seed: int, split: str, cases: Int[np.ndarray, "world"]) -> UInt[np.ndarray, "world"]:
    """Return the key of every case, which determines all its random numbers.

    Args:
        seed: The seed of the scenario.
        split: One of `SPLITS`.
        cases: The case numbers.

    Returns:
        64-bit keys.
    """
    keys = np.empty(len(cases), np.uint64)
    _fill_keys(np.uint64(seed), np.uint64(SPLITS.index(split)), cases.astype(np.uint64), keys)
    return keys


def vehicle_keys(keys: UInt[np.ndarray, "case"], vehicles: int) -> UInt[np.ndarray, "world"]:
    """Return the keys of the vehicles of each case: the key of the case for the first one, others for the others."""
    others = np.repeat(keys, vehicles).reshape(-1, vehicles)
    for vehicle in range(1, vehicles):
        _fill_keys(np.uint64(vehicle), np.uint64(2**63), keys, others[:, vehicle])
    return others.ravel()


def generator(key: np.uint64, purpose: str, step: int = 0, person: int = 0) -> np.random.Generator:
    """Return a NumPy generator.

    Args:
        key: The key of a case.
        purpose: Name of the drawn quantity. Other purposes of the same case have independent random numbers.
        step: The step for which it is drawn.
        person: Number of the person.

    Returns:
        The generator in its initial state.
    """
    # A generator increments the first half of the counter.
    counter = np.array([0, 0, person, step], np.uint64)
    return np.random.Generator(np.random.Philox(key=np.array([key, purpose_bits(purpose)], np.uint64), counter=counter))


def noise_keys(keys: UInt[np.ndarray, "world"]) -> UInt[np.ndarray, "world"]:
    """Return the keys of the planners' noise.

    They are cryptographic hashes (BLAKE2) of the keys of the cases, and so do not reveal these keys: the key of a
    case determines the whole case.

    Args:
        keys: The keys of the cases.

    Returns:
        64-bit keys.
    """
    hashed = [hashlib.blake2b(key.tobytes(), digest_size=8, person=b"noise").digest() for key in keys]
    return np.frombuffer(b"".join(hashed), np.uint64).copy()


def continuation_keys(keys: UInt[np.ndarray, "world"], step: int, number: int) -> UInt[np.ndarray, "world"]:
    """Return the keys of cases that continue from a step with other random numbers.

    Args:
        keys: The keys of the cases.
        step: The step.
        number: Index of the continuation.

    Returns:
        64-bit keys.
    """
    others = np.empty(len(keys), np.uint64)
    _fill_keys(np.uint64(number), np.uint64(len(SPLITS) + step), keys, others)
    return others


def normal(
    key: UInt[np.ndarray, "world"], purpose: str, step: Int[np.ndarray, "world"], shape: tuple[int, ...]
) -> Float[np.ndarray, "world *shape"]:
    """Return standard normal numbers. Each depends only on key, purpose, step and its indices, not on the shape.

    Args:
        key: The key of every world.
        purpose: Name of the drawn quantity. Other purposes with the same key have independent random numbers.
        step: The step of every world.
        shape: Shape of the numbers of one world, with at most five axes. `(n,)` gives the first row of `(m, n)`.

    Returns:
        The numbers.

    Raises:
        InputError: The shape has more than five axes, or an axis that is negative or too long.
    """
    if len(shape) > 2 + LEADING or min(shape, default=0) < 0 or max(shape[:-2], default=0) > 2**LEADING_BITS:
        raise InputError(
            f"noise of shape {list(shape)} cannot be drawn: it must have at most {2 + LEADING} axes, "
            f"the first {LEADING} of them no longer than 2^{LEADING_BITS}"
        )
    *leading, rows, n = (1, 1, *shape)[-max(len(shape), 2) :]
    indices = np.indices(leading, np.uint64).reshape(len(leading), math.prod(leading))
    blocks = np.zeros(indices.shape[1], np.uint64)
    for index in indices:
        blocks = (blocks << np.uint64(LEADING_BITS)) | index
    out = np.empty((len(key), len(blocks), rows, n))
    _normal(key, purpose_bits(purpose), step, blocks, out)
    return out.reshape(len(key), *shape)


def draw_uniforms(
    key: UInt[np.ndarray, "world"], purpose: str, step: Int[np.ndarray, "world"], person: Int[np.ndarray, "world n"]
) -> Float[np.ndarray, "world n"]:
    """Return numbers from 0 to below 1. Each depends only on key, purpose, step and person.

    Args:
        key: The key of every world.
        purpose: Name of the drawn quantity. Other purposes with the same key have independent random numbers.
        step: The step of every world.
        person: Numbers of the persons.
    """
    out = np.empty(person.shape)
    _uniforms(key, purpose_bits(purpose), step, person, out)
    return out


@functools.cache
def purpose_bits(name: str) -> np.uint64:
    """Return the 64 bits that represent a purpose: the second half of the generator's key."""
    return np.uint64(int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little"))


_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)

# The multipliers of Philox 4x64, and the constants added to its key in each round.
_MULTIPLIERS = (np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157))
_WEYL = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B))


@no_type_check
@njit
def _high_product(a, b):
    """Return the upper 64 bits of a * b."""
    a0, a1, b0, b1 = a & _LOW, a >> _HALF, b & _LOW, b >> _HALF
    middle = a1 * b0 + ((a0 * b0) >> _HALF)
    return a1 * b1 + (middle >> _HALF) + ((a0 * b1 + (middle & _LOW)) >> _HALF)


@no_type_check
@njit
def philox(c0, c1, c2, c3, k0, k1):
    """Return random bits from ten rounds of mixing: Philox 4x64-10 (Salmon et al. 2011).

    Args:
        c0 (uint64): The counter's first 64 bits.
        c1 (uint64): Its second 64 bits.
        c2 (uint64): Its third 64 bits.
        c3 (uint64): Its fourth 64 bits.
        k0 (uint64): The key's first 64 bits.
        k1 (uint64): Its second 64 bits.

    Returns:
        random (tuple): Four random numbers, uint64.
    """
    for _ in range(10):
        first, second = _high_product(_MULTIPLIERS[0], c0), _high_product(_MULTIPLIERS[1], c2)
        c0, c1, c2, c3 = second ^ c1 ^ k0, _MULTIPLIERS[1] * c2, first ^ c3 ^ k1, _MULTIPLIERS[0] * c0
        k0, k1 = k0 + _WEYL[0], k1 + _WEYL[1]
    return c0, c1, c2, c3


@no_type_check
@njit
def _fill_keys(seed, split, cases, out):
    """Fill `out [world]` with the random numbers for key `seed` and counters (case, split)."""
    zero = np.uint64(0)
    for w in range(len(cases)):
        out[w] = philox(cases[w], split, zero, zero, seed, zero)[0]


@no_type_check
@njit
def _pair(a, b):
    """Return two normal numbers from two random uint64 (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - (a >> np.uint64(11)) * 2.0**-53))
    angle = 2.0 * math.pi * ((b >> np.uint64(11)) * 2.0**-53)
    return radius * math.cos(angle), radius * math.sin(angle)


@no_type_check
@njit
def four_normal(index, row, step, block, key, purpose):
    """Return four of the numbers that `normal` draws. Compiled.

    Args:
        index (int): Index of the first of them along the last axis, a multiple of 4.
        row (int): Index along the axis before it.
        step (int): The step.
        block (uint64): The indices along the axes before that.
        key (uint64): The key of the world.
        purpose (uint64): The `purpose_bits` of the purpose.

    Returns:
        numbers (tuple): Four standard normal numbers.
    """
    four = philox(np.uint64(index), np.uint64(row), np.uint64(step), block, key, purpose)
    return (*_pair(four[0], four[1]), *_pair(four[2], four[3]))


@no_type_check
@njit
def uniform(row, step, key, purpose):
    """Return a number that is uniform in [0, 1). Compiled.

    Args:
        row (int): Index of the number within a step.
        step (int): The step.
        key (uint64): The key of the world.
        purpose (uint64): The `purpose_bits` of a purpose that is used only for such numbers.

    Returns:
        number (float): The number.
    """
    zero = np.uint64(0)
    return (philox(zero, np.uint64(row), np.uint64(step), zero, key, purpose)[0] >> np.uint64(11)) * 2.0**-53


@no_type_check
@njit
def _uniforms(key, purpose, step, person, out):
    """Fill `out [world, n]`."""
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[w, i] = uniform(person[w, i], step[w], key[w], purpose)


@no_type_check
@njit
def _normal(key, purpose, step, blocks, out):
    """Fill `out [world, block, row, n]`: key (key, purpose), counter (index, row, step, block), four at a time."""
    worlds, _, rows, n = out.shape
    for w in range(worlds):
        for b in range(len(blocks)):
            for r in range(rows):
                for start in range(0, n, 4):
                    quad = four_normal(start, r, step[w], blocks[b], key[w], purpose)
                    for i in range(min(4, n - start)):
                        out[w, b, r, start + i] = quad[i]
