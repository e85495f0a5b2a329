"""A corridor with a corner."""

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
    distance: float = 5.0,
) -> Placement:
    """A corridor with a corner: the vehicle turns right, and pedestrians come around the corner both ways.

    Args:
        width: Width of the corridor [m].
        distance: Distance of the vehicle's start and goal from the middle of the corner [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
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
    along, back = (below, far_right), (right, bottom)
    return placed.fill(
        lambda: placed.draw(rng, *(along if rng.random() < 0.5 else back)),
        f"one side of the corner of a corridor of {width:g} m",
        "layout.width",
    )
