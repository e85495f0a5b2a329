"""Starts of cases: the pedestrians, the starts and goals of all agents, and the rule applied after each step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core import rng
from crowdbench.core.dynamics import Body, disc_centres, reach
from crowdbench.core.types import Rules, World
from crowdbench.scenario.clear_space import ClearSpace, velocities_ahead
from crowdbench.scenario.groups import draw_groups, group_numbers, place_groups
from crowdbench.scenario.placement import LayoutCall, PerAgent, Placement, check_shape, complete_placement
from crowdbench.scenario.population import Population, Traits
from crowdbench.scenario.post_step_rule import LayoutPostStepRule
from crowdbench.scenario.schema import VehicleSpec
from crowdbench.sim import simulator
from crowdbench.utils.errors import InputError
from crowdbench.utils.resources import plugin_in_time
from crowdbench.utils.toml import Location

TRIES = 1000
"""Largest number of placements that are drawn until one keeps the vehicle's space clear."""

CROWDNAV_TEST_SEED = 1000
"""CrowdNav draws test case c with NumPy's legacy generator, seeded with this number plus c."""


class Case(NamedTuple):
    """A case that is drawn.

    Attributes:
        location: The scenario's file and the case, for errors.
        split: `train`, `val` or `test`.
        number: Number of the case within its split.
        key: Key of its random streams.
    """

    location: Location
    split: str
    number: int
    key: np.uint64


class Start(NamedTuple):
    """The start of a case.

    Attributes:
        traits: The pedestrians.
        placement: Starts and goals of all agents.
        group: Group number of each pedestrian, -1 without a group.
        drawn: Count of numbers drawn from its stream, if the whole case is drawn from one stream; otherwise -1.
    """

    traits: Traits
    placement: Placement
    group: Int[np.ndarray, "pedestrian"]
    drawn: int = -1


@dataclass(frozen=True)
class LayoutStarts:
    """Starts of cases in which a layout places the agents.

    Attributes:
        layout: The layout with its options.
        crowdnav_cases: Test cases below this number have CrowdNav's random streams.
    """

    layout: LayoutCall
    crowdnav_cases: int = 0

    def uses_crowdnav_seed(self, case: Case) -> bool:
        """Return whether a case has CrowdNav's random stream."""
        return case.split == "test" and case.number < self.crowdnav_cases

    def start(self, case: Case, crowd: Population, vehicle: VehicleSpec, rules: Rules) -> Start:
        """Draw the start of a case. Raises InputError if that is impossible."""
        more = rules.vehicles - 1  # other vehicles, which the layout places as it places pedestrians
        everybody = replace(crowd, number=(crowd.number[0] + more, crowd.number[1] + more))
        traits = everybody.draw(rng.generator(case.key, "crowd"))
        traits.radius[:more], traits.preferred_speed[:more] = vehicle.radius, vehicle.preferred_speed
        leader, group = np.arange(len(traits.radius)), np.full(len(traits.radius), -1)
        if crowd.groups:
            leader = draw_groups(rng.generator(case.key, "groups"), crowd.groups, len(leader))
            traits, group = traits.with_traits_of(leader), group_numbers(leader)
        radius = np.append(vehicle.radius + reach(rules.body), traits.radius)
        speed = np.append(vehicle.preferred_speed, traits.preferred_speed)
        stands, stream = crowd.stands[traits.policy], rng.generator(case.key, "places")
        stands[:more] = False
        if self.uses_crowdnav_seed(case):
            stream = np.random.Generator(seed_legacy(CROWDNAV_TEST_SEED + case.number))

        def call_layout(radius: PerAgent, speed: PerAgent) -> object:
            with plugin_in_time("the layout raised"):
                return self.layout(stream, radius, speed)

        standing = rng.generator(case.key, "standing")
        space, apart = crowd.clear_space, traits.radius + vehicle.radius
        walking_speed = np.append(vehicle.preferred_speed, np.where(stands, 0.0, traits.preferred_speed))
        with case.location.named():
            for _ in range(TRIES):
                if crowd.groups or stands.any():
                    answer: object = place_groups(call_layout, leader, radius, speed, stands, standing)
                else:
                    answer = call_layout(radius, speed)
                try:
                    placement = check_shape(answer, len(radius))
                    # Before the search for routes around obstacles, which takes longest: the middle disc of the
                    # vehicle, whose position does not depend on the heading.
                    middle, others = placement.start[:1], placement.start[1:]
                    if space and 0.0 in rules.body and space.is_entered(middle, others, apart):
                        continue
                    placement = complete_placement(placement, radius)
                except InputError as error:
                    moved = "the layout placed its group; members stand side by side around that place"
                    raise InputError(f"{error} ({moved})" if crowd.groups else str(error)) from None
                views = [placement.as_seen_by(k) for k in range(more + 1)] if more else [placement]
                if space is None or all(_is_clear(space, view, walking_speed, apart, rules.body) for view in views):
                    return Start(traits, placement, group)
            raise InputError(f"somebody is in the clear_space in all {TRIES} placements: make it smaller, or the crowd")

    def complete(self, world: World, cases: Sequence[Case], starts: Sequence[Start]) -> World:
        """Return worlds at their start, with additional data of these cases."""
        return world

    def post_step_rule(self, crowd: Population) -> simulator.PostStepRule | None:
        """Return the rule applied after each step; None if pedestrians only walk."""
        if crowd.arrival == "walk_on" and crowd.goal_change is None:
            return None
        return LayoutPostStepRule(crowd, self.layout)


def _is_clear(
    space: ClearSpace, placement: Placement, speed: PerAgent, reach: Float[np.ndarray, "pedestrian"], body: Body
) -> bool:
    """Return whether no pedestrian starts in the clear space, or on a course on which it soon touches the vehicle."""
    start = placement.start
    velocity = velocities_ahead(start, placement.goal, placement.route, speed)
    heading = math.atan2(velocity[0, 1], velocity[0, 0])
    discs = disc_centres(body, start[:1], np.array([heading]))[0]
    return space.holds(discs, velocity[0], start[1:], velocity[1:], reach)


def seed_legacy(seed: int) -> np.random.MT19937:
    """Return the bit generator of NumPy's legacy random state."""
    legacy = np.random.MT19937()
    legacy._legacy_seeding(seed)
    return legacy
