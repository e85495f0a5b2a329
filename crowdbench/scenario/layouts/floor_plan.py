"""A layout among given obstacles, such as a map: all agents go from one named region to another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from crowdbench.scenario.layouts.placer import MAX_DRAWS, Area, Placer, Point
from crowdbench.scenario.placement import PerAgent, Placement
from crowdbench.utils.errors import InputError, is_number


def floor_plan(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    obstacles: Sequence[Any] = [],
    regions: Mapping[str, Any] = {},
    vehicle: Sequence[Any] = [],
    ways: Sequence[Any] = [],
) -> Placement:
    """Take obstacles from a map, with regions for the starts and goals of pedestrians and the vehicle.

    Args:
        obstacles: Polygons, each a list of corners [m]. In a scenario, `map = "./map.yaml"` stands for an occupancy
            grid of ROS.
        regions: Rectangles by name, each given by its smallest and its largest coordinates [m].
        vehicle: The region of the vehicle's start, and the region of its goal.
        ways: Pairs of regions between which pedestrians go, in either direction.

    Returns:
        See `Layout`, also for the parameters that all layouts have.

    Raises:
        InputError: Obstacles or regions are invalid, or there is no room for the vehicle or a pedestrian.
    """
    areas = {name: _area(f"layout.regions.{name}", corners) for name, corners in regions.items()}
    vehicle_trip = _trip("layout.vehicle", vehicle, areas)
    if not isinstance(ways, list) or not ways:
        raise InputError('layout.ways must be a list of pairs of regions, such as [["door", "desk"]]')
    trips = [_trip(f"layout.ways[{number}]", way, areas) for number, way in enumerate(ways, 1)]
    placer = Placer(radius, [_points(f"layout.obstacles[{number}]", each) for number, each in enumerate(obstacles, 1)])
    if not placer.draw(rng, *vehicle_trip):
        raise InputError(f"the vehicle finds no room between {' and '.join(vehicle)}, in {MAX_DRAWS} draws")

    def place_next() -> bool:
        start, goal = trips[int(rng.integers(len(trips)))]
        return placer.draw(rng, goal, start) if rng.random() < 0.5 else placer.draw(rng, start, goal)

    return placer.fill(place_next, "the regions of layout.ways", "the size of its regions")


def _trip(key: str, names: object, areas: Mapping[str, Area]) -> tuple[Area, Area]:
    """Return two regions by their names."""
    if not isinstance(names, list) or len(names) != 2 or not all(name in areas for name in names):
        known = ", ".join(areas) or "none: layout.regions is empty"
        raise InputError(f"{key} is {names!r}, but must be a pair of regions; there are {known}")
    return areas[names[0]], areas[names[1]]


def _area(key: str, corners: object) -> Area:
    """Check a rectangle, and return it."""
    low, high = _points(key, corners)[:2]
    if not (low[0] < high[0] and low[1] < high[1]):
        raise InputError(f"{key} is {corners!r}, but must be the smallest and the largest corner: [[x, y], [x, y]]")
    return low, high


def _points(key: str, corners: object) -> list[Point]:
    """Check a list of points, and return it."""
    if not isinstance(corners, list) or len(corners) < 2 or not all(_is_point(corner) for corner in corners):
        raise InputError(f"{key} is {corners!r}, but must be a list of 2 or more points [x, y] in metres")
    return [(float(x), float(y)) for x, y in corners]


def _is_point(point: object) -> bool:
    return isinstance(point, list) and len(point) == 2 and all(is_number(coordinate) for coordinate in point)
