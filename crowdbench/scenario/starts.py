"""How cases start: who is there, where all start and go, and what becomes of them on the way."""

from __future__ import annotations

import abc
import contextlib
import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core import rng
from crowdbench.core.dynamics import reach
from crowdbench.core.types import Rules, World
from crowdbench.scenario.groups import draw_groups, group_numbers, place_groups
from crowdbench.scenario.placement import LayoutCall, Placement, complete_placement
from crowdbench.scenario.population import Crowd, Traits
from crowdbench.scenario.renewal import Renewal
from crowdbench.scenario.respawn import find_respawn
from crowdbench.sim import simulator
from crowdbench.utils.errors import InputError, plugin_errors

CROWDNAV_TEST_SEED = 1000
"""CrowdNav draws test case c with NumPy's legacy generator, seeded with this number plus c."""


class Vehicle(NamedTuple):
    """The vehicle's radius in metres, and its preferred and largest speed in m/s."""

    radius: float
    speed: float


class Case(NamedTuple):
    """A case that is drawn.

    Attributes:
        source: What the scenario's file is called, for errors.
        split: `train`, `val` or `test`.
        number: The number by which it is drawn.
        key: Start of its random streams.
    """

    source: str
    split: str
    number: int
    key: np.uint64

    @contextlib.contextmanager
    def name_errors(self) -> Iterator[None]:
        """Say of an InputError raised within in which case that was."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.source}: in case {self.split}:{self.number}, {error}") from None


class Start(NamedTuple):
    """The start of a case.

    Attributes:
        traits: The pedestrians.
        placement: Where all start and go.
        group: The number of each one's group, -1 for who is alone.
        drawn: How many numbers of its stream were drawn, where all of a case is drawn from one; -1 elsewhere.
    """

    traits: Traits
    placement: Placement
    group: Int[np.ndarray, "pedestrian"]
    drawn: int = -1


class Starts(abc.ABC):
    """How the cases of a scenario start."""

    @property
    def layout(self) -> LayoutCall | None:
        """The layout; None where there is none."""
        return None

    @abc.abstractmethod
    def start(self, case: Case, crowd: Crowd, vehicle: Vehicle, rules: Rules) -> Start:
        """Draw the start of a case. Raises InputError where that cannot be."""

    @abc.abstractmethod
    def renewal(self, crowd: Crowd) -> simulator.Renewal | None:
        """What becomes of people after a step; None where they only walk."""

    def complete(self, world: World, cases: Sequence[Case], starts: Sequence[Start]) -> World:
        """Worlds at their start, with what only these cases have."""
        return world


@dataclass(frozen=True)
class LayoutStarts(Starts):
    """A layout places the agents.

    Attributes:
        call: The layout with its options.
        crowdnav_cases: Test cases below this number have CrowdNav's random streams.
    """

    call: LayoutCall
    crowdnav_cases: int = 0

    @property
    def layout(self) -> LayoutCall:
        """See `Starts`."""
        return self.call

    def start(self, case: Case, crowd: Crowd, vehicle: Vehicle, rules: Rules) -> Start:
        """See `Starts`."""
        traits = crowd.draw(rng.generator(case.key, "crowd"))
        leader, group = np.arange(len(traits.radius)), np.full(len(traits.radius), -1)
        if crowd.groups:
            leader = draw_groups(rng.generator(case.key, "groups"), crowd.groups, len(leader))
            traits, group = traits.alike(leader), group_numbers(leader)
        radius = np.append(vehicle.radius + reach(rules.body), traits.radius)
        speed = np.append(vehicle.speed, traits.preferred_speed)
        stands = crowd.population.stands[traits.policy]
        seed = CROWDNAV_TEST_SEED + case.number
        is_crowdnavs = case.split == "test" and case.number < self.crowdnav_cases
        stream = np.random.Generator(seed_legacy(seed)) if is_crowdnavs else rng.generator(case.key, "places")

        def call_layout(radius: Float[np.ndarray, "group"], speed: Float[np.ndarray, "group"]) -> object:
            with plugin_errors("the layout raised"):
                return self.call(stream, radius, speed)

        with case.name_errors():
            if crowd.groups or stands.any():
                standing = rng.generator(case.key, "standing")
                answer: object = place_groups(call_layout, leader, radius, speed, stands, standing)
            else:
                answer = call_layout(radius, speed)
            return Start(traits, complete_placement(answer, radius), group)

    def renewal(self, crowd: Crowd) -> Renewal | None:
        """See `Starts`."""
        if crowd.arrival == "walk_on" and crowd.goal_change is None:
            return None
        return Renewal(crowd, functools.partial(find_respawn(self.call.function), **self.call.options))


def seed_legacy(seed: int) -> np.random.MT19937:
    """The bits of NumPy's legacy generator."""
    legacy = np.random.MT19937()
    legacy._legacy_seeding(seed)
    return legacy
