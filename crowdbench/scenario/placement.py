"""What a layout is, and what it places for one case."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Placement:
    """What a layout places for one case.

    Attributes:
        start: Where each agent starts, in metres.
        goal: Where each agent is going, in metres.
        route: Waypoints of each agent on the way to its goal, in metres, NaN beyond its last one. The shortest ways
            around the obstacles unless given.
        obstacles: Polygons in metres, NaN beyond the last corner of each. Two corners are a wall without thickness;
            three or more, in either order, are solid. None unless given.
    """

    start: Float[np.ndarray, "agent 2"]
    goal: Float[np.ndarray, "agent 2"]
    route: Float[np.ndarray, "agent waypoint 2"] | None = None
    obstacles: Float[np.ndarray, "polygon corner 2"] | None = None


Layout = Callable[..., Placement]
"""A function `(rng, radius, preferred_speed, **options) -> Placement`.

- `rng` is the random stream of the case, the only source of random numbers.
- `radius` and `preferred_speed` are `[agent]`, in metres and in m/s, the vehicle first.
- The options are keyword-only parameters with defaults.

It raises InputError where there is no room for an agent."""


@dataclass(frozen=True)
class LayoutCall:
    """A layout with its options."""

    function: Layout
    options: Mapping[str, Any] = field(default_factory=dict)

    def __call__(
        self,
        rng: np.random.Generator,
        radius: Float[np.ndarray, "agent"],
        preferred_speed: Float[np.ndarray, "agent"],
    ) -> Any:
        """A `Placement`; anything at all where it is a user's and wrong."""
        return self.function(rng, radius, preferred_speed, **self.options)


def pad_points(points: Sequence[Any]) -> Float[np.ndarray, "row point 2"]:
    """Rows of different numbers of points in one array, NaN beyond the last point of each."""
    padded = np.full((len(points), max(map(len, points), default=0), 2), np.nan)
    for row, each in zip(padded, points, strict=True):
        row[: len(each)] = each
    return padded


def split_corners(obstacles: Float[np.ndarray, "polygon corner 2"]) -> list[Float[np.ndarray, "_ 2"]]:
    """The corners of each polygon, without the padding."""
    return [polygon[np.isfinite(polygon[:, 0])] for polygon in obstacles]
