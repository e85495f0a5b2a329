"""Where the vehicle can start and go in a recorded scene, of which no map is known: where somebody has walked."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.errors import InputError
from crowdbench.geometry import norm
from crowdbench.scenario.layouts.placed import CLEARANCE

CELL = 0.5
"""Side of a cell in metres: space is free in a cell in which somebody has walked, and in the eight cells around it."""

FARTHER = 2.0
"""The goal is at most so much farther away than asked for, in metres."""

CLEAR_TIME = 1.0
"""Nobody comes near the vehicle's start in so many seconds, in which it cannot have got away."""

MOST_BUSY = 0.5
"""The largest part of the time in which somebody stands on the goal."""

DRAWS = 20_000
"""Number of pairs of a start and a goal that are tried."""


class FreeSpace:
    """The free space of a recording.

    Args:
        ways: The positions of each pedestrian in metres, one after the other in time.
    """

    def __init__(self, ways: Iterable[Float[np.ndarray, "_ 2"]]) -> None:
        points = np.concatenate([_dense(way) for way in ways])
        self.origin = points.min(axis=0) - 2.0 * CELL
        cells = np.unique(((points - self.origin) / CELL).astype(np.int64), axis=0)
        self.walked = cells
        self.free = np.zeros(cells.max(axis=0) + 3, bool)
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                self.free[cells[:, 0] + dx, cells[:, 1] + dy] = True

    def draw(
        self,
        rng: np.random.Generator,
        distance: float,
        radius: Float[np.ndarray, "agent"],
        track: Float[np.ndarray, "time pedestrian 2"],
        dt: float,
    ) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """Draw start and goal of the vehicle, with free space on the straight way.

        Args:
            rng: The random stream to draw from.
            distance: Their smallest distance in metres.
            radius: Radii in metres, the vehicle's first.
            track: Where the pedestrians are at each step, in metres; NaN who is not there.
            dt: Length of a step in seconds.

        Returns:
            Start and goal in metres.

        Raises:
            InputError: There is no room.
        """
        cells = self.walked[rng.integers(len(self.walked), size=(DRAWS, 2))]
        points = self.origin + CELL * (cells + rng.uniform(size=cells.shape))
        far = norm(points[:, 1] - points[:, 0])
        reach = radius[0] + radius[1:]
        soon = track[: int(np.ceil(CLEAR_TIME / dt)) + 1]
        for start, goal in points[(far >= distance) & (far <= distance + FARTHER)]:
            if (
                self._is_free(start, goal)
                and not _near(start, soon, reach + CLEARANCE).any()
                and _near(goal, track, reach).mean() <= MOST_BUSY
            ):
                return start, goal
        raise InputError(
            f"there is no room for the vehicle to start with a goal {distance:g} m away: lower tracks.distance"
        )

    def _is_free(self, start: Float[np.ndarray, "2"], goal: Float[np.ndarray, "2"]) -> bool:
        along = np.linspace(0.0, 1.0, int(np.ceil(2.0 * math.dist(start, goal) / CELL)) + 1)[:, None]
        x, y = ((start + along * (goal - start) - self.origin) / CELL).astype(np.int64).T
        return bool(self.free[x, y].all())


def _near(
    place: Float[np.ndarray, "2"], track: Float[np.ndarray, "time pedestrian 2"], reach: Float[np.ndarray, "pedestrian"]
) -> Bool[np.ndarray, "time"]:
    """At which times somebody is nearer to a place than `reach`, in metres."""
    return np.asarray((norm(track - place) < reach).any(axis=1))


def _dense(way: Float[np.ndarray, "row 2"]) -> Float[np.ndarray, "point 2"]:
    """A way with points that are no farther apart than half a cell."""
    if len(way) < 2:
        return way
    parts = np.maximum(np.ceil(norm(np.diff(way, axis=0)) / (CELL / 2.0)).astype(np.int64), 1)
    at = np.concatenate([i + np.arange(n) / n for i, n in enumerate(parts.tolist())])
    points = np.stack([np.interp(at, np.arange(len(way)), way[:, axis]) for axis in (0, 1)], axis=1)
    return np.concatenate([points, way[-1:]])
