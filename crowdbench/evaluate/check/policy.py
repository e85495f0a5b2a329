"""Checks what a pedestrian policy keeps of its contract, in the worlds of real episodes."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.check.again import EXACT, Replay, Tolerance, same_point
from crowdbench.evaluate.check.padding import MORE, with_more_absent
from crowdbench.evaluate.check.point import Findings, Point, changed, time_point
from crowdbench.evaluate.check.trial import trial
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.checked import asked, finite, kept, parts, shaped, started
from crowdbench.sim.pedestrians import Memory, PedestrianPolicy, PolicyWithMemory
from crowdbench.types import World

Velocities = Float[np.ndarray, "world pedestrian 2"]
Answers = Float[np.ndarray, "_ _"]
"""All numbers of an answer, those of each world in a row: velocities, then the memory."""

MISSING = "not examined: the policy returned no array of velocities"


def check_policy(
    make: Callable[[], PedestrianPolicy],
    name: str,
    scenario: Scenario,
    cases: Cases,
    limit: float,
    tolerance: Tolerance = EXACT,
) -> list[Point]:
    """Let a policy move the pedestrians of some cases and examine each point of its contract by itself.

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
    witness = _Witness(make(), name)
    trial(dataclasses.replace(scenario, policies={**scenario.policies, name: witness}), cases)
    findings = witness.findings
    remembers = isinstance(witness.policy, PolicyWithMemory)

    def asking(policy: PedestrianPolicy) -> Callable[[World], Answers]:
        return lambda world: _examined(policy, name, world)

    again = Replay(
        "worlds' velocities and memories" if remembers else "worlds' velocities",
        witness.shown,
        World.take,
        lambda: asking(make()),
        tolerance,
        MISSING,
    )
    return [
        findings.point("exceptions", "none"),
        time_point("time", witness.seconds, limit, MISSING),
        findings.point("type and shape", "float64 [world, pedestrian, 2]"),
        findings.point("finite", "all for those present"),
        *([findings.point("memory", "arrays [world, ...], the same in each step")] if remembers else []),
        findings.point("world", "unchanged"),
        again.deterministic(asking(witness.policy)),
        again.batch(),
        _padding(make, name, witness.shown, tolerance),
    ]


def _padding(
    make: Callable[[], PedestrianPolicy], name: str, shown: Sequence[tuple[World, Answers]], tolerance: Tolerance
) -> Point:
    """Whether the velocities are the same with more absent pedestrians, of whom there are memories too."""
    if not shown:
        return Point("padding", None, MISSING)

    def padded() -> list[Float[np.ndarray, "_ _ 2"]]:
        policy, found = make(), []
        before: World | None = None
        for world, _ in shown:
            wide = with_more_absent(world)
            if isinstance(policy, PolicyWithMemory):
                wide = wide.replace(memory={**wide.memory, name: _followed(policy, name, wide, before)})
            velocity, memory = _asked(policy, name, wide)
            before = wide.replace(memory={**wide.memory, name: memory})
            found.append(_present(velocity, wide)[:, :-MORE])
        return found

    first = [_velocities(answer, world) for world, answer in shown]
    again = {f"with {MORE} more absent pedestrians": padded}
    return same_point("padding", "worlds' velocities", first, again, tolerance)


def _followed(policy: PolicyWithMemory, name: str, world: World, before: World | None) -> Memory:
    """What a policy remembers when it is shown worlds, some of those that it was shown before unless they start."""
    if before is None or not world.step.any():
        return started(policy, name, world)
    rows = np.searchsorted(before.case, world.case)
    memory: Memory = before.take(rows).memory[name]
    return memory


class _Witness(PolicyWithMemory):
    """Keeps what a policy is shown and answers, and lets pedestrians stand where it gives no velocities.

    Attributes:
        policy: The policy.
        findings: What was found at each point.
        seconds: How long each call took.
        shown: The worlds of each call, with what the policy answered.

    Args:
        policy: The policy.
        name: Its name.
    """

    def __init__(self, policy: PedestrianPolicy, name: str) -> None:
        self.policy = policy
        self.name = name
        self.findings = Findings("worlds", MISSING)
        self.seconds: list[float] = []
        self.shown: list[tuple[World, Answers]] = []

    def memory(self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]) -> Memory:
        policy = self.policy
        if not isinstance(policy, PolicyWithMemory):
            return {}
        return self.findings.examine(len(world), {"memory": lambda _: started(policy, self.name, world)}) or {}

    def velocities(  # type: ignore[override]  # as in its base class
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]], memory: Memory
    ) -> tuple[Velocities, Memory]:
        before = world.take(np.arange(len(world)))
        points: dict[str, Callable[[Any], Any]] = {
            "exceptions": lambda _: self._timed(world),
            "type and shape": lambda answer: (shaped(answer[0], self.name, before), answer[1]),
            "finite": lambda answer: (finite(answer[0], self.name, before), answer[1]),
        }
        if isinstance(self.policy, PolicyWithMemory):
            points["memory"] = lambda answer: (answer[0], kept(answer[1], before.memory[self.name], self.name))
        answer = self.findings.examine(len(world), points)
        found = changed("world", before, world)
        self.findings.note("world", len(world), found and f"changes {found[0]} (case {before.case[found[1]]})")
        if answer is None:
            return np.zeros((len(world), world.position.shape[1] - 1, 2)), memory
        velocity, after = answer[0], answer[1] or {}
        self.shown.append((before, _answers(velocity, after, before, self.policy, self.name)))
        return velocity, after or memory

    def _timed(self, world: World) -> tuple[object, object]:
        start = time.perf_counter()
        answer = asked(self.policy, self.name, world)
        self.seconds.append(time.perf_counter() - start)
        return answer


def _examined(policy: PedestrianPolicy, name: str, world: World) -> Answers:
    """All that a policy answers. Raises InputError where it breaks a point."""
    velocity, memory = _asked(policy, name, world)
    return _answers(velocity, memory, world, policy, name)


def _asked(policy: PedestrianPolicy, name: str, world: World) -> tuple[Velocities, Memory]:
    """What a policy answers, checked."""
    velocity, memory = asked(policy, name, world)
    checked = finite(shaped(velocity, name, world), name, world)
    return checked, kept(memory, world.memory[name], name) if isinstance(policy, PolicyWithMemory) else {}


def _answers(velocity: Velocities, memory: Memory, world: World, policy: PedestrianPolicy, name: str) -> Answers:
    """All numbers of an answer, those of each world in a row; at the start also what is remembered there."""
    memories = [memory]
    if isinstance(policy, PolicyWithMemory) and not world.step.any():
        memories.append(started(policy, name, world))
    arrays = [array for each in memories for _, array in parts(name, each)]
    rows = [np.reshape(array, (len(world), -1)) for array in (_present(velocity, world), *arrays)]
    return np.concatenate(rows, axis=1, dtype=np.float64)


def _velocities(answers: Answers, world: World) -> Velocities:
    """The velocities in m/s of an answer."""
    shape = len(world), world.position.shape[1] - 1, 2
    return answers[:, : shape[1] * shape[2]].reshape(shape)


def _present(velocity: Velocities, world: World) -> Velocities:
    """The velocities in m/s, 0 for pedestrians that are not present, whose velocities do not matter."""
    return np.where(world.present[:, 1:, None], velocity, 0.0)
