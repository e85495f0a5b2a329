"""Obstacles from an occupancy grid in the format of ROS (package `map_server`): `map.yaml` and an image."""

from __future__ import annotations

import itertools
import re
import warnings
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
import yaml
from jaxtyping import Bool, Float
from PIL import Image
from pydantic import Field
from shapely import affinity

from crowdbench.utils import files
from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import Location, Name, TomlTable, choice, number, parse_table

Polygon = list[list[float]]
"""The corners of a polygon in metres."""

DIGITS = 3
"""Coordinates are rounded to millimetres."""

LARGEST = 4096
"""Largest number of pixels of an image's side."""

MOST_CORNERS = 2000
"""Largest total number of corners of the obstacles: shortest paths are searched among them."""

MOST_TURNS = 30_000
"""Largest number of corners of pixel outlines: the time to simplify them grows with the square of their number."""

FEW_CORNERS = 12
"""Outlines with this number of corners at most are exact."""

SHORT = 2.0
"""Length in pixels: bumps and notches of one pixel are noise if they are no wider."""

WHITE = {"L": 255.0, "RGB": 255.0, "RGBA": 255.0, "I;16": 65535.0, "I": 65535.0}
"""The value of white, by the mode of an image as Pillow reads it. Pillow scales a PGM of more than 8 bits to 16."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
    """Loader of YAML 1.1, with the numbers of YAML 1.2 that PyYAML reads as text, such as `5e-2`."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$"), [*"-+0123456789"]
)


class GridSpec(TomlTable):
    """The file `map.yaml`, read as nav2's `map_server` does. Other keys are ignored.

    The brightness of a pixel is the mean of its colours, from 0 (black) to 1 (white). Its occupancy is 1 - brightness,
    or the brightness with `negate`.

    Attributes:
        origin: Position of the lower left corner of the image in metres, and its angle in radians.
        mode: With `trinary`, a pixel is occupied if its occupancy is above `occupied_thresh`, and the opacity of an
            image counts as a fourth colour. With `scale`, a pixel that is not opaque is unknown. With `raw`, the value
            of a pixel of 8 bits is its occupancy in per cent, and a value above 100 is unknown.
        free_thresh: A pixel with a lower occupancy is free. Between both thresholds it is unknown, and no obstacle.
    """

    image: Name
    resolution: float = number(above=0.0, below=1000.0)
    origin: list[float] = Field(
        min_length=2, max_length=3, description="two or three numbers: x and y in metres, and an angle in radians"
    )
    mode: str = choice(["trinary", "scale", "raw"], "trinary")
    occupied_thresh: float = number(0.65, least=0.0, below=1.0)
    free_thresh: float = number(0.0, least=0.0, below=1.0)
    negate: bool | Annotated[int, Field(ge=0, le=1)] = Field(False, description="0, 1, false or true")


def read_obstacles(path: Path) -> list[Polygon]:
    """Return the obstacles of an occupancy grid: polygons around its occupied pixels, in its frame.

    Edges along rows and columns of pixels are exact. Only steps of one pixel, as of slanted walls and of noise, are
    simplified, by at most the resolution. Polygons with holes are cut into parts without holes.

    Args:
        path: The file `map.yaml`. Its image is in the same folder: PGM, PNG, or another format that Pillow reads.

    Raises:
        InputError: One of the two files is missing or wrong.
    """
    spec = _read_spec(path)
    occupied = _read_image(path, spec)
    if (turns := _count_turns(occupied)) > MOST_TURNS:
        most = f"but {MOST_TURNS} are possible before it is simplified: use a coarser image, or one with less noise"
        raise InputError(f"the outline of the map {path} has {turns} corners, {most}")
    shape = _simplify(shapely.union_all(_boxes(occupied)))
    if (corners := shapely.get_num_coordinates(shape)) > MOST_CORNERS:
        raise InputError(f"the map {path} has {corners} corners, but {MOST_CORNERS} are possible: use a coarser image")
    shape = affinity.scale(shape, spec.resolution, spec.resolution, origin=(0.0, 0.0))
    if len(spec.origin) == 3:
        shape = affinity.rotate(shape, spec.origin[2], origin=(0.0, 0.0), use_radians=True)
    shape = affinity.translate(shape, *spec.origin[:2])
    # After simplification, separate polygons may cross, and after rounding they may touch.
    whole = shapely.set_precision(shapely.union_all([shape]), 10.0**-DIGITS)
    return [_corners(part) for polygon in _polygons(whole) for part in _without_holes(polygon)]


