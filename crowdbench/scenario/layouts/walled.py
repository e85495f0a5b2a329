"""Layouts with walls: corridors, a corner, a doorway, streets that cross, a room with blocks in it."""

from __future__ import annotations

import math

import numpy as np
import shapely

from crowdbench.scenario.layouts.placer import MAX_DRAWS, Area, Placer, Point
from crowdbench.scenario.placement import PerAgent, Placement
from crowdbench.utils.errors import InputError

BEYOND = 4.0
"""Distance in metres from the vehicle's start and goal to the last starts and goals of pedestrians, in a corridor or in
streets that cross. Goals of pedestrians are beyond the vehicle's goal, so that they do not block it."""

BEHIND = 2.0
"""Distance in metres from the last starts and goals to the wall behind them, which no agent passes."""

MARGIN = 1.0
"""In a room, distance in metres of the vehicle's start and goal from the walls, and of blocks from these two."""

PASSAGE = 1.2
"""Smallest distance in metres between blocks, and between blocks and walls."""

SIDES = (0.5, 1.5)
"""Length in metres of the sides of blocks."""

WAY = 0.4
"""In a room, smallest distance of pedestrians' goals from their starts, as a share of the width of the room."""


def corridor(
    rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent, *, width: float = 3.0, distance: float = 4.0
) -> Placement:
    """Make a corridor with pedestrians in both directions, who start ahead of the vehicle or behind it.

    Args:
        width: Width of the corridor [m].
        distance: Distance of the vehicle's start and goal from the middle of the corridor [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """
    side, end, arrival = width / 2, distance + BEYOND, distance + BEYOND / 4
    placer = Placer(radius, _box(side, end + BEHIND))
    placer.add((0.0, -distance), (0.0, distance))
    up = _band(side, -end, -distance / 4), _band(side, arrival, end)
    down = _band(side, distance / 4, end), _band(side, -end, -arrival)
    return placer.fill_two_ways(rng, up, down, f"one end of a corridor of {width:g} m")


def traffic(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    width: float = 5.0,
    distance: float = 4.0,
    against: float = 0.5,
) -> Placement:
    """Make a long street between two walls, with pedestrians who walk along with the vehicle or against it.

    Args:
        width: Width of the street [m].
        distance: Distance of the vehicle's start and goal from the middle of the street [m].
        against: Share of the pedestrians who walk against the vehicle [1].

    Returns:
        See `Layout`, also for the parameters that all layouts have.

    Raises:
        InputError: `against` is above 1.
    """
    if against > 1.0:
        raise InputError(f"layout.against is {against:g}, but must be a share from 0 to 1")
    side, end, arrival = width / 2, distance + 2 * BEYOND, distance + BEYOND
    placer = Placer(radius, _box(side, end + BEHIND))
    placer.add((0.0, -distance), (0.0, distance))
    towards = _band(side, -distance / 2, arrival), _band(side, -end, -arrival)
    along = _band(side, -distance - BEYOND, distance / 2), _band(side, arrival, end)
    return placer.fill_two_ways(rng, towards, along, f"a street of {width:g} m", share=against)


def doorway(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    door_width: float = 1.5,
    width: float = 10.0,
    distance: float = 4.0,
) -> Placement:
    """Make two rooms with a door between them, for the vehicle and for pedestrians from both sides.

    Args:
        door_width: Width of the door [m].
        width: Width of the rooms [m].
        distance: Distance of the vehicle's start and goal from the wall with the door [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.

    Raises:
        InputError: The door is wider than the wall.
    """
    if door_width >= width:
        raise InputError(f"layout.door_width is {door_width:g} m, but must be below layout.width, {width:g} m")
    side, back = width / 2, distance + BEHIND
    doors = [[(-side, 0.0), (-door_width / 2, 0.0)], [(door_width / 2, 0.0), (side, 0.0)]]
    placer = Placer(radius, doors + _box(side, back))
    placer.add((0.0, -distance), (0.0, distance))
    # Goals are well behind the door, so that no pedestrian stands in it.
    up = _band(side, -back, -distance / 4), _band(side, distance / 2, back)
    down = _band(side, distance / 4, back), _band(side, -back, -distance / 2)
    return placer.fill_two_ways(rng, up, down, f"one side of a wall of {width:g} m")


