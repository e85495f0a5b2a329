"""The test cases of CrowdNav++ (Liu et al. 2023) to the letter.

Everything in such a case is drawn from one stream, in the order of their code: the vehicle's way, the people, and those
who take their places later. Differs from theirs because people notice each other's radii as they are: in their code a
world of ORCA is built once for each pedestrian, and keeps the radii of those who have been replaced since.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.errors import InputError
from crowdbench.scenario.certified import numbers
from crowdbench.scenario.layouts.crowdnav_plus import CLEARANCE, goal_on, is_clear, start_beside, vehicle_way
from crowdbench.scenario.layouts.placed import Point
from crowdbench.scenario.people import Kinds, Quantity, Traits
from crowdbench.scenario.placement import Placement
from crowdbench.scenario.renewal import GoalChange, find_arrived, replace_person
from crowdbench.sim.simulator import Renewal
from crowdbench.types import World

SEED = 1425
"""CrowdNav++ draws test case c with NumPy's legacy generator, seeded with this number plus c."""

MEMORY = "crowdnav_plus"
"""Under this name `World.memory` has how many numbers of its stream each case has drawn, -1 in cases of others."""


class Stream:
    """The stream of a test case.

    Attributes:
        drawn: How many numbers have been drawn.

    Args:
        case: The number of the case.
        drawn: How many numbers have been drawn before.
    """

    def __init__(self, case: int, drawn: int = 0) -> None:
        legacy = np.random.MT19937()
        legacy._legacy_seeding(SEED + case)
        legacy.random_raw(2 * drawn, output=False)  # a number takes two of these
        self._generator = np.random.Generator(legacy)
        self.drawn = drawn

    def draw(self) -> float:
        """The next number, uniform from 0 to 1."""
        self.drawn += 1
        return self._generator.random()


@dataclass(frozen=True)
class CrowdNavPlus:
    """How the test cases of CrowdNav++ start, and how their people are replaced.

    Attributes:
        number: Number of pedestrians.
        kinds: What they are like. Where anything differs between them, all of it is drawn.
        policy: Their policy.
        circle_radius: Radius in metres of the circle that they cross.
        half_width: The vehicle starts and arrives in the square from -half_width to half_width, in metres.
        vehicle_radius: In metres.
        goal_change: How pedestrians change their goals on the way, if they do.
        left_out: The numbers of the test cases that are left out, rising.
    """

    number: int
    kinds: Kinds
    policy: str
    circle_radius: float
    half_width: float
    vehicle_radius: float
    goal_change: GoalChange | None
    left_out: Sequence[int] = ()

    def start(self, case: int) -> tuple[Traits, Placement, int]:
        """The pedestrians of a case, where all start and go, and how many numbers were drawn for it."""
        stream = Stream(case)
        ways, people = [vehicle_way(stream.draw, self.half_width)], list[Traits]()
        for _ in range(self.number):
            people.append(self._person(stream))
            radius = np.array([self.vehicle_radius, *(float(each.radius[0]) for each in people)])
            start = self._start(stream, np.array(ways).reshape(-1, 2), np.repeat(radius[:-1], 2) + radius[-1])
            ways.append((start, (-start[0], -start[1])))
        starts, goals = np.array(ways).swapaxes(0, 1)
        together = _together(people)
        distances = together.parameters[self.policy]["neighbor_distance"]
        distances[:] = distances[-1:]  # see `renew`
        return together, Placement(start=starts, goal=goals), stream.drawn

    def renew(self, world: World, row: int) -> None:
        """Change the goals and the people of a world after a step, in its arrays."""
        drawn: Int[np.ndarray, "world"] = world.memory[MEMORY]["drawn"]
        (case,) = numbers(self.left_out, world.case[row : row + 1]).tolist()
        stream, change = Stream(case, int(drawn[row])), self.goal_change
        if change is not None and world.step[row] % change.every == 0:
            for agent in range(1, self.number + 1):
                if stream.draw() <= change.chance:
                    self._turn(stream, world, row, agent)
        arrived, came = np.zeros(world.person.shape, bool), []
        find_arrived(world, np.arange(len(world)) == row, arrived)
        for agent in (np.flatnonzero(arrived[row]) + 1).tolist():
            person = self._person(stream)
            # Clear also of the one whose place it takes.
            ways = np.concatenate([world.position[row], world.goal[row]])
            start = self._start(stream, ways, np.tile(world.radius[row], 2) + person.radius)
            world.origin[row, agent], world.goal[row, agent] = start, (-start[0], -start[1])
            replace_person(world, row, agent - 1, person, np.array(start), self.number)
            came.append(agent)
        if came:
            # A policy of theirs takes the distance that was drawn last before it decides first.
            distances = world.parameters[self.policy]["neighbor_distance"]
            distances[row, came] = distances[row, came[-1]]
        drawn[row] = stream.drawn

    def _person(self, stream: Stream) -> Traits:
        """Draw what a pedestrian is like."""
        parameters = {
            name: {parameter: np.array([quantity.mean]) for parameter, quantity in table.items()}
            for name, table in self.kinds.parameters.items()
        }
        noticed = self.kinds.parameters[self.policy]["neighbor_distance"]
        quantities = noticed, self.kinds.preferred_speed, self.kinds.radius
        if any(quantity.low < quantity.high for quantity in quantities):
            distance, speed, radius = (_uniform(quantity, stream.draw()) for quantity in quantities)
        else:
            distance, speed, radius = (quantity.mean for quantity in quantities)
        parameters[self.policy]["neighbor_distance"] = np.array([distance])
        return Traits(np.array([radius]), np.array([speed]), np.zeros(1, np.int64), parameters)

    def _start(self, stream: Stream, others: Float[np.ndarray, "point 2"], reach: Float[np.ndarray, "point"]) -> Point:
        """Draw where somebody starts, clear of other positions and goals; `reach` has the sums of the radii."""
        start = start_beside(stream.draw, self.circle_radius, lambda point: is_clear(point, others, reach + CLEARANCE))
        return _found(start, self.circle_radius)

    def _turn(self, stream: Stream, world: World, row: int, agent: int) -> None:
        """Draw another goal for an agent of a world, clear of the positions and goals of the others."""
        others = np.arange(self.number + 1) != agent
        points = np.concatenate([world.position[row, others], world.goal[row, others]])
        reach = np.tile(world.radius[row, others], 2) + (world.radius[row, agent] + CLEARANCE)
        speed = float(world.preferred_speed[row, agent])
        goal = goal_on(stream.draw, self.circle_radius, speed, lambda point: is_clear(point, points, reach))
        world.origin[row, agent] = world.position[row, agent]
        world.goal[row, agent] = _found(goal, self.circle_radius)


