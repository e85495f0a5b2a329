"""The rules of a scenario, the outcomes of episodes, and the vehicle's sensor: range, noise and delay."""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import Field, field_validator, model_validator

from crowdbench.core.dynamics import DIRECT, DISC, DYNAMICS, FREE, Actuation, Body, Dynamics
from crowdbench.core.types.attention import Attention
from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import Flag, TomlTable, integer, number, table

MAX_PEDESTRIANS = 10_000
"""Largest number of pedestrians of a scenario."""


class Noise(TomlTable):
    """`[sensor.noise]`: standard deviations of measurements of a pedestrian, the same in x and y.

    Attributes:
        position: In metres.
        velocity: In m/s.
    """

    position: float = number(0.0, least=0.0, below=1e3)
    velocity: float = number(0.0, least=0.0, below=1e3)


class Lidar(TomlTable):
    """`[sensor.lidar]`: a ring of beams around the vehicle's position.

    Attributes:
        beams: Number of beams. The first one points along the heading, the others follow counter-clockwise.
        range: Length of a beam in metres.
        legs: True if a person is a pair of legs that walk, see `crowdbench.sim.lidar`; otherwise a disc.
        noise: Standard deviation in metres of the normal noise of each distance below the range.
        dropout: Probability that a beam that meets something returns the range.
        false_returns: Probability that a beam returns a distance that is uniform between 0 and the measured one.

    The last four are None for False or 0, so that they change the digest of no scenario without them.
    """

    beams: int = integer(least=1, most=10_000)
    range: float = number(above=0.0, below=1e6)
    legs: bool | None = Field(default=None, description="true or false")
    noise: float | None = number(None, least=0.0, below=1e3)
    dropout: float | None = number(None, least=0.0, below=1.0)
    false_returns: float | None = number(None, least=0.0, below=1.0)

    @field_validator("legs", "noise", "dropout", "false_returns")
    @classmethod
    def _without_default(cls, value: float | None) -> float | None:
        return value or None


class Detector(TomlTable):
    """`[sensor.detector]`: a detector of people, and the tracker of its detections.

    The page on scenarios names the sources of the defaults. The range, the field of view, occlusion and the delay are
    keys of the sensor.

    Attributes:
        position: Standard deviation of each coordinate of a detection in metres.
        velocity: The same of a measured velocity in m/s; None for a detector that measures no velocities.
        missed: Probability that a visible pedestrian is not detected in a step.
        false_detections: Mean number of false detections in a step.
        radius: Radius in metres of every detection and track, because detectors do not measure radii.
        remember: Seconds for which a track without detections continues at constant velocity.
        spare: Number of columns of the observation in addition to the largest number of pedestrians.
        raw: True if planners observe the detections, without the tracker.
    """

    position: float = number(0.17, least=0.0, below=1e3)
    velocity: float | None = number(None, least=0.0, below=1e3)
    missed: float = number(0.15, least=0.0, below=1.0)
    false_detections: float = number(1.0, least=0.0, below=100.0)
    radius: float = number(0.3, above=0.0, below=1e3)
    remember: float = number(1.0, least=0.0, below=1e6)
    spare: int = integer(5, least=0, most=1000)
    raw: Flag = False


SENSING_TRACKS: Mapping[str, Mapping[str, Any]] = {
    "perfect": {},
    "realistic": {"range": 8.0, "occlusion": True, "detector": {}},
}
"""Tracks of sensing, in which every scenario can be driven: values of keys of `[sensor]` that are left out there."""


