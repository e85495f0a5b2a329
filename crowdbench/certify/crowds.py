"""The crowds that a search meets: one that walks its ways whatever the vehicle does, or one that reacts to it."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.types import Outcome, World
from crowdbench.core.types.rules import PERFECT
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.simulator import crowd_decisions, finish_step, move, step


class CrowdStep(NamedTuple):
    """What crowds do in a step. Row 0 of the agents is the vehicle's, which only has its radius there.

    Attributes:
        before: Positions before the step in metres.
        end: Positions after it, before anybody comes or goes.
        velocity: Velocities before it in m/s.
        radius: In metres.
        present: Who is there.
    """

    before: Float[np.ndarray, "crowd agent 2"]
    end: Float[np.ndarray, "crowd agent 2"]
    velocity: Float[np.ndarray, "crowd agent 2"]
    radius: Float[np.ndarray, "crowd agent"]
    present: Bool[np.ndarray, "crowd agent"]

    @classmethod
    def of(cls, world: World, moved: World) -> CrowdStep:
        """The step between two states of worlds."""
        return cls(world.position, moved.position, world.velocity, world.radius, world.present)

    def row(self, w: int) -> CrowdStep:
        """The crowd of one world."""
        return CrowdStep(*(np.ascontiguousarray(each[w : w + 1]) for each in self))


class Crowd(abc.ABC):
    """The crowds around the states of a layer."""

    @abc.abstractmethod
    def ahead(self) -> CrowdStep:
        """What the crowds do in the next step."""

    @abc.abstractmethod
    def rows(self, states: int) -> Int[np.ndarray, "state"]:
        """Which of them each state is in."""

    @abc.abstractmethod
    def after(self, parent: Int[np.ndarray, "state"], command: Float[np.ndarray, "state 2"]) -> Crowd:
        """The crowds around the states of the next layer.

        Args:
            parent: The state that each of them comes from.
            command: The command by which.
        """


@dataclasses.dataclass(frozen=True)
class Known(Crowd):
    """A crowd whose ways are known.

    Attributes:
        steps: What it does in each step.
        step: How many are over.
    """

    steps: Sequence[CrowdStep]
    step: int = 0

    def ahead(self) -> CrowdStep:
        """See `Crowd`."""
        return self.steps[self.step]

    def rows(self, states: int) -> Int[np.ndarray, "state"]:
        """See `Crowd`: all are in the same crowd."""
        return np.zeros(states, np.int64)

    def after(self, parent: Int[np.ndarray, "state"], command: Float[np.ndarray, "state 2"]) -> Known:
        """See `Crowd`."""
        return Known(self.steps, self.step + 1)


class Reacting(Crowd):
    """Crowds that see the vehicle: a world for each state, which the simulator takes on.

    Args:
        scenario: The scenario.
        world: The worlds.
    """

    def __init__(self, scenario: Scenario, world: World) -> None:
        self.scenario = scenario
        self.velocities, self.world = crowd_decisions(world, scenario.policies)

    def ahead(self) -> CrowdStep:
        """See `Crowd`."""
        standing = np.zeros((len(self.world), 2))  # in a step, nobody minds what the vehicle does in it
        return CrowdStep.of(self.world, move(self.world, standing, self.velocities)[0])

    def rows(self, states: int) -> Int[np.ndarray, "state"]:
        """See `Crowd`."""
        return np.arange(states)

    def after(self, parent: Int[np.ndarray, "state"], command: Float[np.ndarray, "state 2"]) -> Reacting:
        """See `Crowd`."""
        world, _ = step(self.world.take(parent), command, self.velocities[parent], self.scenario.renewal)
        return Reacting(self.scenario, world)


def with_perfect_sight(scenario: Scenario) -> Scenario:
    """The scenario for a search: it need not simulate what the vehicle sees, which people do not mind."""
    return dataclasses.replace(scenario, rules=dataclasses.replace(scenario.rules, sensor=PERFECT))


def known_steps(scenario: Scenario, world: World) -> list[CrowdStep]:
    """What crowds do in all steps of an episode in which the vehicle stands and nothing stops it.

    Args:
        scenario: The scenario.
        world: Its worlds at their start.
    """
    steps, standing = [], np.zeros((len(world), 2))
    goes_on = np.full(len(world), Outcome.RUNNING.value)
    for _ in range(scenario.rules.max_steps):
        velocities, world = crowd_decisions(world, scenario.policies)
        moved, check = move(world, standing, velocities)
        steps.append(CrowdStep.of(world, moved))
        world = finish_step(moved, check._replace(outcome=goes_on), scenario.renewal)
    return steps