def _found(point: Point | None, circle_radius: float) -> Point:
    if point is None:
        raise InputError(f"a circle of {circle_radius:g} m radius has no room: raise layout.circle_radius")
    return point


def _uniform(quantity: Quantity, share: float) -> float:
    return quantity.low + (quantity.high - quantity.low) * share


def _together(people: Sequence[Traits]) -> Traits:
    """Several pedestrians as one crowd."""
    parameters = {
        name: {parameter: np.concatenate([each.parameters[name][parameter] for each in people]) for parameter in table}
        for name, table in people[0].parameters.items()
    }
    return Traits(
        np.concatenate([each.radius for each in people]),
        np.concatenate([each.preferred_speed for each in people]),
        np.concatenate([each.policy for each in people]),
        parameters,
    )


@dataclass(frozen=True)
class PlusRenewal:
    """What becomes of people: in the test cases of CrowdNav++ what its code does, in other cases what others do.

    Attributes:
        cases: The test cases.
        others: What becomes of people in other cases.
    """

    cases: CrowdNavPlus
    others: Renewal

    def __call__(self, world: World, running: Bool[np.ndarray, "world"]) -> World:
        """See `crowdbench.sim.simulator.Renewal`."""
        is_theirs = world.memory[MEMORY]["drawn"] >= 0
        after = self.others(world, running & ~is_theirs)
        change = self.cases.goal_change
        arrived = np.zeros(world.person.shape, bool)
        find_arrived(world, running & is_theirs, arrived)
        due = arrived.any(axis=1)
        if change is not None:
            due |= running & is_theirs & (world.step % change.every == 0)
        if not due.any():
            return after
        if after is world:
            after = world.take(np.arange(len(world)))  # a copy, which is changed in place
        for row in np.flatnonzero(due).tolist():
            self.cases.renew(after, row)
        return after