class Sensor(TomlTable):
    """`[sensor]`: sensor of the vehicle for pedestrians. By default it sees all of them exactly and without delay.

    Attributes:
        track: A name in `SENSING_TRACKS`, whose values replace the defaults below. A sensor that is read has these
            values, and no track.
        range: Largest distance in metres between the rims of the vehicle and of a pedestrian that is seen: the
            distance of their centres minus both radii (as in CrowdNav++, Liu et al. 2023); None for any distance.
        field_of_view: Angle in degrees, half of it on each side of the heading, in which a pedestrian's centre is seen.
        occlusion: True if walls and other pedestrians occlude pedestrians.
        noise: Normal noise of each measurement.
        missed: Probability that a visible pedestrian is not detected in a step.
        delay: Seconds after which a measurement arrives, a multiple of the length of a step.
        remember: Seconds for which a pedestrian without further measurements stays in the observation,
            extrapolated at constant velocity.
        nearest: Largest number of observed pedestrians, the nearest ones; None for all. The default in scenarios with
            large crowds is `crowdbench.scenario.schema.SHOWN`.
        lidar: The lidar, if there is one. It is exact and has no delay.
        detector: The detector of people and its tracker. Without one, each measurement belongs to a known pedestrian.
    """

    track: str | None = Field(
        default=None, exclude=True, pattern=f"^({'|'.join(SENSING_TRACKS)})$", description='"perfect" or "realistic"'
    )
    range: float | None = number(None, least=0.0, below=1e6)
    field_of_view: float = Field(default=360.0, gt=0, le=360, description="a number of degrees above 0 and up to 360")
    occlusion: Flag = False
    noise: Noise = table("sensor.noise")
    missed: float = number(0.0, least=0.0, below=1.0)
    delay: float = number(0.0, least=0.0, below=1e3)
    remember: float = number(0.0, least=0.0, below=1e6)
    nearest: int | None = integer(None, least=1, most=MAX_PEDESTRIANS)
    lidar: Lidar | None = Field(default=None, description="a table [sensor.lidar] with beams and range")
    # Absent from the dump without a detector, so that it does not change the identity of other scenarios.
    detector: Detector | None = Field(
        default=None, exclude_if=lambda value: value is None, description="a table [sensor.detector]"
    )

    @model_validator(mode="before")
    @classmethod
    def _replace_track(cls, values: Any) -> Any:
        """Replace a track by its values, beneath the values that are given."""
        track = values.get("track") if isinstance(values, dict) else None
        if not isinstance(track, str) or track not in SENSING_TRACKS:
            return values
        return {**SENSING_TRACKS[track], **values, "track": None}

    @model_validator(mode="after")
    def _check_errors(self) -> Sensor:
        """Raise InputError if there is a detector beside errors of measurements without one."""
        if self.detector is not None and (self.noise != Noise() or self.missed or self.remember):
            raise InputError(
                "sensor.noise, missed and remember do not go with a detector: set position, velocity, missed and "
                "remember of [sensor.detector]"
            )
        return self

    @cached_property
    def sees_all(self) -> bool:
        """True if it sees all pedestrians exactly and without delay, even if only the nearest ones are observed."""
        return Sensor(remember=self.remember, lidar=self.lidar, nearest=self.nearest) == self

    def columns(self, pedestrians: int) -> int:
        """Return the number of columns of an observation in a world of so many pedestrians."""
        columns = pedestrians + (0 if self.detector is None else self.detector.spare)
        return columns if self.nearest is None else min(self.nearest, columns)

    def steps_delayed(self, dt: float) -> int:
        """Return the delay in steps of `dt` seconds."""
        return round(self.delay / dt)

    def steps_remembered(self, dt: float) -> int:
        """Return the number of steps of `dt` seconds for which a pedestrian is remembered."""
        remember = self.remember if self.detector is None else self.detector.remember
        return int(remember / dt + 1e-9)


PERFECT_SENSOR = Sensor()
"""Sensor that sees all pedestrians exactly and without delay, without a lidar."""


class WalkingLimits(NamedTuple):
    """Limits on changes of the velocity of pedestrians; see `crowdbench.core.dynamics.kernels.limit_change`.

    Attributes:
        acceleration: Largest acceleration forwards, and in any direction from standing, in m/s^2.
        braking: Largest deceleration in m/s^2.
        sideways: Largest acceleration across the direction of walking in m/s^2.
        exempt: Index of the policy whose pedestrians have no limits, because they move as recorded.
    """

    acceleration: float
    braking: float
    sideways: float
    exempt: int = -1


class Intention(NamedTuple):
    """How the pedestrians of a policy change the velocity that they intend; see `crowdbench.sim.intention`.

    Attributes:
        noise: Standard deviation of each component of the noise of the desired velocity, as a share of its length.
        noise_time: Correlation time of this noise in seconds.
        inertia: Relaxation time of the intended velocity in seconds; 0 if it is the desired velocity at once.
        inertia_spread: Standard deviation of the logarithm of a person's factor on `inertia`.
    """

    noise: float = 0.0
    noise_time: float = 1.0
    inertia: float = 0.0
    inertia_spread: float = 0.0


HISTORY = 8
"""Number of positions in the history of a pedestrian, including the current one."""

MAX_VEHICLES = 16
"""Largest number of vehicles in a world."""

COLLISION_RULES = ("swept", "crowdnav", "crowdnav_plus")
"""The collision tests, see `crowdbench.sim.episode`."""

DISCOMFORT_GAP = 0.2
"""A gap to a pedestrian smaller than this, in metres, is discomfort (Chen et al. 2019)."""


