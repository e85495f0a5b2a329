"""A room with blocks in it."""

from __future__ import annotations

import math

import numpy as np
import shapely
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.scenario.layouts.placed import TRIES, Area, Placed, Point, polygons
from crowdbench.scenario.placement import Placement

MARGIN = 1.0
"""Distance in metres of the vehicle's start and goal from the walls, and of blocks from these two."""

PASSAGE = 1.2
"""Smallest distance in metres between blocks, and between blocks and walls."""

SIDES = (0.5, 1.5)
"""Length in metres of the sides of blocks."""

WAY = 0.4
"""Goals of pedestrians are at least this share of the room's width away from their starts."""


def layout(
    rng: np.random.Generator,
    radius: Float[np.ndarray, "agent"],
    preferred_speed: Float[np.ndarray, "agent"],
    *,
    width: float = 10.0,
    blocks: int = 5,
) -> Placement:
    """A square room with blocks somewhere: the vehicle goes from bottom to top, pedestrians from anywhere to anywhere.

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
    corners = [(-side, -side), (side, -side), (side, side), (-side, side)]
    walls = [[one, other] for one, other in zip(corners, corners[1:] + corners[:1], strict=True)]
    placed = Placed(radius, polygons(*walls, *_blocks(rng, side, blocks, shapely.MultiPoint([start, goal]))))
    placed.add(start, goal)
    area: Area = (corners[0], corners[2])
    return placed.fill(lambda: _walk(placed, rng, area, WAY * width), f"a room of {width:g} m", "layout.width")


def _walk(placed: Placed, rng: np.random.Generator, area: Area, least: float) -> bool:
    """Place the next agent and its goal, `least` metres apart or more. False where there is no room."""
    for _ in range(100):
        if not placed.draw(rng, area, area):
            return False
        start, goal = placed.start.all[-1], placed.goal.all[-1]
        if math.dist(start, goal) >= least:
            return True
        placed.start.pop()
        placed.goal.pop()
    return False


def _blocks(rng: np.random.Generator, side: float, number: int, free: shapely.MultiPoint) -> list[list[Point]]:
    """Rectangles apart from each other, the walls, and the vehicle's start and goal.

    Args:
        rng: The random stream of the case.
        side: Half the width of the room in metres.
        number: How many.
        free: The vehicle's start and goal.
    """
    found: list[shapely.Polygon] = []
    for _ in range(TRIES):
        if len(found) == number:
            break
        size = rng.uniform(*SIDES, 2) / 2
        reach = np.maximum(side - PASSAGE - size, 0.0)
        middle = rng.uniform(-reach, reach)
        block = shapely.box(*(middle - size), *(middle + size))
        if block.distance(free) >= MARGIN and all(block.distance(other) >= PASSAGE for other in found):
            found.append(block)
    if len(found) < number:
        raise InputError(f"block {len(found) + 1} of {number} finds no room: lower layout.blocks or raise layout.width")
    return [list(block.exterior.coords)[:-1] for block in found]
