"""What a pedestrian policy may return: type, shape and finite numbers. The simulator checks every answer here."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.compiled import njit
from crowdbench.errors import InputError, plugin_errors
from crowdbench.sim.pedestrians import Memory, PedestrianPolicy, PolicyWithMemory
from crowdbench.types import World


def asked(policy: PedestrianPolicy, name: str, world: World) -> tuple[object, object]:
    """Ask a policy for velocities.

    Args:
        policy: The policy.
        name: What it is called in errors.
        world: What it is shown.

    Returns:
        What it answers as velocities, and as its memory after that, None without one. Neither is checked yet.

    Raises:
        InputError: It raises, or it has a memory and does not answer with two things.
    """
    with plugin_errors(f"pedestrian policy {name} raised"):
        if not isinstance(policy, PolicyWithMemory):
            return policy.velocities(world, world.parameters[name]), None
        answer = policy.velocities(world, world.parameters[name], world.memory[name])
    if not isinstance(answer, tuple) or len(answer) != 2 or answer[1] is None:
        raise InputError(
            f"pedestrian policy {name} has a memory and returned a {type(answer).__name__}, but must return a tuple "
            "of two, its velocities and its memory"
        )
    return answer


def started(policy: PolicyWithMemory, name: str, world: World) -> Memory:
    """What a policy remembers at the start.

    Args:
        policy: The policy.
        name: What it is called in errors.
        world: What it is shown.

    Returns:
        Its memory.

    Raises:
        InputError: It raises, or returns anything but arrays with a row per world.
    """
    with plugin_errors(f"pedestrian policy {name} raised"):
        answer = policy.memory(world, world.parameters[name])
    for path, array in parts(name, answer):
        if array.shape[:1] != (len(world),):
            raise InputError(
                f"pedestrian policy {name} returned {path} of shape {array.shape} for {len(world)} worlds, but the "
                "first axis must be the worlds"
            )
    return answer


def kept(answer: object, before: Memory, name: str) -> Memory:
    """Check what a policy remembers after a step.

    Args:
        answer: What it returned.
        before: What it was given.
        name: What the policy is called in errors.

    Returns:
        Its memory.

    Raises:
        InputError: There are other arrays in it than before, or arrays of another shape or type.
    """
    found = {path: (array.shape, array.dtype) for path, array in parts(name, answer)}
    expected = {path: (array.shape, array.dtype) for path, array in parts(name, before)}
    for path in found | expected:
        if found.get(path) != expected.get(path):
            here, there = (
                "nothing" if path not in each else f"{each[path][1]} of shape {each[path][0]}"
                for each in (found, expected)
            )
            raise InputError(f"pedestrian policy {name} returned {here} as {path}, which was {there} before")
    return answer  # type: ignore[return-value]  # `parts` has found a mapping


def parts(name: str, memory: object, path: str = "memory") -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of a memory, each with the path to it.

    Args:
        name: What the policy is called in errors.
        memory: What a policy returned as its memory, or a part of it.
        path: What that is called.

    Raises:
        InputError: It holds something else than arrays and mappings.
    """
    if isinstance(memory, np.ndarray):
        yield path, memory
    elif isinstance(memory, Mapping):
        for key, part in memory.items():
            yield from parts(name, part, f"{path}[{key!r}]")
    else:
        raise InputError(
            f"pedestrian policy {name} returned a {type(memory).__name__} as {path}, but a memory holds arrays by name"
        )


def shaped(answer: object, name: str, world: World) -> Float[np.ndarray, "world pedestrian 2"]:
    """Check type and shape of what a policy returned.

    Args:
        answer: What `velocities` returned.
        name: What the policy is called in errors.
        world: What it was given.

    Returns:
        The velocities in m/s.

    Raises:
        InputError: It is no float64 array with a velocity per pedestrian.
    """
    expected = (len(world), world.position.shape[1] - 1, 2)
    if isinstance(answer, np.ndarray) and answer.shape == expected and answer.dtype == np.float64:
        return np.asarray(answer)  # a subclass may answer otherwise than its numbers
    found = f"{answer.dtype} of shape {answer.shape}" if isinstance(answer, np.ndarray) else repr(answer)
    raise InputError(f"pedestrian policy {name} returned {found}, but must return float64 of shape {expected}")


def finite(
    velocity: Float[np.ndarray, "world pedestrian 2"], name: str, world: World
) -> Float[np.ndarray, "world pedestrian 2"]:
    """Check that velocities are finite.

    Args:
        velocity: What a policy returned, in m/s.
        name: What the policy is called in errors.
        world: What it was given.

    Returns:
        The velocities.

    Raises:
        InputError: That of a pedestrian who is present is not finite.
    """
    # A sum is finite only if all its terms are.
    if not math.isfinite(_sum(np.ascontiguousarray(velocity))) and len(
        wrong := np.argwhere(~np.isfinite(velocity).all(axis=2) & world.present[:, 1:])
    ):
        row, pedestrian = wrong[0]
        raise InputError(
            f"pedestrian policy {name} returned {velocity[row, pedestrian].tolist()} for pedestrian {pedestrian} "
            f"of case {world.case[row]}, but a velocity must be finite"
        )
    return velocity


@no_type_check
@njit
def _sum(array):
    """The sum of all numbers. Compiled, because NumPy would take as long as a kernel for one world."""
    total = 0.0
    for number in array.flat:
        total += number
    return total
