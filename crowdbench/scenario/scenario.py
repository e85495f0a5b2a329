"""A scenario: what all its cases have in common, and how the start of each case is drawn."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import rng
from crowdbench.dynamics import Holonomic, reach
from crowdbench.errors import InputError, plugin_errors
from crowdbench.scenario.again import again_of
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.certified import Told, numbers
from crowdbench.scenario.crowdnav_plus import MEMORY, CrowdNavPlus, PlusRenewal
from crowdbench.scenario.digest import digest_of
from crowdbench.scenario.groups import Members, alone, drawn_groups, first_of_group, number_of_group, placed_together
from crowdbench.scenario.layouts.crowdnav_plus import crowdnav_plus
from crowdbench.scenario.people import Kinds, Quantity, Traits
from crowdbench.scenario.placement import Layout, Placement
from crowdbench.scenario.placing import place
from crowdbench.scenario.renewal import GoalChange, Renewal
from crowdbench.scenario.tracked import TrackedCrowd, as_recorded
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.sim.presence import come_and_go
from crowdbench.sim.sight import look
from crowdbench.sim.simulator import with_memories
from crowdbench.tracks.excerpts import Excerpt
from crowdbench.types import HISTORY, Rules, World

CROWDNAV_TEST_SEED = 1000
"""CrowdNav draws test case c with NumPy's legacy generator, seeded with this number plus c."""


