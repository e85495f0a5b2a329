"""The test cases of CrowdNav++ (Liu et al. 2023), drawn as in its code.

Each case is drawn from one random stream, in the order of that code: start and goal of the vehicle, the pedestrians,
and later their replacements. One difference remains: here pedestrians use the current radii of others. CrowdNav++
builds an ORCA simulator once for each pedestrian, which retains the radii of pedestrians that have been replaced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.types import Rules, World
from crowdbench.scenario.layouts.crossings import NOISE, PLUS_CLEARANCE, draw_beside, draw_vehicle_trip
from crowdbench.scenario.layouts.placer import Point
from crowdbench.scenario.placement import Placement
from crowdbench.scenario.population import Population, Traits
from crowdbench.scenario.post_step_rule import find_arrived, replace_person
from crowdbench.scenario.schema import VehicleSpec
from crowdbench.scenario.starts import Case, LayoutStarts, Start, seed_legacy
from crowdbench.sim.simulator import PostStepRule
from crowdbench.utils.errors import InputError

SEED = 1425
"""CrowdNav++ draws test case c with NumPy's legacy generator, seeded with this number plus c."""

MEMORY = "crowdnav_plus"
"""Key of `World.memory` for the number of each case, and the count of numbers drawn from its stream: -1 in cases that
are not drawn as in CrowdNav++."""

NEIGHBOR_DISTANCE = "neighbor_distance"
"""The parameter of a policy that is drawn for each pedestrian."""


class _CaseStream:
    """The random stream of a test case, and its draws.

    Attributes:
        drawn: Count of numbers drawn so far.

    Args:
        case: The number of the case.
        crowd: The pedestrians. If any of their quantities is random, all of them are drawn.
        circle_radius: Radius in metres of the circle that they cross.
        drawn: Count of numbers drawn before.
    """

    def __init__(self, case: int, crowd: Population, circle_radius: float, drawn: int = 0) -> None:
        legacy = seed_legacy(SEED + case)
        legacy.random_raw(2 * drawn, output=False)  # a number takes two raw values
        self._generator = np.random.Generator(legacy)
        self.drawn = drawn
        self._crowd, (self.policy,) = crowd, crowd.shares
        self._circle_radius = circle_radius

    def draw(self) -> float:
        """Return the next number, uniform from 0 to 1."""
        self.drawn += 1
        return self._generator.random()

    def draw_person(self) -> list[float]:
        """Draw the distance in metres at which a pedestrian notices others, its speed in m/s and radius in metres."""
        noticed = self._crowd.parameters[self.policy][NEIGHBOR_DISTANCE]
        quantities = noticed, self._crowd.preferred_speed, self._crowd.radius
        if any(quantity.low < quantity.high for quantity in quantities):
            return [quantity.low + (quantity.high - quantity.low) * self.draw() for quantity in quantities]
        return [quantity.mean for quantity in quantities]

    def traits(self, people: Sequence[list[float]]) -> Traits:
        """Return the traits of pedestrians that `draw_person` has drawn."""
        distance, speed, radius = np.array(people).reshape(-1, 3).T
        parameters = {
            name: {parameter: np.full(len(people), quantity.mean) for parameter, quantity in table.items()}
            for name, table in self._crowd.parameters.items()
        }
        parameters[self.policy][NEIGHBOR_DISTANCE] = distance
        return Traits(radius, speed, np.zeros(len(people), np.int64), parameters)

    def draw_point(
        self,
        others: Float[np.ndarray, "point 2"],
        reach: Float[np.ndarray, "point"],
        low: float = 0.0,
        noise: float = NOISE,
    ) -> Point:
        """Draw a start or a goal, at least as far as `reach` from other points in metres. See `draw_beside`."""

        def is_clear(point: Point) -> bool:
            return bool((np.hypot(*(others - point).T) >= reach).all())

        point = draw_beside(self.draw, self._circle_radius, low, noise, is_clear)
        if point is None:
            raise InputError(f"a circle of {self._circle_radius:g} m radius has no room: raise layout.circle_radius")
        return point


