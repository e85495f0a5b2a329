"""Recorded tracks of real pedestrians, in the usual format of ETH/UCY.

A file has one line for each pedestrian in each annotated frame: frame, pedestrian, x and y in metres, separated by
tabs or spaces. Lines may come in any order.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench.scenario.tracks.recorded_tracks import (
    ETH_UCY_DT,
    FRAME_STEP,
    RecordedTracks,
    check_speeds,
    split_reused_numbers,
)
from crowdbench.scenario.tracks.tables import read_numbers
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

COLUMNS = ("frame", "pedestrian", "x", "y")

SCENES: Mapping[str, tuple[str, ...]] = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""The five scenes of ETH/UCY (Pellegrini et al. 2009, Lerner et al. 2007), each with the files to test on."""

FARTHEST = 1e7
"""The largest coordinate in metres: coordinates of maps are smaller."""


def read_tracks(path: Path, scale: float = 1.0, frame_rate: float | None = None) -> RecordedTracks:
    """Read a recording, and give each pedestrian a unique number.

    Args:
        path: The file.
        scale: Metres of a unit of the file.
        frame_rate: Frames per second. None means 25, and that frames are multiples of `FRAME_STEP` apart.

    Raises:
        InputError: The file cannot be read or has another format, with the line in the message, or speeds are
            impossible.
    """
    table = _read_table(path)
    frame, pedestrian = table[:, :2].astype(np.int64).T
    for row in np.flatnonzero((frame - frame[0]) % FRAME_STEP)[: frame_rate is None].tolist():
        raise InputError(
            f"{path}, line {_line_numbers(path)[row]}: frame {frame[row]} is not on the grid of the first one, "
            f"{frame[0]}: frames must be multiples of {FRAME_STEP} apart, {FRAME_STEP} in {ETH_UCY_DT:g} s, or "
            "tracks.frame_rate must be set"
        )
    order = np.lexsort((frame, pedestrian))
    dt = ETH_UCY_DT if frame_rate is None else FRAME_STEP / frame_rate
    tracks = RecordedTracks(path.stem, frame[order], pedestrian[order], scale * table[order, 2:], dt)
    is_again = (np.diff(tracks.frame) == 0) & (np.diff(tracks.pedestrian) == 0)
    for row, again in zip(order[:-1][is_again], order[1:][is_again], strict=True):
        number = _line_numbers(path)
        raise InputError(
            f"{path}, line {number[again]}: pedestrian {pedestrian[again]} is in frame {frame[again]} a second time, "
            f"after line {number[row]}, but must be there once"
        )
    check_speeds(tracks)
    return split_reused_numbers(tracks)


def _read_table(path: Path) -> Float[np.ndarray, "row 4"]:
    """Return the numbers of a file. Raises InputError with the line of the first wrong one."""
    for separator in "\t ":
        with contextlib.suppress(InputError):
            columns, _ = read_numbers(path, COLUMNS, names=COLUMNS, separators=f"{separator}.")
            table = np.stack([columns[name] for name in COLUMNS], axis=1)
            if _is_valid(table):
                return table
    # Slower, but with the line in errors, and for lines with several separators.
    lines = _read_lines(path)
    if not lines:
        raise InputError(f"{path} is empty, but must have a line {', '.join(COLUMNS)} for each position")
    return np.array([_read_line(f"{path}, line {number}", line.split()) for number, line in lines.items()])


def _is_valid(table: Float[np.ndarray, "row 4"]) -> bool:
    whole, lengths = table[:, :2], table[:, 2:]
    return bool((np.abs(whole) <= 2**53).all() and (whole % 1.0 == 0.0).all() and (np.abs(lengths) <= FARTHEST).all())


def _read_lines(path: Path) -> dict[int, str]:
    """Return the lines that are not blank, by their number. Raises InputError if the file cannot be read."""
    try:
        lines = files.read_text(path).split("\n")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file, but tracks are lines of {', '.join(COLUMNS)}") from None
    return {number: line for number, line in enumerate(lines, 1) if line.strip()}


def _line_numbers(path: Path) -> list[int]:
    """Return the numbers of the lines that are not blank."""
    return list(_read_lines(path))


def _read_line(where: str, fields: list[str]) -> list[float]:
    """Return the numbers in a line. Raises InputError with the location unless each column contains a valid
    number."""
    if len(fields) != len(COLUMNS):
        raise InputError(
            f"{where}: found {len(fields)} columns, but there must be {len(COLUMNS)}: {', '.join(COLUMNS)}, separated "
            "by tabs or spaces"
        )
    numbers = []
    for column, text in zip(COLUMNS, fields, strict=True):
        try:
            number = float(text)
        except ValueError:
            raise InputError(f"{where}: {text!r} is not a number") from None
        is_length = column in ("x", "y")
        right = f"in metres, from {-FARTHEST:g} to {FARTHEST:g}" if is_length else "a whole number"
        if not abs(number) <= (FARTHEST if is_length else 2**53) or not (is_length or number.is_integer()):
            raise InputError(f"{where}: {column} is {number}, but must be {right}")
        numbers.append(number)
    return numbers