def blind_corner(
    rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent, *, width: float = 3.0, distance: float = 5.0
) -> Placement:
    """Make a corridor with a corner: the vehicle turns right, and pedestrians come around the corner both ways.

    Args:
        width: Width of the corridor [m].
        distance: Distance of the vehicle's start and goal from the middle of the corner [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """
    side, end, arrival = width / 2, distance + BEYOND, distance + BEYOND / 4
    far = end + BEHIND
    outer, inner = [(-side, -far), (-side, side), (far, side)], [(far, -side), (side, -side), (side, -far)]
    placer = Placer(radius, _walls(outer + inner))
    placer.add((0.0, -distance), (distance, 0.0))
    along = _band(side, -end, -side), ((arrival, -side), (end, side))
    back = ((side, -side), (end, side)), _band(side, -end, -arrival)
    return placer.fill_two_ways(rng, along, back, f"one side of the corner of a corridor of {width:g} m")


def intersection(
    rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent, *, width: float = 4.0, distance: float = 4.0
) -> Placement:
    """Make two streets that cross between four blocks: the vehicle goes along one, pedestrians along both, both ways.

    Args:
        width: Width of the streets [m].
        distance: Distance of the vehicle's start and goal from the middle of the intersection [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """
    side, end, arrival = width / 2, distance + BEYOND, distance + BEYOND / 4
    far = end + BEHIND
    signs, block = ((1, 1), (-1, 1), (-1, -1), (1, -1)), ((side, side), (far, side), (far, far), (side, far))
    blocks = [[(x * a, y * b) for a, b in block] for x, y in signs]
    ends = [[(x * side, y * far) for x in (-1, 1)] for y in (-1, 1)]
    placer = Placer(radius, blocks + ends + [[(y, x) for x, y in wall] for wall in ends])
    placer.add((0.0, -distance), (0.0, distance))
    starts, goals = ([_arm(turn, side, near, end) for turn in range(4)] for near in (side, arrival))
    trips = [(starts[arm], goals[(arm + 2) % 4]) for arm in range(4)]
    return placer.fill(
        lambda: placer.draw(rng, *trips[int(rng.integers(4))]), f"a street of {width:g} m", "layout.width"
    )


def room(
    rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent, *, width: float = 10.0, blocks: int = 5
) -> Placement:
    """Make a square room with random blocks: the vehicle goes from bottom to top, pedestrians between random
    positions.

    Args:
        width: Width of the room [m].
        blocks: Number of blocks [1].

    Returns:
        See `Layout`, also for the parameters that all layouts have.

    Raises:
        InputError: There is no room for a block.
    """
    side = width / 2
    start, goal = (0.0, MARGIN - side), (0.0, side - MARGIN)
    placer = Placer(radius, _box(side, side) + _draw_blocks(rng, side, blocks, shapely.MultiPoint([start, goal])))
    placer.add(start, goal)

    def place_next() -> bool:
        for _ in range(100):
            if not placer.draw(rng, _band(side, -side, side), _band(side, -side, side)):
                return False
            if math.dist(placer.start.all[-1], placer.goal.all[-1]) >= WAY * width:
                return True
            placer.pop()
        return False

    return placer.fill(place_next, f"a room of {width:g} m", "layout.width")


def _draw_blocks(rng: np.random.Generator, side: float, number: int, free: shapely.MultiPoint) -> list[list[Point]]:
    """Draw rectangles apart from each other, the walls of a room, and points in it; `side` is half its width in
    metres."""
    placed: list[shapely.Polygon] = []
    for _ in range(MAX_DRAWS):
        if len(placed) == number:
            break
        size = rng.uniform(*SIDES, 2) / 2
        reach = np.maximum(side - PASSAGE - size, 0.0)
        middle = rng.uniform(-reach, reach)
        block = shapely.box(*(middle - size), *(middle + size))
        if block.distance(free) >= MARGIN and all(block.distance(other) >= PASSAGE for other in placed):
            placed.append(block)
    if len(placed) < number:
        raise InputError(
            f"block {len(placed) + 1} of {number} finds no room: lower layout.blocks or raise layout.width"
        )
    return [list(block.exterior.coords)[:-1] for block in placed]


def _box(side: float, end: float) -> list[list[Point]]:
    """Return the walls of a room with half its width and half its length in metres."""
    return _walls([(-side, -end), (side, -end), (side, end), (-side, end)])


def _walls(corners: list[Point]) -> list[list[Point]]:
    """Return the walls of a closed outline, from corner to corner."""
    return [[corner, following] for corner, following in zip(corners, corners[1:] + corners[:1], strict=True)]


def _band(side: float, low: float, high: float) -> Area:
    """Return a part of a corridor along the y axis, between two y coordinates in metres; `side` is half its
    width."""
    return (-side, low), (side, high)


def _arm(turn: int, side: float, near: float, far: float) -> Area:
    """Return a part of one of the four arms of an intersection: `turn` 0 is right, 1 up, 2 left, 3 down."""
    low, high = (near, far) if turn < 2 else (-far, -near)
    return ((low, -side), (high, side)) if turn % 2 == 0 else _band(side, low, high)
