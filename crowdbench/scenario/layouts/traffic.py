"""A street with people along and against the vehicle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.scenario.layouts.placed import BEYOND, Area, Placed, polygons
from crowdbench.scenario.placement import Placement


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
    side, end = width / 2, distance + 2 * BEYOND
    placed = Placed(radius, polygons([(-side, -end), (-side, end)], [(side, -end), (side, end)]))
    placed.add((0.0, -distance), (0.0, distance))
    # Goals are beyond those of the vehicle, so that nobody stands in its way.
    arrival = distance + BEYOND
    behind: Area = ((-side, -distance - BEYOND), (side, distance / 2))
    ahead: Area = ((-side, -distance / 2), (side, distance + BEYOND))
    bottom: Area = ((-side, -end), (side, -arrival))
    top: Area = ((-side, arrival), (side, end))
    along, towards = (behind, top), (ahead, bottom)
    return placed.fill(
        lambda: placed.draw(rng, *(towards if rng.random() < against else along)),
        f"a street of {width:g} m",
        "layout.width",
    )
