"""A scenario: what all its cases have in common, and how the start of each case is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench import rng
from crowdbench.dynamics import Holonomic, reach
from crowdbench.errors import InputError, plugin_errors
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.digest import digest_of
from crowdbench.scenario.placement import Layout, Placement
from crowdbench.scenario.placing import place
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.types import HISTORY, Rules, World

CROWDNAV_TEST_SEED = 1000
"""CrowdNav draws test case c with NumPy's legacy generator, seeded with this number plus c."""


@dataclass(frozen=True)
class Quantity:
    """A parameter of pedestrians: one value for all, or a value per pedestrian from a truncated Gaussian distribution.

    Attributes:
        mean: The value, or the mean of the Gaussian before it is truncated, in the unit of the parameter.
        std: Standard deviation of the Gaussian; 0 for one value.
        low: Smallest value: what is drawn below it is drawn again.
        high: Largest value.
        whole: Whether values are rounded to whole numbers.
    """

    mean: float
    std: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    whole: bool = False

    def draw(self, generator: np.random.Generator, n: int) -> Float[np.ndarray, "{n}"]:
        """Draw values.

        Args:
            generator: The random stream to draw from.
            n: Number of pedestrians.

        Returns:
            A value per pedestrian.
        """
        values = np.full(n, self.mean)
        if self.std > 0.0:
            outside = np.ones(n, bool)
            while outside.any():
                values[outside] = generator.normal(self.mean, self.std, outside.sum())
                outside = (values < self.low) | (values > self.high)
        return np.rint(values) if self.whole else values


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
        preferred_speed: Preferred and largest speeds of pedestrians in m/s.
        shares: By policy, the share of the pedestrians that follow it.
        policies: The pedestrian policies by name.
        parameters: By policy and name, the parameters of the policies.
        table: The scenario in full, as it is written into results.
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

    @property
    def digest(self) -> str:
        """Twelve hexadecimal digits that change with the cases: see `crowdbench.scenario.digest.digest_of`."""
        return digest_of(self.table)

    @property
    def max_agents(self) -> int:
        """The largest number of agents: the vehicle and the pedestrians."""
        return self.number[1] + 1

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
            InputError: A layout has no room for a crowd, fails, or places what cannot be.
        """
        keys = rng.case_keys(self.seed, split, cases)
        worlds, agents = len(cases), self.max_agents
        position, goal = np.zeros((2, worlds, agents, 2))
        radius, speed = np.ones((2, worlds, agents))
        present = np.zeros((worlds, agents), bool)
        policy = np.zeros((worlds, agents - 1), np.int64)
        parameters = {
            name: {parameter: np.zeros((worlds, agents)) for parameter in table}
            for name, table in self.parameters.items()
        }
        routes, obstacles = [], []
        for w, (case, key) in enumerate(zip(cases.tolist(), keys, strict=True)):
            crowd = rng.generator(key, "crowd")
            radii, speeds = self.people(crowd)
            n = len(radii) - 1
            present[w, : n + 1] = True
            radius[w, : n + 1], speed[w, : n + 1] = radii, speeds
            policy[w, :n] = crowd.choice(len(self.shares), n, p=list(self.shares.values()))
            for name, table in self.parameters.items():
                for parameter, quantity in table.items():
                    parameters[name][parameter][w, 1 : n + 1] = quantity.draw(crowd, n)
            room = radius[w, : n + 1].copy()
            room[0] += reach(self.rules.body)
            placement = self._place(split, case, key, room, speed[w, : n + 1])
            position[w, : n + 1], goal[w, : n + 1] = placement.start, placement.goal
            routes.append(placement.route)
            obstacles.append(placement.obstacles)
        route = _padded(routes, agents)
        ahead = goal[:, 0] - position[:, 0]
        if not isinstance(self.rules.dynamics, Holonomic) and route.shape[2]:
            # What turns slowly faces its first waypoint.
            ahead = np.where(np.isnan(route[:, 0, 0]), ahead, route[:, 0, 0] - position[:, 0])
        return World(
            case=cases,
            key=keys,
            noise_key=rng.noise_keys(keys),
            step=np.zeros(worlds, np.int64),
            position=position,
            velocity=np.zeros_like(position),
            heading=np.arctan2(ahead[:, 1], ahead[:, 0]),
            angular_speed=np.zeros(worlds),
            goal=goal,
            route=route,
            waypoint=np.zeros((worlds, agents), np.int64),
            radius=radius,
            preferred_speed=speed,
            present=present,
            person=np.where(present[:, 1:], np.arange(agents - 1), -1),
            group=np.full((worlds, agents - 1), -1),
            history=np.repeat(position[:, None, 1:], HISTORY, axis=1),
            obstacles=_padded(obstacles),
            policy=policy,
            parameters=parameters,
            memory={name: {} for name in self.parameters},
            rules=self.rules,
        )

    def people(self, crowd: np.random.Generator) -> tuple[Float[np.ndarray, "agent"], Float[np.ndarray, "agent"]]:
        """Draw the agents of a case.

        Args:
            crowd: The random stream of the case's crowd, at its start.

        Returns:
            Radius in metres and preferred speed in m/s of each agent, the vehicle first.
        """
        n = int(crowd.integers(self.number[0], self.number[1] + 1))
        radius = np.append(self.vehicle_radius, self.radius.draw(crowd, n))
        return radius, np.append(self.vehicle_speed, self.preferred_speed.draw(crowd, n))

    def _place(
        self,
        split: str,
        case: int,
        key: np.uint64,
        radius: Float[np.ndarray, "agent"],
        speed: Float[np.ndarray, "agent"],
    ) -> Placement:
        """Let the layout place the agents of one case.

        Args:
            split: Split of the case.
            case: Number of the case.
            key: Start of the random streams of the case, which are not used where the case is CrowdNav's.
            radius: Radii in metres, the vehicle's around its whole body.
            speed: Preferred speeds in m/s.

        Raises:
            InputError: The layout has no room for the crowd, fails, or places what cannot be.
        """
        if split == "test" and case < self.crowdnav_cases:
            legacy = np.random.MT19937()
            legacy._legacy_seeding(CROWDNAV_TEST_SEED + case)
            stream = np.random.Generator(legacy)
        else:
            stream = rng.generator(key, "places")

        def asked() -> object:
            with plugin_errors("the layout raised"):
                return self.layout(stream, radius, speed, **self.layout_options)

        try:
            return place(asked, radius)
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
