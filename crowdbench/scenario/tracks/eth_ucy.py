"""Recorded tracks of real pedestrians, in the usual format of ETH/UCY.

A file has one line for each pedestrian in each annotated frame: frame, pedestrian, x and y in metres, separated by
tabs or spaces. Lines may come in any order.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.utils import files
from crowdbench.utils.errors import InputError

FRAME_STEP = 10
"""Difference between the numbers of two consecutive annotated frames."""

DT = 0.4
"""Seconds between two consecutive annotated frames."""

COLUMNS = ("frame", "pedestrian", "x", "y")

SCENES: Mapping[str, tuple[str, ...]] = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""The five scenes of ETH/UCY (Pellegrini et al. 2009, Lerner et al. 2007), each with the files to test on."""

TRAINING_ONLY = ("crowds_zara03", "uni_examples")
"""Files of ETH/UCY that no scene is tested on."""

FARTHEST = 1e7
"""The largest coordinate in metres: coordinates of maps are smaller."""


@dataclass(frozen=True)
class Tracks:
    """The annotations of one recording, a row each, ordered by pedestrian and then by frame.

    Attributes:
        name: The name of the file, without suffix.
        frame: The number of the frame.
        pedestrian: The number of the pedestrian.
        position: Position in metres.
        dt: Seconds between two consecutive annotated frames, whose numbers differ by `FRAME_STEP`.
    """

    name: str
    frame: Int[np.ndarray, "row"]
    pedestrian: Int[np.ndarray, "row"]
    position: Float[np.ndarray, "row 2"]
    dt: float = DT


def read_folder(folder: Path) -> list[Tracks]:
    """The recordings in all `*.txt` files of a folder. Raises InputError where there are none, or one is wrong."""
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder} with recorded tracks")
    files = sorted(folder.glob("*.txt"))
    if not files:
        raise InputError(f"{folder} has no files *.txt with recorded tracks")
    return [read_tracks(path) for path in files]


def read_tracks(path: Path) -> Tracks:
    """A recording. Raises InputError, with the line, where the file cannot be read or has another format."""
    try:
        lines = files.read_text(path).split("\n")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file, but tracks are lines of {', '.join(COLUMNS)}") from None
    table, number = _numbers(path, lines)

    def refuse(wrong: Bool[np.ndarray, "row 4"], right: str, form: str = "") -> None:
        for row, column in np.argwhere(wrong)[:1]:
            found = f"{COLUMNS[column]} is {table[row, column]:{form}}"
            raise InputError(f"{path}, line {number[row]}: {found}, but must be {right}")

    refuse(~np.isfinite(table), "a finite number")
    is_coordinate = np.arange(4) >= 2
    refuse((np.abs(table) > FARTHEST) & is_coordinate, f"in metres, from {-FARTHEST:g} to {FARTHEST:g}", "g")
    is_whole = (table == np.rint(table)) & (np.abs(table) <= 2**53)
    for column in (0, 1):
        refuse(~is_whole & (np.arange(4) == column), "a whole number")
    frame, pedestrian = table[:, :2].astype(np.int64).T
    off = (frame - frame[0]) % FRAME_STEP != 0
    if off.any():
        row = int(np.argmax(off))
        raise InputError(
            f"{path}, line {number[row]}: frame {frame[row]} is not on the grid of the first one, {frame[0]}: "
            f"frames must be multiples of {FRAME_STEP} apart"
        )
    order = np.lexsort((frame, pedestrian))
    tracks = Tracks(path.stem, frame[order], pedestrian[order], table[order, 2:])
    again = (np.diff(tracks.frame) == 0) & (np.diff(tracks.pedestrian) == 0)
    if again.any():
        one, two = order[np.argmax(again) :][:2]
        raise InputError(
            f"{path}, line {number[two]}: pedestrian {pedestrian[two]} is in frame {frame[two]} a second time, after "
            f"line {number[one]}, but must be there once"
        )
    return tracks


def _numbers(path: Path, lines: list[str]) -> tuple[Float[np.ndarray, "row 4"], list[int]]:
    """The numbers in each line that is not blank, and the line's number, from 1. Raises InputError as `read_tracks`."""
    fields = [line.split() for line in lines]
    number = [n for n, found in enumerate(fields, 1) if found]
    rows = [found for found in fields if found]
    if not rows:
        raise InputError(f"{path} is empty, but must have a line {', '.join(COLUMNS)} for each position")
    for n, row in zip(number, rows, strict=True):
        if len(row) != len(COLUMNS):
            raise InputError(
                f"{path}, line {n}: found {len(row)} columns, but there must be {len(COLUMNS)}: "
                f"{', '.join(COLUMNS)}, separated by tabs or spaces"
            )
    return np.array([[_number(path, n, text) for text in row] for n, row in zip(number, rows, strict=True)]), number


def _number(path: Path, line: int, text: str) -> float:
    """A number in a line. Raises InputError where it is not one."""
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{path}, line {line}: {text!r} is not a number") from None


def scenes(recordings: Iterable[Tracks]) -> dict[str, list[Tracks]]:
    """The scenes to test on, by name: those of ETH/UCY whose files are all there, and every other recording."""
    left = {tracks.name: tracks for tracks in recordings if tracks.name not in TRAINING_ONLY}
    whole = {scene: [left.pop(name) for name in names] for scene, names in SCENES.items() if left.keys() >= set(names)}
    return whole | {name: [tracks] for name, tracks in left.items()}
