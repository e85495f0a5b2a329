"""Two streets that cross."""

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
    width: float = 4.0,
    distance: float = 4.0,
) -> Placement:
    """Two streets cross between four blocks: the vehicle goes along one, pedestrians along both, both ways.

    Args:
        width: Width of the streets [m].
        distance: Distance of the vehicle's start and goal from the middle of the intersection [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """
    side, end = width / 2, distance + BEYOND
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    blocks = [[(x * a, y * b) for a, b in ((side, side), (end, side), (end, end), (side, end))] for x, y in signs]
    placed = Placed(radius, polygons(*blocks))
    placed.add((0.0, -distance), (0.0, distance))
    # Goals are beyond those of the vehicle, so that nobody stands in its way.
    arrival = distance + BEYOND / 4
    starts = [_arm(turn, side, side, end) for turn in range(4)]
    goals = [_arm(turn, side, arrival, end) for turn in range(4)]
    ways = [(starts[arm], goals[(arm + 2) % 4]) for arm in range(4)]
    return placed.fill(
        lambda: placed.draw(rng, *ways[int(rng.integers(4))]), f"a street of {width:g} m", "layout.width"
    )


def _arm(turn: int, side: float, near: float, far: float) -> Area:
    """A piece of one of the four arms: to the right, up, to the left, down.

    Args:
        turn: Which arm.
        side: Half the width of the street in metres.
        near: Where the piece begins, in metres from the middle.
        far: Where it ends.
    """
    low, high = (near, far) if turn < 2 else (-far, -near)
    return ((low, -side), (high, side)) if turn % 2 == 0 else ((-side, low), (side, high))
