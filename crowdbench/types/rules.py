"""The rules of a scenario, and how an episode can end."""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.dynamics import DISC, DYNAMICS, FREE, Body, Dynamics
from crowdbench.errors import InputError
from crowdbench.types.sensor import PERFECT, Sensor

HISTORY = 8
"""Number of positions in the history of a pedestrian, including the current one."""

COLLISION_RULES = ("swept", "crowdnav", "crowdnav_plus")
"""The collision tests, see `crowdbench.sim.episode`."""

DISCOMFORT_GAP = 0.2
"""A gap to a pedestrian smaller than this, in metres, is discomfort (Chen et al. 2019)."""


class Outcome(enum.IntEnum):
    """How an episode ended, or that it is still running.

    `COLLISION` is a collision with a pedestrian, `WALL_COLLISION` one with an obstacle.
    """

    RUNNING = 0
    SUCCESS = 1
    COLLISION = 2
    TIMEOUT = 3
    WALL_COLLISION = 4

    @property
    def label(self) -> str:
        """Its name in files and tables, in lower case."""
        return self.name.lower()


@dataclass(frozen=True)
class Rules:
    """What is the same in all cases of a scenario.

    Attributes:
        dt: Length of a step in seconds.
        time_limit: The first step that starts at or after `time_limit` - 1 s ends in a time-out (as in CrowdNav).
        collision: `swept` (true relative motion over the step), `crowdnav` (every pedestrian is moved, for the
            collision test alone, with its velocity before the step), or `crowdnav_plus` (positions before the step,
            for collision and arrival).
        visible: Whether pedestrians see the vehicle.
        sees_vehicle: Of a visible vehicle, the share of the pedestrians who see it.
        dynamics: How the vehicle moves.
        goal_tolerance: Distance in metres to its goal below which the vehicle has arrived; None stands for its radius.
        body: The discs that the vehicle consists of.
        sensor: What the vehicle sees of pedestrians.

    Raises:
        InputError: `collision` is not one of `COLLISION_RULES`.
    """

    dt: float = 0.25
    time_limit: float = 25.0
    collision: str = "swept"
    visible: bool = False
    sees_vehicle: float = 1.0
    dynamics: Dynamics = FREE
    goal_tolerance: float | None = None
    body: Body = DISC
    sensor: Sensor = PERFECT

    def __post_init__(self) -> None:
        if self.collision not in COLLISION_RULES:
            raise InputError(f"collision is {self.collision!r}, but must be one of {', '.join(COLLISION_RULES)}")

    # Computed once, because they are read in every step.
    @cached_property
    def max_steps(self) -> int:
        """The number of steps of an episode that ends in a time-out."""
        return math.ceil((self.time_limit - 1.0) / self.dt - 1e-9) + 1

    @cached_property
    def collision_code(self) -> int:
        """The collision rule as kernels take it: its index in `COLLISION_RULES`."""
        return COLLISION_RULES.index(self.collision)

    @cached_property
    def discs(self) -> Float[np.ndarray, "disc"]:
        """The body as kernels take it."""
        return np.array(self.body)

    def to_table(self) -> dict[str, Any]:
        """The rules as JSON has them. Of the vehicle, it has what differs from a holonomic disc with perfect sight."""
        table = dataclasses.asdict(self)
        for field in ("sees_vehicle", "dynamics", "goal_tolerance", "body", "sensor"):
            if getattr(self, field) == getattr(Rules, field):
                del table[field]
        if "dynamics" in table:
            table["dynamics"]["name"] = self.dynamics.name
        return table

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> Rules:
        """The rules that `to_table` has written."""
        found = dict(table)
        if "dynamics" in found:
            limits = dict(found["dynamics"])
            found["dynamics"] = DYNAMICS[limits.pop("name")](**limits)
        if "body" in found:
            found["body"] = tuple(found["body"])
        if "sensor" in found:
            found["sensor"] = Sensor.of_table(found["sensor"])
        return cls(**found)
