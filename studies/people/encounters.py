"""Closest approaches of persons to strangers, compiled. See definition.md."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.utils import njit

NEAR = 1.0
"""Distance in metres: a stranger counts only if it is farther when both persons are first present."""

Places = Float[np.ndarray, "rollout time person 2"]
"""Positions of persons from the start on, in metres; NaN for absent persons."""


def closest_approach(
    places: Places, strangers: Bool[np.ndarray, "person person"], persons: Bool[np.ndarray, "person"]
) -> Float[np.ndarray, "rollout chosen"]:
    """Return each person's closest approach to strangers that are farther than `NEAR` when both are first present.

    Between frames, motion is straight.

    Args:
        places: Positions in rollouts, or in the recording as the only one.
        strangers: True for pairs that count.
        persons: The persons to return.

    Returns:
        Distances in metres; infinite if there is no such stranger.
    """
    chosen = np.flatnonzero(persons)
    closest = np.full((len(places), len(chosen)), np.inf)
    _fill_closest(np.ascontiguousarray(places), strangers, chosen, closest)
    return closest


@no_type_check
@njit
def _fill_closest(places, strangers, chosen, closest):
    """Fill `closest [rollout, chosen]`."""
    people = places.shape[2]
    for r in range(len(places)):
        for c in range(len(chosen)):
            i = chosen[c]
            for j in range(people):
                if strangers[i, j]:
                    closest[r, c] = min(closest[r, c], _least_distance(places[r, :, i], places[r, :, j]))


@no_type_check
@njit
def _least_distance(one, other):
    """Return the least distance of two paths `[frame, 2]` in metres; infinite if they are never or first near."""
    least, was_there, x, y = math.inf, False, 0.0, 0.0
    for t in range(len(one)):
        dx, dy = one[t, 0] - other[t, 0], one[t, 1] - other[t, 1]
        if math.isnan(dx):
            was_there = False
            continue
        distance = math.sqrt(dx * dx + dy * dy)
        if least == math.inf and distance <= NEAR:
            return math.inf
        least = min(least, distance)
        if was_there:
            mx, my = dx - x, dy - y
            squared = mx * mx + my * my
            share = min(max(-(x * mx + y * my) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
            nx, ny = x + share * mx, y + share * my
            least = min(least, math.sqrt(nx * nx + ny * ny))
        was_there, x, y = True, dx, dy
    return least
