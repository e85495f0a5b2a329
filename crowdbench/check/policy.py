"""Checks what a pedestrian policy keeps of its contract, in the worlds of real episodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.check.examination import EXACT, Examination, Tolerance, compare_answers
from crowdbench.check.inputs import MORE, drive_trial, with_more_absent
from crowdbench.check.result import CheckResult
from crowdbench.core.types import World
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.pedestrians.base import (
    Memory,
    PedestrianPolicy,
    PolicyWithMemory,
    init_memory,
    memory_arrays,
    query_unchecked,
    validate_finite,
    validate_memory,
    validate_shape,
)

Velocities = Float[np.ndarray, "world pedestrian 2"]


def check_policy(
    make: Callable[[], PedestrianPolicy],
    name: str,
    scenario: Scenario,
    cases: Cases,
    limit: float,
    tolerance: Tolerance = EXACT,
) -> list[CheckResult]:
    """Let a policy move the pedestrians of some cases and examine each part of its contract by itself.

    Args:
        make: Makes a new policy.
        name: The policy's name in the scenario.
        scenario: A scenario with pedestrians that follow the policy.
        cases: The cases.
        limit: Seconds that the policy may take for all worlds together.
        tolerance: What may depend on the batch.

    Raises:
        InputError: Something other than the policy breaks its contract.
    """
    examination = _PolicyExamination(make, name, tolerance)
    remembers = isinstance(examination.plugin, PolicyWithMemory)
    if remembers:
        examination.answers = "worlds' velocities and memories"
    policies = {**scenario.policies, name: _ExaminedPolicy(examination)}
    drive_trial(dataclasses.replace(scenario, policies=policies), cases)
    findings = examination.findings
    return [
        findings.result("exceptions", "none"),
        examination.time_result(limit),
        findings.result("type and shape", "float64 [world, pedestrian, 2]"),
        findings.result("finite", "all for those present"),
        *([findings.result("memory", "arrays [world, ...], the same in each step")] if remembers else []),
        findings.result("world", "unchanged"),
        examination.check_deterministic(),
        examination.check_batch(),
        examination.check_padding(),
    ]


class _PolicyExamination(Examination[PedestrianPolicy, World]):
    answers = "worlds' velocities"
    missing = "not examined: the policy returned no array of velocities"
    batch_names = "world", "world"

    def query(self, plugin: PedestrianPolicy, batch: World) -> tuple[object, object]:
        return query_unchecked(plugin, self.name, batch)

    def validators(self, batch: World) -> dict[str, Callable[[Any], Any]]:
        def remember(answer: tuple[Velocities, object]) -> tuple[Velocities, Memory]:
            if not isinstance(self.plugin, PolicyWithMemory):
                return answer[0], {}
            return answer[0], validate_memory(answer[1], batch.memory[self.name], self.name)

        return {
            "type and shape": lambda answer: (validate_shape(answer[0], self.name, batch), answer[1]),
            "finite": lambda answer: (validate_finite(answer[0], self.name, batch), answer[1]),
            "memory": remember,
        }

    def numbers(
        self, plugin: PedestrianPolicy, answer: tuple[Velocities, Memory], batch: World
    ) -> Float[np.ndarray, "world number"]:
        """Velocities, 0 for pedestrians who are not present, then the memory; at the start also what it was before."""
        velocity, memory = answer
        memories = [memory]
        if isinstance(plugin, PolicyWithMemory) and not batch.step.any():
            memories.append(init_memory(plugin, self.name, batch))
        arrays = [array for each in memories for _, array in memory_arrays(self.name, each)]
        rows = [np.reshape(array, (len(batch), -1)) for array in (_set_absent(velocity, batch), *arrays)]
        return np.concatenate(rows, axis=1, dtype=np.float64)

    def check_padding(self) -> CheckResult:
        """Whether the velocities are the same with more absent pedestrians, of whom there are memories too."""

        def ask_padded() -> list[Float[np.ndarray, "world number"]]:
            policy, found = self.make(), []
            before: World | None = None
            for world, _ in self.calls:
                wide = with_more_absent(world)
                if isinstance(policy, PolicyWithMemory):
                    wide = wide.replace(memory={**wide.memory, self.name: self._remember(policy, wide, before)})
                velocity, memory = self.answer(policy, wide)
                before = wide.replace(memory={**wide.memory, self.name: memory})
                found.append(_set_absent(velocity, wide)[:, :-MORE].reshape(len(world), -1))
            return found

        first = [answer[:, : 2 * (world.radius.shape[1] - 1)] for world, answer in self.calls]
        again = {f"with {MORE} more absent pedestrians": ask_padded}
        answers = _PolicyExamination.answers  # without the memories, which have other pedestrians in them
        return compare_answers("padding", answers, self.missing, first, again, self.tolerance)

    def _remember(self, policy: PolicyWithMemory, world: World, before: World | None) -> Memory:
        """What a policy remembers in worlds, some of those that it was shown before unless they start."""
        if before is None or not world.step.any():
            return init_memory(policy, self.name, world)
        memory: Memory = before.take(np.searchsorted(before.case, world.case)).memory[self.name]
        return memory


class _ExaminedPolicy(PolicyWithMemory):
    """Lets the pedestrians walk as an examined policy says, and stand where it gives no velocities."""

    def __init__(self, examination: _PolicyExamination) -> None:
        self.examination = examination

    def memory(self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]) -> Memory:
        policy, name = self.examination.plugin, self.examination.name
        if not isinstance(policy, PolicyWithMemory):
            return {}
        steps = {"memory": lambda _: init_memory(policy, name, world)}
        return self.examination.findings.examine(len(world), steps) or {}

    def velocities(  # type: ignore[override]  # as in its base class
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]], memory: Memory
    ) -> tuple[Velocities, Memory]:
        answer = self.examination.ask(world)
        if answer is None:
            return np.zeros((len(world), world.position.shape[1] - 1, 2)), memory
        velocity, after = answer
        return velocity, after or memory


def _set_absent(velocity: Velocities, world: World) -> Velocities:
    """The velocities in m/s, 0 for pedestrians that are not present, whose velocities do not matter."""
    return np.where(world.present[:, 1:, None], velocity, 0.0)