def _read_spec(path: Path) -> GridSpec:
    try:
        table: Any = yaml.load(files.read_text(path), _Loader)
    except OSError as error:
        raise InputError(f"the map {path} cannot be read: {error.strerror or error}") from None
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError):  # ValueError: a date such as 2026-13-40
        table = None
    if not isinstance(table, dict):
        raise InputError(f"the map {path} is no YAML table: it needs image, resolution and origin, as ROS writes it")
    known = {key: value for key, value in table.items() if key in GridSpec.model_fields}
    spec = parse_table(GridSpec, known, Location(path.name))
    if spec.free_thresh >= spec.occupied_thresh:
        right = f"below occupied_thresh, {spec.occupied_thresh:g}"
        raise Location(path.name).at("free_thresh").wrong(f"{spec.free_thresh:g}", right)
    return spec


def _read_image(path: Path, spec: GridSpec) -> Bool[np.ndarray, "row column"]:
    """Return the occupied pixels, the lowest row first."""
    file = path.parent / spec.image
    large = f"the image {file} is too large: {LARGEST} pixels a side at most"
    try:
        files.check_regular(file)
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(file) as image:
                if max(image.size) > LARGEST:
                    raise InputError(large)
                occupied = _find_occupied(image, spec)
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        raise InputError(large) from None
    except (OSError, ValueError, SyntaxError) as error:  # the last two: Pillow, for a broken header
        raise InputError(f"the image {file} of the map {path.name} cannot be read: {error}") from None
    if not occupied.any():
        raise InputError(f"nothing in {file} is occupied: no pixel is above occupied_thresh with mode {spec.mode}")
    return occupied[::-1]


def _find_occupied(image: Image.Image, spec: GridSpec) -> Bool[np.ndarray, "row column"]:
    """Return the occupied pixels of an image, by the rules of nav2 (`map_io.cpp`)."""
    if image.mode not in WHITE:
        image = image.convert("RGBA" if image.has_transparency_data else "RGB")
    levels = np.atleast_3d(np.asarray(image, float) / WHITE[image.mode])
    brightness = levels.mean(2) if spec.mode == "trinary" else levels[..., :3].mean(2)
    if spec.mode == "raw":
        occupancy = np.round(255.0 * brightness) / 100.0
        return (occupancy > spec.occupied_thresh) & (occupancy <= 1.0)
    opaque = levels[..., -1] == 1.0 if spec.mode == "scale" and image.mode == "RGBA" else True
    return ((brightness if spec.negate else 1.0 - brightness) > spec.occupied_thresh) & opaque


def _count_turns(occupied: Bool[np.ndarray, "row column"]) -> int:
    """Count the corners of the outline of pixels; a corner at which two pixels touch diagonally counts twice."""
    padded = np.pad(occupied, 1)
    rows, columns = padded[1:] ^ padded[:-1], padded[:, 1:] ^ padded[:, :-1]
    single = rows[:, 1:] ^ rows[:, :-1]
    double = rows[:, 1:] & rows[:, :-1] & columns[1:] & columns[:-1]
    return int(single.sum() + 2 * double.sum())


