"""The vehicle's sensor: whom it sees, how exactly, and how late."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what is measured of a person, the same in x and y.

    Attributes:
        position: In metres.
        velocity: In m/s.
    """

    position: float = 0.0
    velocity: float = 0.0


@dataclass(frozen=True)
class Lidar:
    """A ring of beams around the vehicle's position.

    Attributes:
        beams: Their number. The first one points along the heading, the others follow counter-clockwise.
        range: Length of a beam in metres.
    """

    beams: int
    range: float


@dataclass(frozen=True)
class Sensor:
    """What the vehicle sees of pedestrians. The default sees everybody exactly and at once.

    Attributes:
        range: Largest distance in metres between the rims of the vehicle and of a person that is seen, that is between
            their centres, less both radii (as in CrowdNav++, Liu et al. 2023); None for any distance.
        field_of_view: Angle in degrees, half of it on each side of the heading, in which a person's centre is seen.
        occlusion: Whether walls and other people hide persons.
        noise: Normal noise of each measurement.
        missed: Probability that a person who could be seen is not detected in a step.
        delay: Number of steps after which a measurement arrives.
        remember: Seconds for which a person of whom no more measurements arrive stays in the observation, where it
            goes on at constant velocity.
        lidar: The lidar, if there is one. It is exact and has no delay.
        nearest: How many pedestrians planners are shown at most, the nearest ones; None for all.
    """

    range: float | None = None
    field_of_view: float = 360.0
    occlusion: bool = False
    noise: Noise = Noise()
    missed: float = 0.0
    delay: int = 0
    remember: float = 0.0
    lidar: Lidar | None = None
    nearest: int | None = None

    @cached_property
    def sees_all(self) -> bool:
        """Whether it sees everybody exactly and at once, even if it shows the nearest only."""
        return Sensor(remember=self.remember, lidar=self.lidar, nearest=self.nearest) == self

    def steps_remembered(self, dt: float) -> int:
        """For how many steps of `dt` seconds a person is remembered."""
        return int(self.remember / dt + 1e-9)

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> Sensor:
        """The sensor of a table with its attributes, as `dataclasses.asdict` and scenario files have them."""
        lidar = table.get("lidar")
        made = {**table, "noise": Noise(**table.get("noise", {})), "lidar": None if lidar is None else Lidar(**lidar)}
        return cls(**made)


PERFECT = Sensor()
"""Sees everybody exactly and at once, and has no lidar."""
