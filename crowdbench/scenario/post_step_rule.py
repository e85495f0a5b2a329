"""The rule applied after each step: arrivals, respawn, goal changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from crowdbench.core import rng
from crowdbench.core.arrays import PedestrianFlags
from crowdbench.core.dynamics import disc_centres
from crowdbench.core.geometry import norm, pad_points
from crowdbench.core.types import World
from crowdbench.scenario.clear_space import velocities_ahead
from crowdbench.scenario.groups import group_reach, member_offsets
from crowdbench.scenario.placement import LayoutCall, Position
from crowdbench.scenario.population import Population, Traits
from crowdbench.scenario.respawn import Surroundings, redraw
from crowdbench.sim.routes import with_route
from crowdbench.utils.toml import Location


@dataclass(frozen=True)
class LayoutPostStepRule:
    """Rule applied after each step: arrivals, respawn, goal changes.

    Random draws depend only on the case, the step and the pedestrian.

    Attributes:
        crowd: The pedestrians. A new person has the number of the replaced one, plus the largest number of pedestrians.
        layout: The layout, which draws pedestrians and goals again.
    """

    crowd: Population
    layout: LayoutCall

    def __call__(self, world: World, running: Bool[np.ndarray, "world"]) -> World:
        """Apply arrivals and goal changes to worlds.

        A pedestrian has arrived if its goal is nearer than its radius.

        Args:
            world: The worlds after a step.
            running: True for worlds that are still running; the others do not change.

        Returns:
            The worlds; the same object if nothing changes.

        Raises:
            InputError: The layout fails.
        """
        walks = find_walking(world, running) & ~self.crowd.stands[world.policy]
        arrived = walks & find_arrived(world, running & (self.crowd.arrival != "walk_on"))
        ids = np.where(world.group < 0, world.person, world.group)
        redirected = self._draw_goal_changes(world, running, ids) & walks
        if not arrived.any() and not redirected.any():
            return world
        after = world.take(np.arange(len(world)))  # a copy, which is changed in place
        if self.crowd.arrival == "back_and_forth":
            arrived = walks & _add_groups(arrived, ids)
        if self.crowd.arrival in _ARRIVAL_EFFECTS:
            _ARRIVAL_EFFECTS[self.crowd.arrival](after, arrived)
            walks = walks & ~arrived
            redirected = redirected & ~arrived
            arrived = np.zeros_like(arrived)
        changed = walks & _add_groups(arrived | redirected, ids)
        for row, pedestrian in np.argwhere(changed).tolist():
            members = np.flatnonzero(walks[row] & (ids[row] == ids[row, pedestrian]))
            if pedestrian == members[0]:
                is_new = self.crowd.arrival == "respawn" and bool(arrived[row, members].any())
                after = self._replace(after, row, members, is_new)
        return after

    def _draw_goal_changes(
        self, world: World, running: Bool[np.ndarray, "world"], ids: Int[np.ndarray, "world pedestrian"]
    ) -> PedestrianFlags:
        """Return the pedestrians whose goals change after this step; members of a group have the same id."""
        change = self.crowd.goal_change
        is_due = np.zeros(len(world), bool) if change is None else running & change.is_due(world)
        if change is None or not is_due.any():
            return np.zeros(ids.shape, bool)
        draws = rng.draw_uniforms(world.key, "goal_change", world.step, ids)
        return np.asarray(is_due[:, None] & (draws < change.chance))

    def _replace(self, world: World, row: int, members: Int[np.ndarray, "member"], is_new: bool) -> World:
        """Give one pedestrian or a group a new goal, or replace them by new pedestrians, in the arrays of the worlds.

        If there is no room, the pedestrian walks on, and is drawn again in the next step. The returned object is a new
        one if the arrays of routes are too short.
        """
        agents, of_this = members + 1, (int(world.step[row]), int(members[0]))
        traits = None
        radius, speed = world.radius[row, agents], float(world.preferred_speed[row, agents[0]])
        start, goal = world.position[row, agents], world.goal[row, agents]
        if is_new:
            crowd = rng.generator(world.key[row], "crowd again", *of_this)
            traits = self.crowd.walking().draw(crowd, len(members)).with_traits_of(np.zeros_like(members))
            radius, speed = traits.radius, float(traits.preferred_speed[0])
        surroundings = Surroundings.of(world, row, agents)
        stream = rng.generator(world.key[row], "places again", *of_this)
        middle = None if is_new else start.mean(axis=0)
        with Location(f"case {world.case[row]}, step {world.step[row]}").named():
            trip = redraw(self.layout, stream, surroundings, group_reach(radius), speed, middle)
        if trip is None:
            return world
        offset = member_offsets(trip[1] - trip[0], radius, stands=False)
        start, goal = trip[0] + offset if is_new else start, trip[1] + offset
        found_routes = [surroundings.find_route(*member) for member in zip(start, goal, radius.tolist(), strict=True)]
        routes = [route for route in found_routes if route is not None]
        if len(routes) < len(agents):
            return world
        if is_new and self.crowd.clear_space is not None:
            discs = disc_centres(world.rules.body, world.position[[row], 0], world.heading[[row]])[0]
            reach = radius + world.radius[row, 0]
            velocity = velocities_ahead(start, goal, pad_points(routes), np.full(len(members), speed))
            if not self.crowd.clear_space.holds(discs, world.velocity[row, 0], start, velocity, reach):
                return world
        world.origin[row, agents], world.goal[row, agents] = start, goal
        if traits is not None:
            for i, member in enumerate(members.tolist()):
                replace_person(world, row, member, traits, i, start[i], self.crowd.number[1])
        world.waypoint[row, agents] = 0
        for agent, route in zip(agents.tolist(), routes, strict=True):
            world = world.replace(route=with_route(world.route, row, agent, route))
        return world


def _add_groups(chosen: PedestrianFlags, group_or_person_id: Int[np.ndarray, "world pedestrian"]) -> PedestrianFlags:
    """Return the chosen pedestrians and all members of their groups."""
    together = chosen.copy()
    for row, pedestrian in np.argwhere(chosen).tolist():
        together[row] |= group_or_person_id[row] == group_or_person_id[row, pedestrian]
    return together


def find_walking(world: World, running: Bool[np.ndarray, "world"]) -> PedestrianFlags:
    """Return pedestrians with a preferred speed above 0 in running worlds."""
    return np.asarray(running[:, None] & world.present[:, 1:] & (world.preferred_speed[:, 1:] > 0.0))


def find_arrived(world: World, running: Bool[np.ndarray, "world"]) -> PedestrianFlags:
    """Return pedestrians that have arrived: the goal is nearer than the radius. Standing ones are excluded."""
    to_goal = (world.goal - world.position)[:, 1:]
    return np.asarray(find_walking(world, running) & (norm(to_goal) < world.radius[:, 1:]))


def replace_person(
    world: World, row: int, pedestrian: int, traits: Traits, index: int, start: Position, numbers: int
) -> None:
    """Replace a pedestrian by a new one in the arrays of worlds.

    Args:
        world: The worlds.
        row: The pedestrian's world.
        pedestrian: Its index.
        traits: Traits of the new pedestrians.
        index: Index of the new pedestrian in `traits`.
        start: Its start position in metres.
        numbers: Increment of the number of the person and of the number of its group.
    """
    agent = pedestrian + 1
    world.position[row, agent], world.velocity[row, agent] = start, 0.0
    world.history[row, :, pedestrian] = start
    world.radius[row, agent], world.preferred_speed[row, agent] = traits.radius[index], traits.preferred_speed[index]
    world.person[row, pedestrian] += numbers
    if world.group[row, pedestrian] >= 0:
        world.group[row, pedestrian] += numbers
    world.since[row, pedestrian] = world.step[row]
    world.policy[row, pedestrian] = traits.policy[index]
    for name, table in traits.parameters.items():
        for parameter, values in table.items():
            world.parameters[name][parameter][row, agent] = values[index]


def _stop(world: World, arrived: PedestrianFlags) -> None:
    """Stop pedestrians that have arrived: with a preferred speed of 0 they do not move."""
    world.preferred_speed[:, 1:][arrived] = 0.0


def _leave(world: World, arrived: PedestrianFlags) -> None:
    """Turn pedestrians that have arrived into padding, see `World`."""
    world.present[:, 1:][arrived] = False
    for array in (world.position, world.velocity, world.origin, world.goal):
        array[:, 1:][arrived] = 0.0
    world.history.swapaxes(1, 2)[arrived] = 0.0
    world.route[:, 1:][arrived] = np.nan
    world.waypoint[:, 1:][arrived] = 0
    for array in (world.radius, world.preferred_speed):
        array[:, 1:][arrived] = 1.0
    world.person[arrived], world.group[arrived], world.since[arrived] = -1, -1, 0


def _turn_back(world: World, arrived: PedestrianFlags) -> None:
    """Send pedestrians that have arrived back to their origin, on the same route."""
    origin, goal = world.origin[:, 1:], world.goal[:, 1:]
    origin[arrived], goal[arrived] = goal[arrived], origin[arrived]
    world.waypoint[:, 1:][arrived] = 0
    for row, pedestrian in np.argwhere(arrived).tolist():
        route = world.route[row, pedestrian + 1]
        points = route[np.isfinite(route[:, 0])]
        route[: len(points)] = points[::-1]


_ARRIVAL_EFFECTS = {"stop": _stop, "leave": _leave, "back_and_forth": _turn_back}
"""Effects of arrival without a random draw."""
