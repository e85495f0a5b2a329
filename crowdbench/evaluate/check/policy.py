"""Checks what a pedestrian policy keeps of its contract, in the worlds of real episodes."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from crowdbench.errors import plugin_errors
from crowdbench.evaluate.check.again import EXACT, Replay, Tolerance
from crowdbench.evaluate.check.padding import MORE, with_more_absent
from crowdbench.evaluate.check.point import Findings, Point, changed, time_point
from crowdbench.evaluate.check.trial import trial
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.checked import finite, shaped
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.types import World

Velocities = Float[np.ndarray, "world pedestrian 2"]

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

    def asking(policy: PedestrianPolicy) -> Callable[[World], Velocities]:
        return lambda world: _present(finite(shaped(_asked(policy, name, world), name, world), name, world), world)

    again = Replay("worlds' velocities", witness.shown, World.take, lambda: asking(make()), tolerance, MISSING)
    return [
        findings.point("exceptions", "none"),
        time_point("time", witness.seconds, limit, MISSING),
        findings.point("type and shape", "float64 [world, pedestrian, 2]"),
        findings.point("finite", "all for those present"),
        findings.point("world", "unchanged"),
        again.deterministic(asking(witness.policy)),
        again.batch(),
        again.changed(
            "padding",
            f"with {MORE} more absent pedestrians",
            with_more_absent,
            lambda velocity: velocity[:, :-MORE],
        ),
    ]


class _Witness(PedestrianPolicy):
    """Keeps what a policy is shown and answers, and lets pedestrians stand where it gives no velocities.

    Attributes:
        policy: The policy.
        findings: What was found at each point.
        seconds: How long each call took.
        shown: The worlds of each call, with the velocities in m/s; 0 for pedestrians that are not present.

    Args:
        policy: The policy.
        name: Its name.
    """

    def __init__(self, policy: PedestrianPolicy, name: str) -> None:
        self.policy = policy
        self.name = name
        self.findings = Findings("worlds", MISSING)
        self.seconds: list[float] = []
        self.shown: list[tuple[World, Velocities]] = []

    def velocities(self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]) -> Velocities:
        before = world.take(np.arange(len(world)))
        velocity = self.findings.examine(
            len(world),
            {
                "exceptions": lambda _: self._timed(world),
                "type and shape": lambda answer: shaped(answer, self.name, before),
                "finite": lambda shape: finite(shape, self.name, before),
            },
        )
        found = changed("world", before, world)
        self.findings.note("world", len(world), found and f"changes {found[0]} (case {before.case[found[1]]})")
        if velocity is None:
            return np.zeros((len(world), world.position.shape[1] - 1, 2))
        self.shown.append((before, _present(velocity, before)))
        return velocity

    def _timed(self, world: World) -> object:
        start = time.perf_counter()
        answer = _asked(self.policy, self.name, world)
        self.seconds.append(time.perf_counter() - start)
        return answer


def _asked(policy: PedestrianPolicy, name: str, world: World) -> object:
    with plugin_errors(f"pedestrian policy {name} raised"):
        return policy.velocities(world, world.parameters[name])


def _present(velocity: Velocities, world: World) -> Velocities:
    """The velocities in m/s, 0 for pedestrians that are not present, whose velocities do not matter."""
    return np.where(world.present[:, 1:, None], velocity, 0.0)
