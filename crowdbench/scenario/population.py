"""The crowd: the number of pedestrians, their random traits, and their behaviour on arrival."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field, model_validator

from crowdbench.core.types import Intention, World
from crowdbench.scenario.clear_space import ClearSpace
from crowdbench.utils.errors import is_number
from crowdbench.utils.toml import TomlTable, number

ARRIVALS = ("walk_on", "stop", "leave", "new_goal", "respawn", "back_and_forth")
"""Behaviour of a pedestrian that has reached its goal:

- `walk_on`: keep walking to it, as in CrowdNav,
- `stop`: stand still from then on,
- `leave`: disappear,
- `new_goal`: walk to another goal,
- `respawn`: be replaced by a new pedestrian at another position, as in CrowdNav++,
- `back_and_forth`: walk back to its origin, and so on.
"""

RECORDED = "recorded"
"""The name of the policy of pedestrians that walk as they were recorded."""

CONTINUING_ARRIVALS = ("new_goal", "respawn", "back_and_forth")
"""Behaviours after which a pedestrian walks to another goal."""


class Distribution(TomlTable):
    """Distribution of a quantity over pedestrians; a number in a scenario's file means a constant.

    Attributes:
        mean: The constant, or the mean of a normal distribution before it is truncated, or the middle of a uniform one.
        std: Standard deviation of a truncated normal distribution; 0 for a constant, None for a uniform distribution.
        low: Smallest value; a normal distribution repeats draws below it.
        high: Largest value. The bounds must not be so narrow that hardly any draw is within them.
    """

    mean: float
    std: float | None = Field(ge=0, lt=1e6)
    low: float = Field(ge=0)
    high: float = Field(lt=1e6)

    @model_validator(mode="before")
    @classmethod
    def _write_out(cls, value: Any) -> Any:
        if is_number(value):
            return {"mean": value, "std": 0.0, "low": value, "high": value}
        if isinstance(value, dict) and value.keys() == {"low", "high"} and all(map(is_number, value.values())):
            return {"mean": (value["low"] + value["high"]) / 2.0, "std": None, **value}
        return value

    @model_validator(mode="after")
    def _check_bounds(self) -> Distribution:
        std = self.std or 0.0
        if not self.low <= self.mean <= self.high or (std > 0.0 and self.high - self.low < 0.1 * std):
            raise ValueError
        return self

    def draw(self, generator: np.random.Generator, n: int) -> Float[np.ndarray, "{n}"]:
        """Draw a value for each of n pedestrians."""
        if self.std is None:
            return generator.uniform(self.low, self.high, n)
        values = np.full(n, self.mean)
        if self.std > 0.0:
            outside = np.ones(n, bool)
            while outside.any():
                values[outside] = generator.normal(self.mean, self.std, outside.sum())
                outside = (values < self.low) | (values > self.high)
        return values


class WholeDistribution(Distribution):
    """A distribution of whole numbers, to which values are rounded; a constant must be a whole number."""

    @model_validator(mode="after")
    def _check_constant(self) -> WholeDistribution:
        if self.std == 0.0 and self.mean != round(self.mean):
            raise ValueError
        return self

    def draw(self, generator: np.random.Generator, n: int) -> Float[np.ndarray, "{n}"]:
        """Draw a whole number for each of n pedestrians."""
        return np.rint(super().draw(generator, n))


class Traits(NamedTuple):
    """Traits of some pedestrians.

    Attributes:
        radius: In metres.
        preferred_speed: In m/s.
        policy: Index of the policy that moves each pedestrian.
        parameters: By policy and name, the parameters of the policies.
    """

    radius: Float[np.ndarray, "pedestrian"]
    preferred_speed: Float[np.ndarray, "pedestrian"]
    policy: Int[np.ndarray, "pedestrian"]
    parameters: Mapping[str, Mapping[str, Float[np.ndarray, "pedestrian"]]]

    def with_traits_of(self, first: Int[np.ndarray, "pedestrian"]) -> Traits:
        """Return the same pedestrians, each with the speed and the policy of the first one in its group."""
        return self._replace(preferred_speed=self.preferred_speed[first], policy=self.policy[first])


class GoalChange(TomlTable):
    """`[pedestrians] goal_change`: how pedestrians change their goals on the way.

    Attributes:
        period: Time in seconds between goal changes, a multiple of dt.
        chance: Probability with which each pedestrian takes another goal after each period.
    """

    period: float = number(above=0.0, below=1e6)
    chance: float = Field(ge=0, le=1, description="a probability from 0 to 1")

    def is_due(self, world: World) -> Bool[np.ndarray, "world"]:
        """Return the worlds in which goals may change after this step."""
        return np.asarray(world.step % round(self.period / world.rules.dt) == 0)


class WalkingLimitsSpec(TomlTable):
    """`[pedestrians] limits`: how fast pedestrians can change their velocity, see `WalkingLimits`.

    Attributes:
        acceleration: In m/s^2; gaits start with 0.14 g on average (Fugger et al. 2000).
        braking: In m/s^2; a rapid stop from 1.29 m/s takes 0.463 s (Tirosh and Sparrow 2004).
        sideways: In m/s^2. The critical angular velocity falls with speed to the power -0.8 (Wang et al. 2025), so that
            this limit would grow with speed to the power 0.2, which is neglected.
    """

    acceleration: float = number(above=0.0, below=1e3)
    braking: float = number(above=0.0, below=1e3)
    sideways: float = number(above=0.0, below=1e3)


class PopulationSpec(TomlTable):
    """`[pedestrians.population]`: how people differ from each other, and from themselves over time.

    Attributes:
        noise: See `Intention`.
        noise_time: See `Intention`.
        inertia: See `Intention`.
        shrinkage: Share of the difference to the typical speed by which preferred speeds are drawn towards it.
        typical_speed: In m/s.
        spread: Standard deviations of the logarithms of random factors, by quantity: `radius`, `preferred_speed`,
            `inertia`, or a parameter of a policy.
    """

    noise: float = number(0.0, least=0.0, below=10.0)
    noise_time: float = number(1.0, above=0.0, below=1e6)
    inertia: float = number(0.0, least=0.0, below=1e6)
    shrinkage: float = Field(default=0.0, ge=0, le=1, description="a share from 0 to 1")
    typical_speed: float = number(1.2, above=0.0, below=100.0)
    spread: dict[str, Annotated[float, Field(ge=0, le=1)]] = Field(
        default={}, description="a table such as { radius = 0.2, time_horizon = 0.3 } of numbers from 0 to 1"
    )

    @property
    def intention(self) -> Intention:
        """The intention of its pedestrians."""
        return Intention(self.noise, self.noise_time, self.inertia, self.spread.get("inertia", 0.0))

    @property
    def changes_traits(self) -> bool:
        """True if it changes pedestrians as they are drawn."""
        return self.shrinkage > 0.0 or bool(self.spread)

    def largest(self, quantity: str, value: float) -> float:
        """Return a bound on a quantity whose largest value is given, without shrinkage."""
        return value * math.exp(LARGEST_DEVIATION * self.spread.get(quantity, 0.0))

    def shrink(self, speed: np.ndarray | float) -> np.ndarray | float:
        """Return preferred speeds in m/s, drawn towards the typical speed."""
        return speed + self.shrinkage * (self.typical_speed - speed)

    def factors(self, stream: np.random.Generator, n: int) -> dict[str, Float[np.ndarray, "{n}"]]:
        """Draw a factor for each of n pedestrians, by quantity."""
        return {name: np.exp(sigma * _DEVIATION.draw(stream, n)) for name, sigma in sorted(self.spread.items())}


LARGEST_DEVIATION = 2.0
"""Normal numbers whose absolute value is larger are drawn again, so that nobody is many times larger than others."""

_DEVIATION = Distribution.model_construct(mean=0.0, std=1.0, low=-LARGEST_DEVIATION, high=LARGEST_DEVIATION)


@dataclass(frozen=True)
class Population:
    """The pedestrians of a scenario.

    Attributes:
        number: The smallest and the largest number of them.
        radius: Radii in metres.
        preferred_speed: Preferred and largest speeds in m/s; for recorded pedestrians the largest of all.
        shares: By policy, the share of the pedestrians that follow it, in any unit.
        standing: The policies whose pedestrians stand, by name.
        parameters: By policy and name, the parameters of the policies.
        groups: Shares of the groups by size; empty without groups.
        arrival: Behaviour of pedestrians on arrival, one of `ARRIVALS`.
        goal_change: Changes of goals during an episode; None without changes.
        clear_space: The space around the vehicle in which no pedestrian starts or respawns; None without one.
        variation: By policy, how its pedestrians vary; policies without variation are left out.
    """

    number: tuple[int, int]
    radius: Distribution
    preferred_speed: Distribution
    shares: Mapping[str, float]
    standing: Collection[str]
    parameters: Mapping[str, Mapping[str, Distribution]]
    groups: Mapping[int, float] = dataclasses.field(default_factory=dict)
    arrival: str = "walk_on"
    goal_change: GoalChange | None = None
    clear_space: ClearSpace | None = None
    variation: Mapping[str, PopulationSpec] = dataclasses.field(default_factory=dict)

    @property
    def stands(self) -> Bool[np.ndarray, "policy"]:
        """True for policies whose pedestrians stand. The policy of recorded cars is included, but never drawn."""
        return np.array([name in self.standing for name in self.parameters])

    def walking(self) -> Population:
        """Return the crowd without standing pedestrians, from which replacements for arrived pedestrians are drawn."""
        shares = {name: 0.0 if name in self.standing else share for name, share in self.shares.items()}
        if not any(shares.values()):  # then no pedestrian arrives
            return self
        return dataclasses.replace(self, shares=shares)

    @property
    def largest_radius(self) -> float:
        """A bound on the radii in metres."""
        radius = self.radius.high
        return max([radius, *(spec.largest("radius", radius) for spec in self.variation.values())])

    @property
    def largest_preferred_speed(self) -> float:
        """A bound on the preferred speeds in m/s."""
        speed = self.preferred_speed.high
        varied = (spec.largest("preferred_speed", float(spec.shrink(speed))) for spec in self.variation.values())
        return max([speed, *varied])

    def draw(
        self, stream: np.random.Generator, n: int | None = None, speed: Float[np.ndarray, "pedestrian"] | None = None
    ) -> Traits:
        """Draw pedestrians.

        Args:
            stream: The random stream to draw from.
            n: The number of pedestrians; it is drawn first if None.
            speed: Their preferred speeds in m/s before the variation; they are drawn if None.
        """
        if n is None:
            n = int(stream.integers(self.number[0], self.number[1] + 1))
        radius, drawn_speed = self.radius.draw(stream, n), self.preferred_speed.draw(stream, n)
        total = sum(self.shares.values())
        policy = stream.choice(len(self.shares), n, p=[share / total for share in self.shares.values()])
        parameters = {
            name: {parameter: quantity.draw(stream, n) for parameter, quantity in table.items()}
            for name, table in self.parameters.items()
        }
        traits = Traits(radius, drawn_speed if speed is None else speed, policy, parameters)
        # Last, so that all other draws are the same without variation.
        for name, spec in self.variation.items():
            traits = _vary(traits, name, policy == list(self.parameters).index(name), spec, stream)
        return traits


def _vary(
    traits: Traits,
    policy: str,
    follows: Bool[np.ndarray, "pedestrian"],
    spec: PopulationSpec,
    stream: np.random.Generator,
) -> Traits:
    """Return pedestrians of which those that follow a policy are varied, with the parameters of this policy."""
    factors = spec.factors(stream, len(traits.radius))
    radius, speed = traits.radius * factors.get("radius", 1.0), spec.shrink(traits.preferred_speed)
    speed = speed * factors.get("preferred_speed", 1.0)
    table = {name: values * factors.get(name, 1.0) for name, values in traits.parameters[policy].items()}
    return traits._replace(
        radius=np.where(follows, radius, traits.radius),
        preferred_speed=np.where(follows, speed, traits.preferred_speed),
        parameters={**traits.parameters, policy: table},
    )
