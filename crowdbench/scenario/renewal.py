"""What becomes of pedestrians who arrive, or who change their minds on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import rng
from crowdbench.compiled import njit
from crowdbench.scenario.again import Again, Room, drawn
from crowdbench.scenario.groups import Members, reach_of, spread
from crowdbench.scenario.people import Kinds, Traits
from crowdbench.types import World

ARRIVALS = ("walk_on", "stop", "leave", "new_goal", "respawn", "back_and_forth")
"""What a pedestrian does that has reached its goal:

- `walk_on`: keep walking to it, as in CrowdNav,
- `stop`: stand where it is from then on,
- `leave`: be gone,
- `new_goal`: walk to another goal,
- `respawn`: make room for somebody else who comes in at another place, as in CrowdNav++,
- `back_and_forth`: walk back to where it came from, and so on.
"""

GOES_ON = ("new_goal", "respawn", "back_and_forth")
"""After these somebody walks on to another goal."""


@dataclass(frozen=True)
class GoalChange:
    """How pedestrians change their goals on the way.

    Attributes:
        every: At the steps that are multiples of this number,
        chance: each pedestrian takes another goal with this probability.
    """

    every: int
    chance: float


@dataclass(frozen=True)
class Renewal:
    """Changes people after a step. What is drawn depends on the case, the step and the pedestrian alone.

    Attributes:
        arrival: One of `ARRIVALS`.
        goal_change: How goals change on the way, if they do.
        again: How the layout draws people and goals again, with its options.
        kinds: What people come anew.
        numbers: The number of somebody new in the place of a person is that person's plus this one.
    """

    arrival: str
    goal_change: GoalChange | None
    again: Again
    kinds: Kinds
    numbers: int

    def __call__(self, world: World, running: Bool[np.ndarray, "world"]) -> World:
        """Worlds in which those who have arrived, or change their minds, do what they do then.

        A pedestrian has arrived where its goal is nearer than its radius.

        Args:
            world: The worlds after a step.
            running: Which of them are still running; the others stay as they are.

        Returns:
            The worlds; the same object where nothing happens.

        Raises:
            InputError: The layout fails.
        """
        arrived, change = np.zeros(world.person.shape, bool), self.goal_change
        any_arrived = self.arrival != "walk_on" and find_arrived(world, running, arrived)
        if not any_arrived and (change is None or not (running & (world.step % change.every == 0)).any()):
            return world
        walks = world.present[:, 1:] & (world.preferred_speed[:, 1:] > 0.0) & ~self.kinds.stands[world.policy]
        walks &= running[:, None]
        arrived &= walks
        turned = self._turned(world, walks)
        if not arrived.any() and not turned.any():
            return world
        after = world.take(np.arange(len(world)))  # a copy, which is changed in place
        if self.arrival == "back_and_forth":
            arrived = walks & _with_their_groups(arrived, world.group)
        if self.arrival in _AT_ONCE:
            _AT_ONCE[self.arrival](after, arrived)
            turned, walks, arrived = turned & ~arrived, walks & ~arrived, np.zeros_like(arrived)
        changed = walks & _with_their_groups(arrived | turned, world.group)
        for row, pedestrian in np.argwhere(changed).tolist():
            same = world.group[row] == world.group[row, pedestrian]
            alone = world.group[row, pedestrian] < 0
            members = np.array([pedestrian]) if alone else np.flatnonzero(walks[row] & same)
            if pedestrian == members[0]:
                is_new = self.arrival == "respawn" and bool(arrived[row, members].any())
                after = self._redrawn(after, row, members, is_new)
        return after

    def _turned(
        self, world: World, walks: Bool[np.ndarray, "world pedestrian"]
    ) -> Bool[np.ndarray, "world pedestrian"]:
        """Who of those who walk changes its goal on the way."""
        change = self.goal_change
        if change is None:
            return np.zeros_like(walks)
        due = world.step % change.every == 0
        # A group has one mind.
        mind = np.where(world.group < 0, world.person, world.group)
        return due[:, None] & walks & (rng.uniforms(world.key, "goal_change", world.step, mind) < change.chance)

    def _redrawn(self, world: World, row: int, members: Members, is_new: bool) -> World:
        """One pedestrian, or a group, with another goal, or others in their place.

        Who finds no room walks on, to be drawn again in the next step.

        Args:
            world: The worlds, changed in place.
            row: The pedestrians' world.
            members: Their indices.
            is_new: Whether others come.

        Returns:
            The worlds, new ones where the arrays of routes are too short.
        """
        agents, of_this = members + 1, (int(world.step[row]), int(members[0]))
        traits = None
        radius, speed = world.radius[row, agents], float(world.preferred_speed[row, agents[0]])
        start, goal = world.position[row, agents], world.goal[row, agents]
        if is_new:
            crowd = rng.generator(world.key[row], "crowd again", *of_this)
            traits = self.kinds.walking().draw(crowd, len(members)).alike(np.zeros_like(members))
            radius, speed = traits.radius, float(traits.preferred_speed[0])
        room, stream = Room.of(world, row, agents), rng.generator(world.key[row], "places again", *of_this)
        found = drawn(self.again, stream, room, reach_of(radius), speed, None if is_new else start.mean(axis=0))
        if found is None:
            return world
        offset = spread(found[1] - found[0], radius, stands=False)
        start, goal = found[0] + offset if is_new else start, found[1] + offset
        found_ways = [room.way(*place) for place in zip(start, goal, radius.tolist(), strict=True)]
        ways = [way for way in found_ways if way is not None]
        if len(ways) < len(agents):
            return world
        world.origin[row, agents], world.goal[row, agents] = start, goal
        if traits is not None:
            for one, member in enumerate(members.tolist()):
                replace_person(world, row, member, traits.of(one), start[one], self.numbers)
        for agent, way in zip(agents.tolist(), ways, strict=True):
            world = _with_route(world, row, agent, way)
        return world


def _with_their_groups(
    chosen: Bool[np.ndarray, "world pedestrian"], group: Int[np.ndarray, "world pedestrian"]
) -> Bool[np.ndarray, "world pedestrian"]:
    """Those who are chosen, and all others of their groups."""
    together = chosen.copy()
    for row, number in {(row, group[row, one]) for row, one in np.argwhere(chosen & (group >= 0)).tolist()}:
        together[row, group[row] == number] = True
    return together


def find_arrived(
    world: World, running: Bool[np.ndarray, "world"], arrived: Bool[np.ndarray, "world pedestrian"]
) -> bool:
    """Find out who has arrived: whose goal is nearer than its radius.

    Args:
        world: The worlds.
        running: In which of them anybody arrives.
        arrived: False, filled.

    Returns:
        Whether anybody has.
    """
    people = world.position, world.goal, world.radius, world.preferred_speed, world.present
    found: bool = _fill_arrived(*people, running, arrived)
    return found


def replace_person(
    world: World, row: int, pedestrian: int, traits: Traits, start: Float[np.ndarray, "2"], numbers: int
) -> None:
    """Put somebody new in the place of a pedestrian, in the arrays of worlds.

    Args:
        world: The worlds.
        row: The pedestrian's world.
        pedestrian: Its index.
        traits: What the new one is like.
        start: Where it comes in, in metres.
        numbers: What is added to the numbers of the person and of its group.
    """
    agent = pedestrian + 1
    world.position[row, agent], world.velocity[row, agent] = start, 0.0
    world.history[row, :, pedestrian] = start
    world.radius[row, agent], world.preferred_speed[row, agent] = traits.radius[0], traits.preferred_speed[0]
    world.person[row, pedestrian] += numbers
    if world.group[row, pedestrian] >= 0:
        world.group[row, pedestrian] += numbers
    world.since[row, pedestrian] = world.step[row]
    world.policy[row, pedestrian] = traits.policy[0]
    for name, table in traits.parameters.items():
        for parameter, (value,) in table.items():
            world.parameters[name][parameter][row, agent] = value


def _with_route(world: World, row: int, agent: int, way: Float[np.ndarray, "waypoint 2"]) -> World:
    """Worlds in which an agent has another route, with longer arrays of routes where they are too short."""
    route = world.route
    if len(way) > route.shape[2]:
        longer = [(0, 0), (0, 0), (0, len(way) - route.shape[2]), (0, 0)]
        route = np.pad(route, longer, constant_values=np.nan)
    route[row, agent] = np.nan
    route[row, agent, : len(way)] = way
    world.waypoint[row, agent] = 0
    return world.replace(route=route)


def _stop(world: World, arrived: Bool[np.ndarray, "world pedestrian"]) -> None:
    """Let those who have arrived stand: nothing moves who prefers no speed."""
    world.preferred_speed[:, 1:][arrived] = 0.0


def _leave(world: World, arrived: Bool[np.ndarray, "world pedestrian"]) -> None:
    """Turn those who have arrived into padding, see `World`."""
    world.present[:, 1:][arrived] = False
    for array in (world.position, world.velocity, world.origin, world.goal):
        array[:, 1:][arrived] = 0.0
    world.history.swapaxes(1, 2)[arrived] = 0.0
    world.route[:, 1:][arrived] = np.nan
    world.waypoint[:, 1:][arrived] = 0
    for array in (world.radius, world.preferred_speed):
        array[:, 1:][arrived] = 1.0
    world.person[arrived], world.group[arrived], world.since[arrived] = -1, -1, 0


def _turn_back(world: World, arrived: Bool[np.ndarray, "world pedestrian"]) -> None:
    """Send those who have arrived back to where they came from, on the same route."""
    origin, goal = world.origin[:, 1:], world.goal[:, 1:]
    origin[arrived], goal[arrived] = goal[arrived], origin[arrived]
    world.waypoint[:, 1:][arrived] = 0
    for row, pedestrian in np.argwhere(arrived).tolist():
        route = world.route[row, pedestrian + 1]
        points = route[np.isfinite(route[:, 0])]
        route[: len(points)] = points[::-1]


_AT_ONCE = {"stop": _stop, "leave": _leave, "back_and_forth": _turn_back}
"""What happens to all who arrive, without a draw."""


@no_type_check
@njit
def _fill_arrived(position, goal, radius, speed, present, running, arrived):
    """Find out who has arrived.

    Args:
        position (array): `[world, agent, 2]`, in metres.
        goal (array): `[world, agent, 2]`, in metres.
        radius (array): `[world, agent]`, in metres.
        speed (array): `[world, agent]`, preferred, in m/s; who has none has arrived before.
        present (array): `[world, agent]`.
        running (array): `[world]`, in which worlds anybody arrives.
        arrived (array): `[world, pedestrian]`, False, filled.

    Returns:
        found (bool): Whether anybody has.
    """
    found = False
    for w in range(len(running)):
        for i in range(1, radius.shape[1]):
            if running[w] and present[w, i] and speed[w, i] > 0.0:
                dx, dy = goal[w, i, 0] - position[w, i, 0], goal[w, i, 1] - position[w, i, 1]
                if math.sqrt(dx * dx + dy * dy) < radius[w, i]:
                    arrived[w, i - 1] = True
                    found = True
    return found