@dataclass(frozen=True)
class CrowdNavPlusStarts(LayoutStarts):
    """Starts as in CrowdNav++ for the first test cases, and by the layout of the same name for other cases."""

    def start(self, case: Case, crowd: Population, vehicle: VehicleSpec, rules: Rules) -> Start:
        """See `LayoutStarts`."""
        if not self.uses_crowdnav_seed(case):
            return super().start(case, crowd, vehicle, rules)
        stream = _CaseStream(case.number, crowd, self.layout.keywords["circle_radius"])
        trips = [draw_vehicle_trip(stream.draw, self.layout.keywords["half_width"])]
        radii = [vehicle.radius]
        people = []
        for _ in range(crowd.number[1]):
            person = stream.draw_person()
            radius = person[2]
            reach = np.repeat(radii, 2) + radius + PLUS_CLEARANCE
            start = stream.draw_point(np.array(trips).reshape(-1, 2), reach)
            trips.append((start, (-start[0], -start[1])))
            radii.append(radius)
            people.append(person)
        starts, goals = np.array(trips).swapaxes(0, 1)
        traits = stream.traits(people)
        distances = traits.parameters[stream.policy][NEIGHBOR_DISTANCE]
        distances[:] = distances[-1:]  # see `_CrowdNavPlusRule._update`
        return Start(traits, Placement(start=starts, goal=goals), np.full(len(people), -1), stream.drawn)

    def complete(self, world: World, cases: Sequence[Case], starts: Sequence[Start]) -> World:
        """See `LayoutStarts`."""
        numbers, drawn = [case.number for case in cases], [start.drawn for start in starts]
        memory = {"case": np.array(numbers, np.int64), "drawn": np.array(drawn, np.int64)}
        return world.replace(memory={**world.memory, MEMORY: memory})

    def post_step_rule(self, crowd: Population) -> PostStepRule | None:
        """See `LayoutStarts`."""
        others = super().post_step_rule(crowd)
        if others is None or crowd.arrival != "respawn":
            return others
        return _CrowdNavPlusRule(crowd, self.layout.keywords["circle_radius"], others)


@dataclass(frozen=True)
class _CrowdNavPlusRule:
    """Rule applied after each step: in the test cases of CrowdNav++ as in its code, in other cases another rule.

    Attributes:
        crowd: The pedestrians.
        circle_radius: Radius in metres of the circle that they cross.
        others: The rule of other cases.
    """

    crowd: Population
    circle_radius: float
    others: PostStepRule

    def __call__(self, world: World, running: Bool[np.ndarray, "world"]) -> World:
        """See `crowdbench.sim.simulator.PostStepRule`."""
        change = self.crowd.goal_change
        is_crowdnav_plus = world.memory[MEMORY]["drawn"] >= 0
        after = self.others(world, running & ~is_crowdnav_plus)
        may_turn = change.is_due(world) if change else np.zeros(len(world), bool)
        due = running & is_crowdnav_plus & (find_arrived(world, running).any(axis=1) | may_turn)
        if due.any() and after is world:
            after = world.take(np.arange(len(world)))  # a copy, which is changed in place
        for row in np.flatnonzero(due).tolist():
            self._update(after, row)
        return after

    def _update(self, world: World, row: int) -> None:
        """Change goals and replace pedestrians of a world after a step, in its arrays."""
        number, drawn = world.memory[MEMORY]["case"], world.memory[MEMORY]["drawn"]
        stream = _CaseStream(int(number[row]), self.crowd, self.circle_radius, int(drawn[row]))
        change = self.crowd.goal_change
        if change is not None and change.is_due(world)[row]:
            for agent in range(1, self.crowd.number[1] + 1):
                if stream.draw() <= change.chance:
                    self._change_goal(stream, world, row, agent)
        arrived = find_arrived(world, np.arange(len(world)) == row)[row]
        replaced = (np.flatnonzero(arrived) + 1).tolist()
        for agent in replaced:
            person = stream.traits([stream.draw_person()])
            # Clear also of the replaced pedestrian.
            others = np.concatenate([world.position[row], world.goal[row]])
            start = stream.draw_point(others, np.tile(world.radius[row], 2) + person.radius + PLUS_CLEARANCE)
            world.origin[row, agent], world.goal[row, agent] = start, (-start[0], -start[1])
            replace_person(world, row, agent - 1, person, 0, np.array(start), self.crowd.number[1])
        if replaced:
            # In CrowdNav++, a policy uses the distance that was drawn last before its first decision.
            distances = world.parameters[stream.policy][NEIGHBOR_DISTANCE]
            distances[row, replaced] = distances[row, replaced[-1]]
        drawn[row] = stream.drawn

    def _change_goal(self, stream: _CaseStream, world: World, row: int, agent: int) -> None:
        """Draw another goal for an agent of a world, clear of the positions and goals of the others."""
        others = np.arange(self.crowd.number[1] + 1) != agent
        points = np.concatenate([world.position[row, others], world.goal[row, others]])
        reach = np.tile(world.radius[row, others], 2) + (world.radius[row, agent] + PLUS_CLEARANCE)
        goal = stream.draw_point(points, reach, 0.5, float(world.preferred_speed[row, agent]))
        world.origin[row, agent] = world.position[row, agent]
        world.goal[row, agent] = goal
