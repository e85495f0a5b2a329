"""The search problem of one vehicle: its start, its motion, the obstacles, and the paths to its goal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from crowdbench import Rules, World
from crowdbench.core import RuleNumbers
from studies.best_times.cost_to_go import CostToGo, find_cost_to_go


class Vehicle(NamedTuple):
    """Motion of a vehicle, and the obstacles. For kernels.

    Attributes:
        rules: The rules.
        max_speed: Largest speed in m/s.
        tolerance: Distance in metres to the goal below which it has arrived.
        obstacles: Polygons in metres.
    """

    rules: RuleNumbers
    max_speed: float
    tolerance: float
    obstacles: Float[np.ndarray, "polygon corner 2"]


class Task(NamedTuple):
    """The search problem of one vehicle.

    Attributes:
        rules: The rules of the scenario.
        max_steps: Steps after which the episode times out.
        start: Position, velocity, heading and turn rate at the start.
        vehicle: Its motion, and the obstacles.
        cost: The lengths of the paths to its goal.
    """

    rules: Rules
    max_steps: int
    start: Float[np.ndarray, "6"]
    vehicle: Vehicle
    cost: CostToGo

    @classmethod
    def of(cls, world: World) -> Task:
        """Return the task in a single world at its start."""
        rules, position, radius = world.rules, world.position[0, 0], float(world.radius[0, 0])
        speed, tolerance = float(world.preferred_speed[0, 0]), float(rules.goal_tolerance or radius)
        vehicle = Vehicle(rules.numbers, speed, tolerance, np.ascontiguousarray(world.obstacles[0]))
        start = np.array([*position, *world.velocity[0, 0], world.heading[0], world.angular_speed[0]])
        cost = find_cost_to_go(position, world.goal[0, 0].copy(), radius, world.obstacles[0])
        return cls(rules, int(world.max_steps[0]), start, vehicle, cost)
