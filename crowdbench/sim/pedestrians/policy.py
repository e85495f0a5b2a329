"""The interface of pedestrian policies, and checks of their return values: type, shape and finite numbers."""

from __future__ import annotations

import abc
import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import World
from crowdbench.utils.compiled import njit
from crowdbench.utils.errors import InputError, plugin_errors
from crowdbench.utils.resources import plugin_in_time

Parameters = Mapping[str, Float[np.ndarray, "world agent"]]
"""For each parameter of a policy a value per agent; column 0, the vehicle's, is not used."""

Velocities = Float[np.ndarray, "world pedestrian 2"]
"""A velocity in m/s for every pedestrian."""

Memory = Mapping[str, Any]
"""Memory of a policy: arrays `[world, ...]` by name, in mappings that may be nested."""


class PedestrianPolicy(abc.ABC):
    """Base class of pedestrian policies. A subclass lists its parameters in `parameters` and implements `velocities`.

    A policy has no state and no side effects. Its return value depends only on the world: otherwise a case would depend
    on other cases of the batch (`crowdbench check` detects that). It takes noise from
    `crowdbench.core.rng.normal(world.key, purpose, world.step, ...)`. In its input, a vehicle that pedestrians cannot
    see is not `present`. A policy that needs a memory is a `PolicyWithMemory`.
    """

    parameters: ClassVar[Mapping[str, float]] = {}
    """The parameters that a scenario can set, with their defaults."""

    population: ClassVar[Mapping[str, Any]] = {}
    """The population of the policy, with the keys of `[pedestrians.population]`: `{"noise": 0.15, "inertia": 2.5}`. A
    scenario can change it in the table `population` of the policy."""

    attention: ClassVar[Mapping[str, Any]] = {}
    """The attention of a crowd with the policy, with keys of `[pedestrians.attention]`: `{"clearance": 0.9}`. Keys in a
    scenario replace it."""

    stands: ClassVar[bool] = False
    """True if its pedestrians always stand. A scenario places them at some point between start and goal."""

    @abc.abstractmethod
    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """Return the velocities that the pedestrians take next.

        Args:
            world: The worlds as they are now.
            parameters: For each parameter a value per agent; column 0, the vehicle's, is not used.

        Returns:
            A velocity in m/s for every pedestrian. Velocities of pedestrians that another policy moves, or that are
            absent, are ignored.
        """


class PolicyWithMemory(PedestrianPolicy):
    """Pedestrian policy with a memory, which is stored in the world: the policy has no state.

    If a pedestrian's number in `world.person` differs from the step before, it is another person without a memory. A
    policy with such pedestrians stores their numbers in its memory to detect this.
    """

    @abc.abstractmethod
    def memory(self, world: World, parameters: Parameters) -> Memory:
        """Return the memory at the start of the episodes.

        Args:
            world: The worlds at their start.
            parameters: As for `velocities`.

        Returns:
            Arrays `[world, ...]`, whose other axes do not depend on how many worlds there are.
        """

    @abc.abstractmethod
    def velocities(  # type: ignore[override]  # it is given and returns a memory too
        self, world: World, parameters: Parameters, memory: Memory
    ) -> tuple[Velocities, Memory]:
        """Return the velocities that the pedestrians take next, and the memory after this step.

        Args:
            world: The worlds as they are now.
            parameters: For each parameter a value per agent; column 0, the vehicle's, is not used.
            memory: The memory that the step before returned. It must not be changed: return other arrays.

        Returns:
            A velocity in m/s for every pedestrian, as for any policy, and a memory with the same names, shapes and
            types.
        """


def query_policy(policy: PedestrianPolicy, name: str, world: World) -> tuple[Velocities, Memory | None]:
    """Query a policy for velocities, and check its return value.

    Args:
        name: Its name in errors.

    Returns:
        Velocities in m/s, and the new memory of the policy, None without one.

    Raises:
        InputError: The policy raises an exception, or its return value is invalid.
    """
    memory = (world.memory[name],) if isinstance(policy, PolicyWithMemory) else ()
    with plugin_errors(f"pedestrian policy {name} raised", f" ({moment_of(world)})"):
        answer: Any = policy.velocities(world, world.parameters[name], *memory)
    velocity, after = answer, None
    if memory:
        if not isinstance(answer, tuple) or len(answer) != 2 or answer[1] is None:
            raise InputError(
                f"pedestrian policy {name} returned {type(answer).__name__}, not a tuple of velocities and memory"
            )
        velocity, after = answer[0], validate_memory(answer[1], memory[0], name)
    return validate_finite(validate_shape(velocity, name, world), name, world), after


