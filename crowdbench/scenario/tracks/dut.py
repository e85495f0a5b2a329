"""Clips of DUT: tracks of pedestrians and of cars among them (Yang et al. 2019).

Of each clip there are `<clip>_traj_ped_filtered.csv`, `<clip>_traj_veh_filtered.csv` and
`<clip>_ratio_pixel2meter.txt`. Positions are pixels of the image, whose y points down.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench.scenario.tracks.recorded_tracks import FRAME_STEP, RecordedTracks
from crowdbench.scenario.tracks.tables import read_numbers
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

FRAMES_PER_SECOND = 23.98

PEDESTRIANS, CARS, RATIO = "_traj_ped_filtered.csv", "_traj_veh_filtered.csv", "_ratio_pixel2meter.txt"
"""Ends of the names of a clip's files."""

_CORNERS = ("fl", "fr", "rr", "rl")
"""Corners from front left to rear left, as in the names of the columns `x_fl`, `y_fl`, ..."""


@dataclass(frozen=True)
class Car:
    """A recorded car.

    Attributes:
        time: Times of its positions in seconds, on the time axis of `RecordedTracks`.
        position: Positions of its middle in metres.
        heading: Its headings in radians, without jumps of a whole turn.
        length: Its length in metres.
        width: Its width in metres.
    """

    time: Float[np.ndarray, "row"]
    position: Float[np.ndarray, "row 2"]
    heading: Float[np.ndarray, "row"]
    length: float
    width: float


def read_clip(folder: Path, clip: str) -> tuple[RecordedTracks, list[Car]]:
    """Return the pedestrians and the cars of a clip. Raises InputError if a file cannot be read or has another
    format."""
    ratio = _ratio(folder / f"{clip}{RATIO}")
    people = _columns(folder / f"{clip}{PEDESTRIANS}", ("id", "frame", "x_est", "y_est"))
    frame, number = people["frame"].astype(np.int64), people["id"].astype(np.int64)
    position = _metres(people, "x_est", "y_est", ratio)
    tracks = RecordedTracks(clip, frame * FRAME_STEP, number, position, 1.0 / FRAMES_PER_SECOND)
    corners = [f"{axis}_{corner}" for corner in _CORNERS for axis in "xy"]
    cars = _columns(folder / f"{clip}{CARS}", ("id", "frame", "x_est", "y_est", *corners))
    return tracks, [_car(cars, cars["id"] == number, ratio) for number in np.unique(cars["id"])]


def _car(table: dict[str, np.ndarray], rows: np.ndarray, ratio: float) -> Car:
    rows_of_car = {name: values[rows] for name, values in table.items()}
    corner = {name: _metres(rows_of_car, f"x_{name}", f"y_{name}", ratio) for name in _CORNERS}
    front, rear = (corner["fl"] + corner["fr"]) / 2.0, (corner["rl"] + corner["rr"]) / 2.0
    ahead, across = front - rear, corner["fl"] - corner["fr"]
    return Car(
        time=rows_of_car["frame"] / FRAMES_PER_SECOND,
        position=_metres(rows_of_car, "x_est", "y_est", ratio),
        heading=np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])),
        length=float(np.median(np.hypot(*ahead.T))),
        width=float(np.median(np.hypot(*across.T))),
    )


def _metres(table: dict[str, np.ndarray], x: str, y: str, ratio: float) -> Float[np.ndarray, "row 2"]:
    return np.stack([table[x], -table[y]], axis=1) / ratio


def _ratio(path: Path) -> float:
    """Return the pixels per metre."""
    ratio = math.nan
    with contextlib.suppress(OSError, ValueError):  # it cannot be read, or contains no number or no text
        ratio = float(files.read_text(path))
    if not 0.0 < ratio < 1e6:
        raise InputError(f"{path} must hold one number, the pixels of a metre")
    return ratio


def _columns(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return columns of a table with a header, as numbers; its rows ordered by `id`, then by `frame`."""
    columns, _ = read_numbers(path, names)
    order = np.lexsort((columns["frame"], columns["id"]))
    return {name: values[order] for name, values in columns.items()}
