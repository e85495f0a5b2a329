"""A street with people along and against the vehicle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.scenario.layouts.placed import Area, Placed, polygons
from crowdbench.scenario.placement import Placement

BEYOND = 8.0
"""Distance in metres from the vehicle's start and goal to the ends of the street."""


def layout(
    rng: np.random.Generator,
    radius: Float[np.ndarray, "agent"],
    preferred_speed: Float[np.ndarray, "agent"],
    *,
    width: float = 5.0,
    distance: float = 4.0,
    against: float = 0.5,
) -> Placement:
    """A long street between two walls, with pedestrians who walk along with the vehicle or against it.

    Args:
        rng: The random stream of the case.
        radius: Radii [m].
        preferred_speed: Preferred speeds [m/s].
        width: Width of the street [m].
        distance: Distance of the vehicle's start and goal from the middle of the street [m].
        against: Share of the pedestrians who walk against the vehicle [1].

    Returns:
        Starts, goals, and the walls.

    Raises:
        InputError: There is no room for a pedestrian, or `against` is above 1.
    """
    if against > 1.0:
        raise InputError(f"layout.against is {against:g}, but must be a share from 0 to 1")
    side, end = width / 2, distance + BEYOND
    placed = Placed(radius, polygons([(-side, -end), (-side, end)], [(side, -end), (side, end)]))
    placed.add((0.0, -distance), (0.0, distance))
    # Goals are beyond those of the vehicle, so that nobody stands in its way.
    arrival = distance + BEYOND / 2
    behind: Area = ((-side, -distance - BEYOND / 2), (side, distance / 2))
    ahead: Area = ((-side, -distance / 2), (side, distance + BEYOND / 2))
    bottom: Area = ((-side, -end), (side, -arrival))
    top: Area = ((-side, arrival), (side, end))
    for _ in preferred_speed[1:]:
        comes = rng.random() < against
        if not placed.draw(rng, *((ahead, bottom) if comes else (behind, top))):
            raise placed.full(f"a street of {width:g} m", "layout.width")
    return placed.placement()