def moment_of(world: World) -> str:
    """Return the case, if there is one, and the step, for errors."""
    cases = f"case {world.case[0]}" if len(world) == 1 else f"one of {len(world)} cases"
    return f"{cases}, step {world.step[0]}"


def init_memory(policy: PolicyWithMemory, name: str, world: World) -> Memory:
    """Return the memory of a policy at the start.

    Args:
        name: Its name in errors.

    Raises:
        InputError: The policy raises an exception, or does not return arrays with a row per world.
    """
    with plugin_in_time(f"pedestrian policy {name} raised"):
        answer = policy.memory(world, world.parameters[name])
    for path, array in memory_arrays(name, answer):
        if array.shape[:1] != (len(world),):
            raise InputError(
                f"pedestrian policy {name} returned {path} of shape {array.shape} for {len(world)} worlds, but the "
                "first axis must be the worlds"
            )
    return answer


def validate_memory(answer: object, before: Memory, name: str) -> Memory:
    """Check the memory of a policy after a step.

    Args:
        answer: Its return value.
        name: Name of the policy in errors.

    Raises:
        InputError: The arrays of the memory differ from those before in name, shape or type.
    """
    returned = {path: (array.dtype, array.shape) for path, array in memory_arrays(name, answer)}
    expected = {path: (array.dtype, array.shape) for path, array in memory_arrays(name, before)}
    for path in returned | expected:
        if returned.get(path) != expected.get(path):
            now, then = (
                "{} of shape {}".format(*arrays[path]) if path in arrays else "nothing"
                for arrays in (returned, expected)
            )
            raise InputError(f"pedestrian policy {name} returned {now} as {path}, which was {then} before")
    return answer  # type: ignore[return-value]  # `memory_arrays` has found a mapping


def memory_arrays(name: str, memory: object, path: str = "memory") -> Iterator[tuple[str, np.ndarray]]:
    """Yield the arrays of a memory, each with the path to it.

    Args:
        name: Name of the policy in errors.
        memory: The returned memory of a policy, or a part of it.

    Raises:
        InputError: The memory contains objects other than arrays and mappings.
    """
    if isinstance(memory, np.ndarray):
        yield path, memory
    elif isinstance(memory, Mapping):
        for key, part in memory.items():
            yield from memory_arrays(name, part, f"{path}[{key!r}]")
    else:
        raise InputError(f"pedestrian policy {name} returned a {type(memory).__name__} as {path}, not an array")


def validate_shape(answer: object, name: str, world: World) -> Velocities:
    """Check the type and shape of a policy's return value.

    Args:
        answer: The return value of `velocities`.
        name: Name of the policy in errors.

    Returns:
        The velocities in m/s.

    Raises:
        InputError: The return value is not a float64 array with a velocity per pedestrian.
    """
    expected = (len(world), world.position.shape[1] - 1, 2)
    if isinstance(answer, np.ndarray) and answer.shape == expected and answer.dtype == np.float64:
        return np.asarray(answer)  # a subclass may override methods of ndarray
    returned = f"{answer.dtype} of shape {answer.shape}" if isinstance(answer, np.ndarray) else repr(answer)
    raise InputError(f"pedestrian policy {name} returned {returned}, but must return float64 of shape {expected}")


def validate_finite(velocity: Velocities, name: str, world: World) -> Velocities:
    """Check that velocities are finite.

    Args:
        velocity: The return value of a policy, in m/s.
        name: Name of the policy in errors.

    Raises:
        InputError: The velocity of a present pedestrian is not finite.
    """
    # A sum is finite only if all its terms are.
    if math.isfinite(_sum(np.ascontiguousarray(velocity))):
        return velocity
    for row, pedestrian in np.argwhere(~np.isfinite(velocity).all(axis=2) & world.present[:, 1:]):
        raise InputError(
            f"pedestrian policy {name} returned {velocity[row, pedestrian].tolist()} for pedestrian {pedestrian} "
            f"of case {world.case[row]}, but a velocity must be finite"
        )
    return velocity


@no_type_check
@njit
def _sum(array):
    """Return the sum of all numbers. Compiled, because NumPy would take as long as a kernel for one world."""
    total = 0.0
    for number in array.flat:
        total += number
    return total
