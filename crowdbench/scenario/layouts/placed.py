"""The agents that a layout has placed so far, and room for the next one."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.scenario.placement import Placement

CLEARANCE = 0.2
"""Smallest distance in metres between the rims of two agents at the start."""

TRIES = 10_000
"""Number of draws for one pedestrian after which the layout counts as full."""


class Placed:
    """The agents placed so far, and whether a position is clear for the next one.

    Args:
        radius: Radii in metres of all agents, the vehicle first.
    """

    def __init__(self, radius: Float[np.ndarray, "agent"]) -> None:
        self.radius: list[float] = radius.tolist()
        self.start: list[tuple[float, float]] = []
        self.goal: list[tuple[float, float]] = []

    def add(self, start: tuple[float, float], goal: tuple[float, float]) -> None:
        """Place the next agent, by its start and its goal in metres."""
        self.start.append(start)
        self.goal.append(goal)

    def start_is_clear(self, x: float, y: float) -> bool:
        """Whether a position in metres is far enough from all starts."""
        return self._clear(x, y, self.start)

    def start_is_clear_of_goals(self, x: float, y: float) -> bool:
        """Whether a position in metres is far enough from all goals."""
        return self._clear(x, y, self.goal)

    goal_is_clear = start_is_clear_of_goals

    def _clear(self, x: float, y: float, points: list[tuple[float, float]]) -> bool:
        own = self.radius[len(self.start)] + CLEARANCE
        return all(
            math.hypot(x - px, y - py) >= own + other for (px, py), other in zip(points, self.radius, strict=False)
        )

    def full(self, area: str, key: str) -> InputError:
        """The error that there is no room for the next agent.

        Args:
            area: Where there is none.
            key: The key of the scenario that would make more.

        Returns:
            The error.
        """
        return InputError(
            f"pedestrian {len(self.start)} of {len(self.radius) - 1} finds no room on {area} after {TRIES} "
            f"draws: lower pedestrians.number or raise {key}"
        )

    def placement(self, obstacles: Float[np.ndarray, "polygon corner 2"] | None = None) -> Placement:
        """The placement of all agents, among obstacles in metres."""
        return Placement(start=np.array(self.start), goal=np.array(self.goal), obstacles=obstacles)
