"""Crowds of a search: a world for each state, which the simulator advances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import Scenario, World
from crowdbench.sim import crowd_decisions, move, step


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


class Crowds:
    """The crowds of all states, each in a world of its own.

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
        world, moved = self.world, move(self.world, standing, self.velocities)[0]
        return CrowdStep(world.position, moved.position, world.velocity, world.radius, world.present)

    def after(self, parent: Int[np.ndarray, "state"], command: Float[np.ndarray, "state 2"]) -> Crowds:
        """Return the crowds of the states of the next layer, which follow from states `parent` by these commands."""
        world, _ = step(self.world.take(parent), command, self.velocities[parent], self.scenario.post_step_rule)
        return Crowds(self.scenario, world)