def _boxes(occupied: Bool[np.ndarray, "row column"]) -> list[shapely.Polygon]:
    """Return a box around each run of occupied pixels in a row, in pixels."""
    padded = np.pad(occupied, ((0, 0), (1, 1))).astype(np.int8)
    row, start = np.nonzero(np.diff(padded, axis=1) == 1)
    _, stop = np.nonzero(np.diff(padded, axis=1) == -1)
    return shapely.box(start, row, stop, row + 1).tolist()


def _simplify(shape: shapely.Geometry) -> shapely.MultiPolygon:
    """Simplify outlines of pixels by one pixel where they have steps of one pixel, and nowhere else."""
    polygons = [[_chains(ring) for ring in (part.exterior, *part.interiors)] for part in _polygons(shape)]
    chains = [chain for rings in polygons for ring in rings for chain in ring]
    # All at once, so that none of them crosses another one.
    simple = iter(shapely.MultiLineString(chains).simplify(1.0).geoms)
    outlines = [[[xy for _ in ring for xy in next(simple).coords[:-1]] for ring in rings] for rings in polygons]
    return shapely.MultiPolygon([(shell, holes) for shell, *holes in outlines])


def _chains(ring: shapely.LinearRing) -> list[Float[np.ndarray, "corner 2"]]:
    """Cut an outline at its exact corners: those that are at no end of a step. Without any, it is one closed chain."""
    corner = np.asarray(ring.normalize().simplify(0.0).coords)[:-1]
    is_step = _find_steps(np.roll(corner, -1, axis=0) - corner)
    exact = np.flatnonzero(~is_step & ~np.roll(is_step, 1))
    first = int(exact[0]) if len(exact) else 0
    corner = np.roll(corner, -first, axis=0)
    closed = np.concatenate([corner, corner[:1]])
    cuts = (exact - first).tolist() or [0]
    return [closed[start : stop + 1] for start, stop in itertools.pairwise([*cuts, len(corner)])]


def _find_steps(edge: Float[np.ndarray, "edge 2"]) -> Bool[np.ndarray, "edge"]:
    """Return which edges of an outline are noise: steps of one pixel beside a short edge, or in a slanted line."""
    if len(edge) <= FEW_CORNERS:
        return np.zeros(len(edge), bool)
    before, after = np.roll(edge, 1, axis=0), np.roll(edge, -1, axis=0)
    is_jog = (np.abs(edge).sum(axis=1) == 1.0) & (np.sign(before) == np.sign(after)).all(axis=1)
    is_short = np.minimum(np.abs(before).sum(axis=1), np.abs(after).sum(axis=1)) <= SHORT
    goes_on = is_jog & np.roll(is_jog, 2) & (np.roll(edge, 2, axis=0) == edge).all(axis=1)
    return is_jog & (is_short | goes_on | np.roll(goes_on, -2))


def _polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    parts = [part for part in getattr(shape, "geoms", [shape]) if isinstance(part, shapely.Polygon)]
    return [part for part in parts if not part.is_empty]


def _without_holes(polygon: shapely.Polygon) -> list[shapely.Polygon]:
    """Cut a polygon from bottom to top through the middle of one of its holes, until no part has a hole.

    The median hole is cut first, so that the recursion depth grows with the logarithm of the number of holes.
    """
    if not polygon.interiors:
        return [polygon]
    hole = sorted(polygon.interiors, key=lambda ring: ring.bounds)[len(polygon.interiors) // 2]
    middle = round((hole.bounds[0] + hole.bounds[2]) / 2, DIGITS)
    left, low, right, high = polygon.bounds
    halves = shapely.box(left - 1, low - 1, middle, high + 1), shapely.box(middle, low - 1, right + 1, high + 1)
    parts = [part for half in halves for part in _polygons(polygon.intersection(half))]
    return [piece for part in parts for piece in _without_holes(part)]


def _corners(polygon: shapely.Polygon) -> Polygon:
    corners = np.round(np.asarray(polygon.exterior.coords)[:-1], DIGITS)
    return [[float(x), float(y)] for x, y in corners]
