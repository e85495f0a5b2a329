"""Marks of time along the vehicle's path, with times beside them at free positions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Trace
from crowdbench.drawing import CIRCLE, LIGHT, Disc, Shape, Text

Point = Float[np.ndarray, "2"]
Points = Float[np.ndarray, "point 2"]
Pairs = Float[np.ndarray, "*_ 2 2"]

SECONDS = (2.0, 5.0, 10.0, 20.0)
"""Possible times between two marks. The shortest one with at most `MAX_MARKS` marks is used."""

MAX_MARKS = 8

LETTER = np.array([0.075, 0.12])
"""Width and height in inches of a letter of a time."""

DIRECTIONS = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)], float)
"""Possible directions from a mark to its time, in order of preference."""


def mark_times(trace: Trace, row: int, bounds: Float[np.ndarray, "2 2"], inch: float) -> list[Shape]:
    """Return discs at positions of the vehicle at equal time intervals, each with its time, or two times if it waits.

    A time that would cover another one is left out.

    Args:
        bounds: The smallest and the largest x and y that the picture shows, in metres.
        inch: Metres per inch of the picture.
    """
    end, radius = int(trace.steps[row]), float(trace.radius[row, 0, 0])
    seconds = next((each for each in SECONDS if end * trace.rules.dt <= MAX_MARKS * each), SECONDS[-1])
    step = max(round(seconds / trace.rules.dt), 1)
    waits = list(_group(trace.position[row, :end:step, 0], radius))
    positions = np.array([trace.position[row, first * step, 0] for first, _ in waits])
    discs: list[Shape] = [Disc(mark, radius, None, LIGHT.vehicle) for mark in positions]
    apart, walls = inch * LETTER[1] / 2, trace.obstacles[row].swapaxes(0, 1)
    around = (np.concatenate([positions, trace.position[row, end]])[:, None] + radius * CIRCLE).reshape(-1, 2)
    lines = [_spread(points, apart) for points in (trace.position[row, : end + 1], np.concatenate([walls, walls[:1]]))]
    taken = np.concatenate([*lines, around])
    texts: list[Shape] = []
    boxes = np.empty((0, 2, 2))
    for mark, (first, last) in zip(positions, waits, strict=True):
        text = f"{first * seconds:g} s" if first == last else f"{first * seconds:g} to {last * seconds:g} s"
        half = inch * LETTER * [len(text), 1.0] / 2
        at = _free_place(mark, radius, half, taken, boxes, bounds)
        if at is not None:
            texts.append(Text(at, text, LIGHT.text, halo=LIGHT.background))
            boxes = np.concatenate([boxes, [[at, half]]])
    return [*discs, *texts]


def _group(position: Float[np.ndarray, "mark 2"], radius: float) -> Iterator[tuple[int, int]]:
    """Yield the first and the last mark of each group of marks within a radius of the first one."""
    first = 0
    for mark in range(1, len(position) + 1):
        if mark == len(position) or np.linalg.norm(position[mark] - position[first]) > radius:
            yield first, mark - 1
            first = mark


def _spread(position: Float[np.ndarray, "time agent 2"], apart: float) -> Float[np.ndarray, "point 2"]:
    """Return points along all paths, no farther apart than a length in metres."""
    longest = np.nanmax(np.linalg.norm(np.diff(position, axis=0), axis=-1), initial=0.0)
    parts = np.linspace(0.0, 1.0, max(int(np.ceil(longest / apart)), 1), endpoint=False)
    between = [(1.0 - part) * position[:-1] + part * position[1:] for part in parts]
    points = np.concatenate([*between, position[-1:]]).reshape(-1, 2)
    return points[np.isfinite(points[:, 0])]


def _free_place(mark: Point, radius: float, half: Point, taken: Points, boxes: Pairs, bounds: Pairs) -> Point | None:
    """Return the centre of a text that covers no other text and the fewest taken points; None if there is no space.

    Args:
        mark: The centre of the disc to which the time belongs.
        radius: Its radius in metres.
        half: Half the width and the height of the text.
        taken: Points of other shapes.
        boxes: Centre, and half the size, of the texts before it.
        bounds: The smallest and the largest x and y of the picture.
    """
    shares = np.where(DIRECTIONS.all(axis=1), 0.8, 1.0)[:, None]
    away = radius * DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
    positions = np.concatenate([mark + far * away + half * DIRECTIONS * shares for far in (1.2, 2.0)])
    covered = (np.abs(positions[:, None] - taken) < half).all(axis=-1).sum(axis=1)
    is_free = ((positions - half >= bounds[0]) & (positions + half <= bounds[1])).all(axis=1)
    is_free &= ~(np.abs(positions[:, None] - boxes[:, 0]) < half + boxes[:, 1]).all(axis=-1).any(axis=1)
    return positions[np.argmin(np.where(is_free, covered, np.inf))] if is_free.any() else None