class Outcome(enum.IntEnum):
    """Outcome of an episode, or the fact that it is still running.

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


class RuleNumbers(NamedTuple):
    """The rules of a step, as an argument of kernels.

    Attributes:
        code: The code of the vehicle's dynamics.
        limits: Its `Dynamics.limits`.
        body: Offsets of the centres of its discs ahead of its position, in metres.
        goal_tolerance: In metres; 0 means the vehicle's radius.
        collision: Index of the collision rule in `COLLISION_RULES`.
        collision_ends: True if a collision with a pedestrian ends the episode.
        dt: Length of a step in seconds.
        walking: The limits of pedestrians; infinite without any.
    """

    code: int
    limits: Float[np.ndarray, "4"]
    body: Float[np.ndarray, "disc"]
    goal_tolerance: float
    collision: int
    collision_ends: bool
    dt: float
    walking: WalkingLimits


@dataclass(frozen=True)
class Rules:
    """Constants of all cases of a scenario.

    Attributes:
        dt: Length of a step in seconds.
        time_limit: The first step that starts at or after `time_limit` - 1 s ends in a time-out (as in CrowdNav).
        time_limit_factor: Limit of each case as a multiple of its `least_time`, if that is earlier: the first step
            that starts at or after this limit ends in a time-out. None for the same limit in all cases.
        collision: `swept` (true relative motion over the step), `crowdnav` (every pedestrian is moved, only for
            the collision test, with its velocity before the step), or `crowdnav_plus` (positions before the step,
            for collision and arrival).
        collision_ends: True if a collision with a pedestrian ends the episode.
        visible: True if pedestrians see the vehicle.
        attention: Model of the attention to a visible vehicle; None if all pedestrians notice it at any time.
        dynamics: Dynamics of the vehicle.
        actuation: Delay and lag with which it executes commands.
        goal_tolerance: Distance in metres to its goal below which the vehicle has arrived; None means its radius.
        body: The discs that the vehicle consists of.
        sensor: Limits of the vehicle's sight.
        walking: The limits of pedestrians; None if only their speed is limited.
        intentions: The intention of the pedestrians of each policy; empty if all have their desired velocity.
        vehicles: Number of vehicles in a world, see `crowdbench.sim.fleet`.
    """

    dt: float = 0.25
    time_limit: float = 25.0
    time_limit_factor: float | None = None
    collision: str = "swept"
    collision_ends: bool = True
    visible: bool = False
    attention: Attention | None = None
    dynamics: Dynamics = FREE
    actuation: Actuation = DIRECT
    goal_tolerance: float | None = None
    body: Body = DISC
    sensor: Sensor = PERFECT_SENSOR
    walking: WalkingLimits | None = None
    intentions: tuple[Intention, ...] = ()
    vehicles: int = 1

    # Computed once, because they are read in every step.
    @cached_property
    def max_steps(self) -> int:
        """The largest number of steps of an episode, see `World.max_steps`."""
        return math.ceil((self.time_limit - 1.0) / self.dt - 1e-9) + 1

    @cached_property
    def numbers(self) -> RuleNumbers:
        """The rules as an argument of kernels."""
        vehicle = self.dynamics.code, self.dynamics.limits, np.array(self.body), self.goal_tolerance or 0.0
        walking = self.walking or WalkingLimits(math.inf, math.inf, math.inf)
        test = COLLISION_RULES.index(self.collision), self.collision_ends
        return RuleNumbers(*vehicle, *test, self.dt, walking)

    @cached_property
    def with_perfect_sensor(self) -> Rules:
        """The same rules with a sensor that sees all pedestrians exactly, without a lidar."""
        return dataclasses.replace(self, sensor=PERFECT_SENSOR)

    @cached_property
    def of_pedestrian(self) -> Rules:
        """The same rules for a pedestrian as the vehicle: a disc that moves in any direction and sees all exactly."""
        return dataclasses.replace(self, dynamics=FREE, actuation=DIRECT, body=DISC, sensor=PERFECT_SENSOR)

    def to_table(self) -> dict[str, Any]:
        """Return the rules as a table for JSON, without fields of vehicle and pedestrians that have their default."""
        entries = dataclasses.asdict(self)
        for field in (
            "time_limit_factor",
            "collision_ends",
            "attention",
            "dynamics",
            "actuation",
            "goal_tolerance",
            "body",
            "sensor",
            "walking",
            "intentions",
            "vehicles",
        ):
            if getattr(self, field) == getattr(Rules, field):
                del entries[field]
        if "dynamics" in entries:
            entries["dynamics"]["name"] = self.dynamics.name
        for field in {"attention", "sensor"} & entries.keys():
            entries[field] = entries[field].complete()
        return entries

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> Rules:
        """Return the rules from a table that `to_table` has returned."""
        return cls(**{name: _READ[name](value) if name in _READ else value for name, value in table.items()})


def _read_dynamics(table: Mapping[str, Any]) -> Dynamics:
    return DYNAMICS[table["name"]](**{name: limit for name, limit in table.items() if name != "name"})


_READ: Mapping[str, Callable[[Any], Any]] = {
    "dynamics": _read_dynamics,
    "actuation": Actuation._make,
    "attention": Attention.model_validate,
    "body": tuple,
    "sensor": Sensor.model_validate,
    "walking": WalkingLimits._make,
    "intentions": lambda rows: tuple(map(Intention._make, rows)),
}
"""Constructors of the fields of `Rules` from entries of a table."""
