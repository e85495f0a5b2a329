"""Crowds of a search: one with known trajectories, which do not depend on the vehicle, or one that reacts to it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import Outcome, Scenario, World
from crowdbench.sim import crowd_decisions, finish_step, move, step


class CrowdStep(NamedTuple):
    """Motion of crowds in a step. Row 0 of the agents is the vehicle, of which only the radius is set.

    Attributes:
        before: Positions before the step in metres.
        end: Positions after it, before pedestrians spawn or leave.
        velocity: Velocities before it in m/s.
        radius: Radii in metres.
        present: True for agents that exist.
    """

    before: Float[np.ndarray, "crowd agent 2"]
    end: Float[np.ndarray, "crowd agent 2"]
    velocity: Float[np.ndarray, "crowd agent 2"]
    radius: Float[np.ndarray, "crowd agent"]
    present: Bool[np.ndarray, "crowd agent"]

    @classmethod
    def of(cls, world: World, moved: World) -> CrowdStep:
        """Return the step between two states of worlds."""
        return cls(world.position, moved.position, world.velocity, world.radius, world.present)

    def row(self, w: int) -> CrowdStep:
        """Return the crowd of one world."""
        return CrowdStep(*(np.ascontiguousarray(each[w : w + 1]) for each in self))


@dataclasses.dataclass(frozen=True)
class Known:
    """A crowd with known trajectories, which are the same for all states of a layer.

    Attributes:
        steps: Its motion in each of the remaining steps.
    """

    steps: Sequence[CrowdStep]

    def ahead(self) -> CrowdStep:
        """Return its motion in the next step."""
        return self.steps[0]

    def after(self, parent: Int[np.ndarray, "state"], command: Float[np.ndarray, "state 2"]) -> Known:
        """Return the crowd of the states of the next layer, which follow from the states `parent` by these commands."""
        return Known(self.steps[1:])


class Reacting:
    """Crowds that react to the vehicle: a world for each state, which the simulator advances.

    Args:
        scenario: The scenario.
        world: The worlds.
    """

    def __init__(self, scenario: Scenario, world: World) -> None:
        self.scenario = scenario
        self.velocities, self.world = crowd_decisions(world, scenario.policies)

    def ahead(self) -> CrowdStep:
        """Return the motion of the crowds in the next step: one for each state."""
        standing = np.zeros((len(self.world), 2))  # the motion of a crowd in a step does not depend on the command
        return CrowdStep.of(self.world, move(self.world, standing, self.velocities)[0])

    def after(self, parent: Int[np.ndarray, "state"], command: Float[np.ndarray, "state 2"]) -> Reacting:
        """Return the crowd after a step, see `Known.after`."""
        world, _ = step(self.world.take(parent), command, self.velocities[parent], self.scenario.post_step_rule)
        return Reacting(self.scenario, world)


Crowd = Known | Reacting


def known_steps(scenario: Scenario, world: World) -> list[CrowdStep]:
    """Return the motion of crowds in all steps of an episode in which the vehicle stands and no outcome ends it.

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
        world = finish_step(moved, check._replace(outcome=goes_on), scenario.post_step_rule)
    return steps
