"""A corridor with a corner."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.scenario.layouts.placed import Area, Placed, polygons
from crowdbench.scenario.placement import Placement

BEYOND = 4.0
"""Distance in metres from the vehicle's start and goal to the ends of the corridor."""


def layout(
    rng: np.random.Generator,
    radius: Float[np.ndarray, "agent"],
    preferred_speed: Float[np.ndarray, "agent"],
    *,
    width: float = 3.0,
    distance: float = 5.0,
) -> Placement:
    """A corridor with a corner: the vehicle turns right, and pedestrians come around the corner both ways.

    Args:
        rng: The random stream of the case.
        radius: Radii [m].
        preferred_speed: Preferred speeds [m/s].
        width: Width of the corridor [m].
        distance: Distance of the vehicle's start and goal from the middle of the corner [m].

    Returns:
        Starts, goals, and the walls.

    Raises:
        InputError: There is no room for a pedestrian.
    """
    side, end = width / 2, distance + BEYOND
    placed = Placed(
        radius,
        polygons(
            [(-side, -end), (-side, side)],
            [(-side, side), (end, side)],
            [(side, -end), (side, -side)],
            [(side, -side), (end, -side)],
        ),
    )
    placed.add((0.0, -distance), (distance, 0.0))
    # Goals are beyond those of the vehicle, so that nobody stands in its way.
    arrival = distance + BEYOND / 4
    below: Area = ((-side, -end), (side, -side))
    right: Area = ((side, -side), (end, side))
    bottom: Area = ((-side, -end), (side, -arrival))
    far_right: Area = ((arrival, -side), (end, side))
    for _ in preferred_speed[1:]:
        along = rng.random() < 0.5
        if not placed.draw(rng, *((below, far_right) if along else (right, bottom))):
            raise placed.full(f"one side of the corner of a corridor of {width:g} m", "layout.width")
    return placed.placement()
