"""A corridor."""

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
    distance: float = 4.0,
) -> Placement:
    """A corridor with pedestrians in both directions, who start ahead of the vehicle or behind it.

    Args:
        rng: The random stream of the case.
        radius: Radii [m].
        preferred_speed: Preferred speeds [m/s].
        width: Width of the corridor [m].
        distance: Distance of the vehicle's start and goal from the middle of the corridor [m].

    Returns:
        Starts, goals, and the walls.

    Raises:
        InputError: There is no room for a pedestrian.
    """
    side, end = width / 2, distance + BEYOND
    placed = Placed(radius, polygons([(-side, -end), (-side, end)], [(side, -end), (side, end)]))
    placed.add((0.0, -distance), (0.0, distance))
    # Goals are beyond those of the vehicle, so that nobody stands in its way.
    arrival = distance + BEYOND / 4
    lower: Area = ((-side, -end), (side, -distance / 4))
    upper: Area = ((-side, distance / 4), (side, end))
    bottom: Area = ((-side, -end), (side, -arrival))
    top: Area = ((-side, arrival), (side, end))
    for _ in preferred_speed[1:]:
        upwards = rng.random() < 0.5
        if not placed.draw(rng, *((lower, top) if upwards else (upper, bottom))):
            raise placed.full(f"one end of a corridor of {width:g} m", "layout.width")
    return placed.placement()
