"""A corridor."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.scenario.layouts.placed import BEYOND, Area, Placed, polygons
from crowdbench.scenario.placement import Placement


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
        width: Width of the corridor [m].
        distance: Distance of the vehicle's start and goal from the middle of the corridor [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
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
    up, down = (lower, top), (upper, bottom)
    return placed.fill(
        lambda: placed.draw(rng, *(up if rng.random() < 0.5 else down)),
        f"one end of a corridor of {width:g} m",
        "layout.width",
    )
