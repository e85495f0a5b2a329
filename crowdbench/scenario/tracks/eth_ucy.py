"""Recorded tracks of real pedestrians, in the usual format of ETH/UCY.

A file has one line for each pedestrian in each annotated frame: frame, pedestrian, x and y in metres, separated by
tabs or spaces. Lines may come in any order.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from crowdbench.utils import files
from crowdbench.utils.errors import InputError

FRAME_STEP = 10
"""Difference between the numbers of two consecutive annotated frames."""

ETH_UCY_DT = 0.4
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

FARTHEST = 1e7
"""The largest coordinate in metres: coordinates of maps are smaller."""

LONGEST_ABSENCE = 4.0
"""Seconds without an annotation after which a number denotes another pedestrian."""

FASTEST = 10.0
"""Speed in m/s above which two annotations belong to two pedestrians. The largest speed in ETH/UCY is 6.5 m/s."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecordedTracks:
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
    dt: float = ETH_UCY_DT


def read_tracks(path: Path) -> RecordedTracks:
    """Read a recording, and give each pedestrian a unique number.

    Raises:
        InputError: The file cannot be read or has another format; the message contains the line.
    """
    try:
        lines = files.read_text(path).split("\n")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file, but tracks are lines of {', '.join(COLUMNS)}") from None
    rows = {n: _read_line(f"{path}, line {n}", line.split()) for n, line in enumerate(lines, 1) if line.strip()}
    if not rows:
        raise InputError(f"{path} is empty, but must have a line {', '.join(COLUMNS)} for each position")
    number, table = list(rows), np.array(list(rows.values()))
    frame, pedestrian = table[:, :2].astype(np.int64).T
    for row in np.flatnonzero((frame - frame[0]) % FRAME_STEP)[:1].tolist():
        raise InputError(
            f"{path}, line {number[row]}: frame {frame[row]} is not on the grid of the first one, {frame[0]}: "
            f"frames must be multiples of {FRAME_STEP} apart"
        )
    order = np.lexsort((frame, pedestrian))
    tracks = RecordedTracks(path.stem, frame[order], pedestrian[order], table[order, 2:])
    is_again = (np.diff(tracks.frame) == 0) & (np.diff(tracks.pedestrian) == 0)
    for row, again in zip(order[:-1][is_again], order[1:][is_again], strict=True):
        raise InputError(
            f"{path}, line {number[again]}: pedestrian {pedestrian[again]} is in frame {frame[again]} a second time, "
            f"after line {number[row]}, but must be there once"
        )
    return split_reused_numbers(tracks)


def split_reused_numbers(tracks: RecordedTracks) -> RecordedTracks:
    """Give a new number to each pedestrian that has the number of an earlier one.

    Two annotations with one number belong to two pedestrians if more than `LONGEST_ABSENCE` lies between them, or if
    the speed between them is above `FASTEST`. A warning with the number of new tracks is logged.
    """
    seconds = np.diff(tracks.frame) / FRAME_STEP * tracks.dt
    distance = np.hypot(*np.diff(tracks.position, axis=0).T)
    is_other = (seconds > LONGEST_ABSENCE) | (distance > FASTEST * seconds)
    splits = 1 + np.flatnonzero(is_other & (np.diff(tracks.pedestrian) == 0))
    if not len(splits):
        return tracks
    _LOG.warning(
        "%s: %d tracks were split where a pedestrian was absent for more than %g s or faster than %g m/s",
        tracks.name,
        len(splits),
        LONGEST_ABSENCE,
        FASTEST,
    )
    pedestrian = tracks.pedestrian.copy()
    ends = np.append(1 + np.flatnonzero(np.diff(tracks.pedestrian)), len(pedestrian))
    for number, first in enumerate(splits, pedestrian.max() + 1):
        pedestrian[first : ends[np.searchsorted(ends, first, side="right")]] = number
    order = np.lexsort((tracks.frame, pedestrian))
    return dataclasses.replace(
        tracks, frame=tracks.frame[order], pedestrian=pedestrian[order], position=tracks.position[order]
    )


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
