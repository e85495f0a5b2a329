"""A scenario: what all its cases share, and how each case is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench import rng
from crowdbench.errors import InputError
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.digest import digest_of
from crowdbench.scenario.layouts import LAYOUTS, Placement
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.types import HISTORY, Rules, World

CROWDNAV_TEST_SEED = 1000
"""CrowdNav draws its test case c with NumPy's legacy generator seeded with this plus c."""


@dataclass(frozen=True)
class Quantity:
    """A pedestrian's parameter: fixed (`std` 0), or Gaussian and redrawn until it lies in [low, high].

    A `whole` one is rounded.
    """

    mean: float
    std: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    whole: bool = False

    def draw(self, generator: np.random.Generator, n: int) -> Float[np.ndarray, "{n}"]:
        """One value for each of `n` pedestrians."""
        values = np.full(n, self.mean)
        if self.std > 0.0:
            outside = np.ones(n, bool)
            while outside.any():
                values[outside] = generator.normal(self.mean, self.std, outside.sum())
                outside = (values < self.low) | (values > self.high)
        return np.rint(values) if self.whole else values


@dataclass(frozen=True)
class Scenario:
    """Turns case numbers into worlds. Read from a file by `crowdbench.scenario.file`.

    `number` is the least and the largest number of pedestrians; `shares` tells which part of the crowd
    follows each of the `policies`, and `parameters` what those are given. Test cases below
    `crowdnav_cases` are drawn from CrowdNav's seeds; all others from streams of (seed, split, case).
    `table` is the scenario in full, as written into results.
    """

    name: str
    source: str
    rules: Rules
    seed: int
    crowdnav_cases: int
    generator: str
    layout: Mapping[str, float]
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
        """The vehicle and the largest number of pedestrians."""
        return self.number[1] + 1

    def worlds(self, cases: Cases) -> World:
        """The start of a range of cases."""
        return self.draw(cases.split, cases.indices)

    def draw(self, split: str, cases: Int[np.ndarray, "world"]) -> World:
        """The start of any cases of a split.

        Args:
            split: `train`, `val` or `test`.
            cases: Numbers of the cases.

        Returns:
            A world per case, in the given order.

        Raises:
            InputError: A crowd has no room in its layout.
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
            n = int(crowd.integers(self.number[0], self.number[1] + 1))
            present[w, : n + 1] = True
            radius[w, 0], speed[w, 0] = self.vehicle_radius, self.vehicle_speed
            radius[w, 1 : n + 1] = self.radius.draw(crowd, n)
            speed[w, 1 : n + 1] = self.preferred_speed.draw(crowd, n)
            policy[w, :n] = crowd.choice(len(self.shares), n, p=list(self.shares.values()))
            for name, table in self.parameters.items():
                for parameter, quantity in table.items():
                    parameters[name][parameter][w, 1 : n + 1] = quantity.draw(crowd, n)
            placement = self._place(split, case, key, radius[w, : n + 1], speed[w, : n + 1])
            position[w, : n + 1], goal[w, : n + 1] = placement.start, placement.goal
            routes.append(placement.route)
            obstacles.append(placement.obstacles)
        ahead = goal[:, 0] - position[:, 0]
        return World(
            case=cases,
            key=keys,
            step=np.zeros(worlds, np.int64),
            position=position,
            velocity=np.zeros_like(position),
            heading=np.arctan2(ahead[:, 1], ahead[:, 0]),
            angular_speed=np.zeros(worlds),
            goal=goal,
            route=_padded(routes, agents),
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

    def _place(
        self,
        split: str,
        case: int,
        key: np.uint64,
        radius: Float[np.ndarray, "agent"],
        speed: Float[np.ndarray, "agent"],
    ) -> Placement:
        """What the layout places for one case, from CrowdNav's stream or from one of our own."""
        stream = rng.generator(key, "places")
        if split == "test" and case < self.crowdnav_cases:
            legacy = np.random.MT19937()
            legacy._legacy_seeding(CROWDNAV_TEST_SEED + case)
            stream = np.random.Generator(legacy)
        try:
            return LAYOUTS[self.generator](stream, radius, speed, **self.layout)
        except InputError as error:
            raise InputError(f"{self.source}: {error}") from None


def _padded(
    points: Sequence[Float[np.ndarray, "n k 2"] | None], n: int | None = None
) -> Float[np.ndarray, "world n k 2"]:
    """Points of every world, NaN beyond those it has; `n` is the length of the first axis, the largest if None."""
    lengths = [(0, 0) if each is None else each.shape[:2] for each in points]
    longest = np.max(lengths, axis=0, initial=0)
    padded = np.full((len(points), longest[0] if n is None else n, longest[1], 2), np.nan)
    for w, (each, (first, second)) in enumerate(zip(points, lengths, strict=True)):
        if each is not None:
            padded[w, :first, :second] = each
    return padded
