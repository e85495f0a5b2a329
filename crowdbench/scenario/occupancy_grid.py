"""Obstacles from an occupancy grid, as ROS keeps it: `map.yaml` and an image (the ROS package `map_server`)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
import yaml
from jaxtyping import Bool
from PIL import Image
from pydantic import AfterValidator, Field
from shapely import affinity

from crowdbench.utils import files
from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import Location, Name, TomlTable, integer, number, parse_table

Polygon = list[list[float]]
"""The corners of a polygon in metres."""

DIGITS = 3
"""Coordinates are rounded to millimetres."""

LARGEST = 4096
"""Pixels of an image's side, at most."""


def _pose(origin: list[float]) -> list[float]:
    if len(origin) not in (2, 3) or not all(map(math.isfinite, origin)):
        raise ValueError
    return origin


class GridSpec(TomlTable):
    """The file `map.yaml`; what else it has is left aside.

    `origin` is where the lower left corner of the image lies, in metres, and by how much the image is turned there, in
    radians. A pixel is occupied if its darkness, from 0 (white) to 1, is above `occupied_thresh`; with `negate`, white
    is 1.
    """

    image: Name
    resolution: float = number(above=0.0, below=1000.0)
    origin: Annotated[list[float], AfterValidator(_pose)] = Field(
        description="two or three numbers: x and y in metres, and an angle in radians"
    )
    occupied_thresh: float = number(0.65, least=0.0, below=1.0)
    negate: int = integer(0, least=0, most=1)


def read_obstacles(path: Path) -> list[Polygon]:
    """The obstacles of an occupancy grid: polygons around its occupied pixels, in its frame.

    A polygon leaves its pixels by the resolution at most. One around a room is cut, so that none has a hole.

    Args:
        path: The file `map.yaml`. Its image is PGM, PNG, or whatever else Pillow reads, in its folder.

    Raises:
        InputError: One of the two files is missing or wrong.
    """
    spec = _read_spec(path)
    occupied = _read_image(path, spec)
    shape = shapely.union_all(_boxes(occupied)).simplify(1.0)
    shape = affinity.scale(shape, spec.resolution, spec.resolution, origin=(0.0, 0.0))
    if len(spec.origin) == 3:
        shape = affinity.rotate(shape, spec.origin[2], origin=(0.0, 0.0), use_radians=True)
    shape = affinity.translate(shape, *spec.origin[:2])
    # Two that were apart may cross once they are simplified, and rounding may let them touch.
    whole = shapely.set_precision(shapely.union_all([shape]), 10.0**-DIGITS)
    return [_corners(part) for polygon in _polygons(whole) for part in _without_holes(polygon)]


def _read_spec(path: Path) -> GridSpec:
    try:
        table: Any = yaml.safe_load(files.read_text(path))
    except OSError as error:
        raise InputError(f"the map {path} cannot be read: {error.strerror or error}") from None
    except (yaml.YAMLError, UnicodeDecodeError):
        table = None
    if not isinstance(table, dict):
        raise InputError(f"the map {path} is no YAML table: it needs image, resolution and origin, as ROS writes it")
    known = {key: value for key, value in table.items() if key in GridSpec.model_fields}
    return parse_table(GridSpec, known, Location(path.name))


def _read_image(path: Path, spec: GridSpec) -> Bool[np.ndarray, "row column"]:
    """Which pixels are occupied, the lowest row first."""
    file = path.parent / spec.image
    try:
        files.check_regular(file)
        with Image.open(file) as image:
            too_large = max(image.size) > LARGEST
            grey = np.zeros((1, 1)) if too_large else np.asarray(image.convert("L"), float) / 255.0
    except (OSError, ValueError) as error:  # ValueError: Pillow's, of a broken header
        raise InputError(f"the image {file} of the map {path.name} cannot be read: {error}") from None
    if too_large:
        raise InputError(f"the image {file} is too large: {LARGEST} pixels a side at most")
    occupied = (grey if spec.negate else 1.0 - grey) > spec.occupied_thresh
    if not occupied.any():
        raise InputError(f"nothing in the image {file} is occupied: no pixel is darker than occupied_thresh")
    return occupied[::-1]


def _boxes(occupied: Bool[np.ndarray, "row column"]) -> list[shapely.Polygon]:
    """A box around each run of occupied pixels in a row, in pixels."""
    padded = np.pad(occupied, ((0, 0), (1, 1))).astype(np.int8)
    row, start = np.nonzero(np.diff(padded, axis=1) == 1)
    _, stop = np.nonzero(np.diff(padded, axis=1) == -1)
    return shapely.box(start, row, stop, row + 1).tolist()


def _polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    parts = [part for part in getattr(shape, "geoms", [shape]) if isinstance(part, shapely.Polygon)]
    return [part for part in parts if not part.is_empty]


def _without_holes(polygon: shapely.Polygon) -> list[shapely.Polygon]:
    """A polygon cut from bottom to top through the middle of its first hole, and so on until none is left."""
    if not polygon.interiors:
        return [polygon]
    middle = round((polygon.interiors[0].bounds[0] + polygon.interiors[0].bounds[2]) / 2, DIGITS)
    left, low, right, high = polygon.bounds
    halves = shapely.box(left - 1, low - 1, middle, high + 1), shapely.box(middle, low - 1, right + 1, high + 1)
    parts = [part for half in halves for part in _polygons(polygon.intersection(half))]
    return [piece for part in parts for piece in _without_holes(part)]


def _corners(polygon: shapely.Polygon) -> Polygon:
    corners = np.round(np.asarray(polygon.exterior.coords)[:-1], DIGITS)
    return [[float(x), float(y)] for x, y in corners]