@dataclass(frozen=True)
class Scenario:
    """Makes worlds from case numbers. `crowdbench.scenario.file` reads it from a file.

    Attributes:
        name: Name of the scenario.
        source: Name of its file in error messages.
        rules: What is the same in all cases.
        seed: Every case has its own random stream, which depends on this seed, the split and the case number.
        crowdnav_cases: Test cases below this number have CrowdNav's random streams instead.
        layout: Places the agents of a case.
        layout_options: Options of the layout.
        vehicle_radius: Radius of the vehicle in metres.
        vehicle_speed: Preferred and largest speed of the vehicle in m/s.
        number: Smallest and largest number of pedestrians.
        radius: Radii of pedestrians in metres.
        preferred_speed: Preferred and largest speeds of pedestrians in m/s; of recorded people the largest of all.
        shares: By policy, the share of the pedestrians that follow it.
        policies: The pedestrian policies by name.
        parameters: By policy and name, the parameters of the policies.
        table: The scenario in full, as it is written into results.
        arrival: What becomes of pedestrians who arrive, see `crowdbench.scenario.renewal.ARRIVALS`.
        goal_change: How pedestrians change their goals on the way, if they do.
        tracks: The recorded people who are its crowd, instead of a layout; None for a simulated crowd.
        groups: By size, the share of the groups of pedestrians that are so large; empty where all walk alone.
        left_out: By split, the numbers of the cases that are left out, rising: see `crowdbench.scenario.certified`.
        certificates: What there is to say of its certificates; None where there are none.
    """

    name: str
    source: str
    rules: Rules
    seed: int
    crowdnav_cases: int
    layout: Layout
    layout_options: Mapping[str, Any]
    vehicle_radius: float
    vehicle_speed: float
    number: tuple[int, int]
    radius: Quantity
    preferred_speed: Quantity
    shares: Mapping[str, float]
    policies: Mapping[str, PedestrianPolicy]
    parameters: Mapping[str, Mapping[str, Quantity]]
    table: Mapping[str, Any]
    arrival: str = "walk_on"
    goal_change: GoalChange | None = None
    tracks: TrackedCrowd | None = None
    groups: Mapping[int, float] = dataclasses.field(default_factory=dict)
    left_out: Mapping[str, Sequence[int]] = dataclasses.field(default_factory=dict)
    certificates: Told | None = None

    @functools.cached_property
    def renewal(self) -> Callable[[World, Bool[np.ndarray, "world"]], World] | None:
        """What becomes of people after a step; None where they only walk."""
        if self.tracks:
            return come_and_go
        if self.arrival == "walk_on" and self.goal_change is None:
            return None
        again = functools.partial(again_of(self.layout), **self.layout_options)
        renewal = Renewal(self.arrival, self.goal_change, again, self.kinds, self.number[1])
        theirs = self.crowdnav_plus
        return PlusRenewal(theirs, renewal) if theirs is not None and self.arrival == "respawn" else renewal

    @functools.cached_property
    def crowdnav_plus(self) -> CrowdNavPlus | None:
        """How the test cases below `crowdnav_cases` go where they are those of CrowdNav++."""
        if not self.crowdnav_cases or self.layout is not crowdnav_plus:
            return None
        (policy,) = self.shares
        return CrowdNavPlus(
            self.number[1],
            self.kinds,
            policy,
            vehicle_radius=self.vehicle_radius,
            goal_change=self.goal_change,
            left_out=self.left_out.get("test", ()),
            **self.layout_options,
        )

    @property
    def kinds(self) -> Kinds:
        """What pedestrians there may be."""
        standing = [name for name, policy in self.policies.items() if policy.stands]
        return Kinds(self.radius, self.preferred_speed, self.shares, standing, self.parameters)

    @property
    def digest(self) -> str:
        """Twelve hexadecimal digits that change with the cases: see `crowdbench.scenario.digest.digest_of`."""
        return digest_of(self.table)

    @property
    def max_agents(self) -> int:
        """The largest number of agents: the vehicle and the pedestrians."""
        return self.number[1] + 1

    def check_data(self, data: Path | None) -> None:
        """Refuse recorded tracks that the scenario does not need.

        Args:
            data: The folder that the user gave, or None.

        Raises:
            InputError: A folder is given, and the scenario has no `[tracks]`.
        """
        if data is not None and self.tracks is None:
            raise InputError(f"--data does not go with {self.name}, which has no table [tracks]: leave out one of them")

    def worlds(self, cases: Cases) -> World:
        """The starts of a range of cases."""
        return self.draw(cases.split, cases.indices)

    def draw(self, split: str, cases: Int[np.ndarray, "world"]) -> World:
        """Draw the starts of any cases of a split.

        Args:
            split: `train`, `val` or `test`.
            cases: Numbers of the cases.

        Returns:
            A world per case, in the given order.

        Raises:
            InputError: A layout has no room for a crowd, fails, or places what cannot be, or a policy makes no memory.
        """
        drawn_as = numbers(self.left_out.get(split, ()), cases)
        keys = rng.case_keys(self.seed, split, drawn_as)
        worlds, agents = len(cases), self.max_agents
        position, goal = np.zeros((2, worlds, agents, 2))
        radius, speed = np.ones((2, worlds, agents))
        present = np.zeros((worlds, agents), bool)
        policy, group = np.zeros((worlds, agents - 1), np.int64), np.full((worlds, agents - 1), -1)
        parameters = {
            name: {parameter: np.zeros((worlds, agents)) for parameter in table}
            for name, table in self.parameters.items()
        }
        drawn = np.full(worlds, -1)
        routes, obstacles = [], []
        for w, (case, key) in enumerate(zip(drawn_as.tolist(), keys, strict=True)):
            traits, placement, groups, drawn[w] = self._start(split, case, key)
            n = len(traits.radius)
            group[w, :n] = number_of_group(groups, n)
            present[w, : n + 1] = True
            radius[w, 0], speed[w, 0] = self.vehicle_radius, self.vehicle_speed
            radius[w, 1 : n + 1], speed[w, 1 : n + 1] = traits.radius, traits.preferred_speed
            policy[w, :n] = traits.policy
            for name, table in traits.parameters.items():
                for parameter, values in table.items():
                    parameters[name][parameter][w, 1 : n + 1] = values
            position[w, : n + 1], goal[w, : n + 1] = placement.start, placement.goal
            routes.append(placement.route)
            obstacles.append(placement.obstacles)
        route = _padded(routes, agents)
        ahead = goal[:, 0] - position[:, 0]
        if not isinstance(self.rules.dynamics, Holonomic) and route.shape[2]:
            # What turns slowly faces its first waypoint.
            ahead = np.where(np.isnan(route[:, 0, 0]), ahead, route[:, 0, 0] - position[:, 0])
        start = World(
            case=cases,
            key=keys,
            noise_key=rng.noise_keys(keys),
            step=np.zeros(worlds, np.int64),
            position=position,
            velocity=np.zeros_like(position),
            heading=np.arctan2(ahead[:, 1], ahead[:, 0]),
            angular_speed=np.zeros(worlds),
            origin=position.copy(),
            goal=goal,
            route=route,
            waypoint=np.zeros((worlds, agents), np.int64),
            radius=radius,
            preferred_speed=speed,
            present=present,
            person=np.where(present[:, 1:], np.arange(agents - 1), -1),
            since=np.zeros((worlds, agents - 1), np.int64),
            track=np.empty((worlds, 0, agents - 1, 2)),
            group=group,
            history=np.repeat(position[:, None, 1:], HISTORY, axis=1),
            obstacles=_padded(obstacles),
            policy=policy,
            parameters=parameters,
            memory={name: {} for name in self.parameters} | ({MEMORY: {"drawn": drawn}} if self.crowdnav_plus else {}),
            rules=self.rules,
        )
        if self.tracks:
            start = self.tracks.begun(start, [self.tracks.window(split, case) for case in drawn_as.tolist()])
        return with_memories(look(start), self.policies)

    def blocks(self, cases: Cases) -> Int[np.ndarray, "world"] | None:
        """The block of recorded time of each case; None where nobody is recorded, so that cases are independent."""
        if self.tracks is None:
            return None
        return self.tracks.blocks(cases.split, numbers(self.left_out.get(cases.split, ()), cases.indices))

    def _start(self, split: str, case: int, key: np.uint64) -> tuple[Traits, Placement, Sequence[Members], int]:
        """The start of a case.

        Args:
            split: Split of the case.
            case: Number of the case.
            key: Start of the random streams of the case.

        Returns:
            The pedestrians, where all start and go, the groups of pedestrians, and what `CrowdNavPlus.start` drew, -1
            if it was not that.
        """
        if split == "test" and case < self.crowdnav_cases and self.crowdnav_plus is not None:
            traits, placement, drawn = self.crowdnav_plus.start(case)
            return traits, placement, [], drawn
        window = self.tracks.window(split, case) if self.tracks else None
        traits = self.people(rng.generator(key, "crowd"), window)
        n = len(traits.radius)
        groups = drawn_groups(rng.generator(key, "groups"), self.groups, n) if self.groups else []
        if groups:
            traits = traits.alike(first_of_group(groups, n))
        room = np.append(self.vehicle_radius + reach(self.rules.body), traits.radius)
        speed, stands = np.append(self.vehicle_speed, traits.preferred_speed), self.kinds.stands[traits.policy]
        return traits, self._place(split, case, key, room, speed, groups, stands, window), groups, -1

    def people(self, crowd: np.random.Generator, window: Excerpt | None = None) -> Traits:
        """Draw the pedestrians of a case.

        Args:
            crowd: The random stream of the case's crowd, at its start.
            window: The window of the case, where people are recorded.
        """
        if window is None:
            return self.kinds.draw(crowd, int(crowd.integers(self.number[0], self.number[1] + 1)))
        return as_recorded(window, self.kinds.draw(crowd, len(window.radius)), list(self.parameters))

    def _place(
        self,
        split: str,
        case: int,
        key: np.uint64,
        radius: Float[np.ndarray, "agent"],
        speed: Float[np.ndarray, "agent"],
        groups: Sequence[Members],
        stands: Bool[np.ndarray, "pedestrian"],
        window: Excerpt | None,
    ) -> Placement:
        """Let the layout place the agents of one case.

        Args:
            split: Split of the case.
            case: Number of the case.
            key: Start of the random streams of the case, which are not used where the case is CrowdNav's.
            radius: Radii in metres, the vehicle's around its whole body.
            speed: Preferred speeds in m/s.
            groups: The pedestrians of each group; empty where all walk alone.
            stands: Which pedestrians stand.
            window: The window of the case, where people are recorded.

        Raises:
            InputError: The layout has no room for the crowd, fails, or places what cannot be.
        """
        if split == "test" and case < self.crowdnav_cases:
            legacy = np.random.MT19937()
            legacy._legacy_seeding(CROWDNAV_TEST_SEED + case)
            stream = np.random.Generator(legacy)
        else:
            stream = rng.generator(key, "places")

        def asked(radius: Float[np.ndarray, "group"], speed: Float[np.ndarray, "group"]) -> object:
            with plugin_errors("the layout raised"):
                return self.layout(stream, radius, speed, **self.layout_options)

        def placed() -> object:
            if not groups and not stands.any():
                return asked(radius, speed)
            those = groups or alone(len(stands))
            return placed_together(asked, those, radius, speed, stands, rng.generator(key, "standing"))

        try:
            if self.tracks and window:
                return self.tracks.place(window, stream, radius, self.rules)
            return place(placed, radius)
        except InputError as error:
            raise InputError(f"{self.source}: in case {split}:{case}, {error}") from None


def _padded(
    points: Sequence[Float[np.ndarray, "_ _ 2"] | None], n: int | None = None
) -> Float[np.ndarray, "world row point 2"]:
    """Put the points of all worlds into one array, NaN where a world has fewer.

    Args:
        points: Points in metres of each world; None where it has none.
        n: Length of the array's second axis; the largest that any world needs if None.
    """
    lengths = [(0, 0) if each is None else each.shape[:2] for each in points]
    longest = np.max(lengths, axis=0, initial=0)
    padded = np.full((len(points), longest[0] if n is None else n, longest[1], 2), np.nan)
    for w, (each, (first, second)) in enumerate(zip(points, lengths, strict=True)):
        if each is not None:
            padded[w, :first, :second] = each
    return padded
