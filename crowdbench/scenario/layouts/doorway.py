"""A wall with a door."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.scenario.layouts.placed import Area, Placed, polygons
from crowdbench.scenario.placement import Placement

BEHIND = 2.0
"""Distance in metres from the vehicle's start and goal to the wall behind it."""


def layout(
    rng: np.random.Generator,
    radius: Float[np.ndarray, "agent"],
    preferred_speed: Float[np.ndarray, "agent"],
    *,
    door_width: float = 1.5,
    width: float = 10.0,
    distance: float = 4.0,
) -> Placement:
    """Two rooms with a door between them: the vehicle goes through it, and pedestrians from both sides.

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
    placed = Placed(
        radius,
        polygons(
            [(-side, 0.0), (-door_width / 2, 0.0)],
            [(door_width / 2, 0.0), (side, 0.0)],
            [(-side, -back), (side, -back)],
            [(side, -back), (side, back)],
            [(side, back), (-side, back)],
            [(-side, back), (-side, -back)],
        ),
    )
    placed.add((0.0, -distance), (0.0, distance))
    # Goals are well behind the door, so that nobody stands in it.
    lower: Area = ((-side, -back), (side, -distance / 4))
    upper: Area = ((-side, distance / 4), (side, back))
    bottom: Area = ((-side, -back), (side, -distance / 2))
    top: Area = ((-side, distance / 2), (side, back))
    up, down = (lower, top), (upper, bottom)
    return placed.fill(
        lambda: placed.draw(rng, *(up if rng.random() < 0.5 else down)),
        f"one side of a wall of {width:g} m",
        "layout.width",
    )
