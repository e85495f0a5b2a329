"""Formats of recordings by name, the values of `tracks.format`: the reader of each, and its files.

The readers of data sets follow the published descriptions of their files:

sdd    Stanford Drone Dataset (Robicquet et al. 2016): a line `track xmin ymin xmax ymax frame lost occluded generated
       "label"` for each box in pixels, 30 frames per second
ind    inD (Bock et al. 2020), also rounD, uniD: `NN_tracks.csv` in metres, `NN_tracksMeta.csv`, `NN_recordingMeta.csv`
jrdb   JRDB (Martín-Martín et al. 2021): `labels_3d/SEQUENCE.json`, boxes in the robot's frame, 15 frames per second
csv    a table with a header
"""

from __future__ import annotations

import csv
import logging
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.scenario.tracks.eth_ucy import FARTHEST, read_tracks
from crowdbench.scenario.tracks.recorded_tracks import FRAME_STEP, RecordedTracks, check_speeds, split_reused_numbers
from crowdbench.scenario.tracks.tables import Labels, read_numbers
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

SDD_COLUMNS = ("track", "xmin", "ymin", "xmax", "ymax", "frame", "lost", "occluded", "generated", "label")
SDD_RATE, JRDB_RATE = 30.0, 15.0
"""Frames per second."""

CSV_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "time": ("t", "time", "time_s", "timestamp", "seconds", "frame"),
    "id": ("id", "track_id", "trackid", "pedestrian", "pedestrian_id", "ped_id", "person", "person_id", "agent_id"),
    "x": ("x", "pos_x", "x_m"),
    "y": ("y", "pos_y", "y_m"),
}
"""Names of the columns of a CSV file that are read. Others are ignored."""

TICKS = 1_000_000
"""Times are stored in whole microseconds."""

_LOG = logging.getLogger(__name__)


class TrackFormat(NamedTuple):
    """A format of recordings.

    Attributes:
        files: Names of the files of a recording; `{}` is the name of the scene.
        read: Function from the paths of these files, the metres of a unit, and the units of time per second. The
            latter two are None if the user states nothing.
    """

    files: tuple[str, ...]
    read: Callable[[Sequence[Path], float | None, float | None], RecordedTracks]


def read_sdd(paths: Sequence[Path], scale: float | None, frame_rate: float | None) -> RecordedTracks:
    """Read the pedestrians of a video of SDD. Boxes outside the image are left out, and y points up in the result."""
    path = paths[0]
    if scale is None:
        raise InputError(f"{path} has positions in pixels: set tracks.scale, the metres of a pixel in this video")
    table, labels = read_numbers(path, SDD_COLUMNS[:7], "label", names=SDD_COLUMNS, separators=" .")
    middle = np.stack([table["xmin"] + table["xmax"], -(table["ymin"] + table["ymax"])], axis=1) / 2.0
    kept = _pedestrians(path, table["track"], labels, "Pedestrian") & (table["lost"] == 0)
    return _recording(path, kept, table["frame"], table["track"], scale * middle, frame_rate or SDD_RATE)


def read_ind(paths: Sequence[Path], scale: float | None, frame_rate: float | None) -> RecordedTracks:
    """Read the pedestrians of a recording of inD."""
    path, of_tracks, of_recording = paths
    table, _ = read_numbers(path, ("trackId", "frame", "xCenter", "yCenter"))
    tracks, classes = read_numbers(of_tracks, ("trackId",), "class")
    walking = tracks["trackId"][_pedestrians(of_tracks, tracks["trackId"], classes, "pedestrian")]
    rate = frame_rate or float(read_numbers(of_recording, ("frameRate",))[0]["frameRate"][0])
    if rate <= 0.0:
        raise InputError(f"{of_recording}: frameRate is {rate:g}, but must be above 0")
    position = (scale or 1.0) * np.stack([table["xCenter"], table["yCenter"]], axis=1)
    return _recording(path, np.isin(table["trackId"], walking), table["frame"], table["trackId"], position, rate)


def read_jrdb(paths: Sequence[Path], scale: float | None, frame_rate: float | None) -> RecordedTracks:
    """Read the pedestrians of a sequence of JRDB, in the frame of its robot. A warning is logged."""
    path = paths[0]
    boxes: dict[str, Any] = _labels_of(path)
    rows = []
    try:
        for frame, here in boxes.items():
            number = int(Path(frame).stem)
            rows += [(number, int(it["label_id"].split(":")[1]), it["box"]["cx"], it["box"]["cy"]) for it in here]
        table = np.array(rows, np.float64).reshape(-1, 4)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError):
        raise InputError(
            f'{path}: frame {frame} must be a list of boxes such as {{"label_id": "pedestrian:3", "box": {{"cx": 1.0, '
            '"cy": 2.0}}'
        ) from None
    _LOG.warning(
        "%s: JRDB states positions relative to the robot: these are tracks only where the robot stands still", path
    )
    kept = np.ones(len(table), bool)
    return _recording(path, kept, table[:, 0], table[:, 1], (scale or 1.0) * table[:, 2:], frame_rate or JRDB_RATE)


def _labels_of(path: Path) -> dict[str, Any]:
    try:
        content = files.read_json(path)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    boxes = content.get("labels") if isinstance(content, dict) else None
    if not isinstance(boxes, dict):
        raise InputError(f'{path} must be a table {{"labels": {{"000000.pcd": [...]}}}}, as in labels_3d of JRDB')
    return boxes


def read_csv(paths: Sequence[Path], scale: float | None, frame_rate: float | None) -> RecordedTracks:
    """Read a table with a header, see `CSV_COLUMNS`. Columns are separated by commas, semicolons or tabs."""
    path = paths[0]
    first, sample = _first_lines(path)
    separator = max(",;\t", key=first.count)
    header = [name.strip().lower() for name in next(csv.reader([first], delimiter=separator), [])]
    found = {kind: next((name for name in names if name in header), "") for kind, names in CSV_COLUMNS.items()}
    if not all(found.values()):
        allowed = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in CSV_COLUMNS.items())
        raise InputError(f"{path} begins with {first[:80]!r}, but must begin with the names of its columns, {allowed}")
    time, person, x, y = found.values()
    if time == "frame" and frame_rate is None:
        raise InputError(f"{path} has a column frame and no times: set tracks.frame_rate, the frames per second")
    decimal = "," if separator != "," and re.search(r"\d,\d", sample) else "."
    columns = [name if header.index(name) == i else f"again {i}" for i, name in enumerate(header)]
    table, labels = read_numbers(path, (time, x, y), person, names=columns, skip=1, separators=separator + decimal)
    position = (scale or 1.0) * np.stack([table[x], table[y]], axis=1)
    if "" in labels.texts:
        raise InputError(f"{path}: a row has no {person}, but each position must be of a pedestrian")
    # By length first, so that pedestrians are numbered in the same order as whole numbers, in any order of the rows.
    order = sorted(range(len(labels.texts)), key=lambda i: (len(labels.texts[i]), labels.texts[i]))
    number = np.argsort(order)[labels.number]
    return _recording(path, np.ones(len(position), bool), table[time], number, position, frame_rate or 1.0)


def _first_lines(path: Path) -> tuple[str, str]:
    """Return the first line of a text, and some of the others."""
    try:
        files.check_regular(path)
        with path.open(encoding="utf-8-sig") as file:
            return file.readline(10_000).rstrip("\n"), file.read(100_000)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file in UTF-8, but tracks are a table with a header") from None


def _pedestrians(path: Path, track: Float[np.ndarray, "row"], labels: Labels, wanted: str) -> Bool[np.ndarray, "row"]:
    """Return the rows of pedestrians. The number of other tracks is logged by their label."""
    first = np.unique(track, return_index=True)[1]
    others = Counter(labels.texts[number] for number in labels.number[first].tolist())
    del others[wanted]
    if others:
        counts = ", ".join(f"{number} {label}" for label, number in sorted(others.items()))
        _LOG.warning("%s: tracks that are no pedestrians are left out: %s", path, counts)
    return np.array([text == wanted for text in labels.texts])[labels.number]


def _recording(
    path: Path,
    kept: Bool[np.ndarray, "row"],
    time: Float[np.ndarray, "row"],
    number: Float[np.ndarray, "row"] | Int[np.ndarray, "row"],
    position: Float[np.ndarray, "row 2"],
    rate: float,
) -> RecordedTracks:
    """Return the tracks of a file.

    Args:
        kept: The rows that are used.
        time: Times, `rate` of them per second.
        number: The pedestrian of each row.
        position: Positions in metres.

    Raises:
        InputError: There is no row, a value is too large, a row is there twice, or speeds are impossible.
    """
    if not kept.any():
        raise InputError(f"{path} has no positions of pedestrians")
    seconds, number, position = (values[kept] for values in (time / rate, number, position))
    if not (np.abs(seconds) < 2**53 / TICKS).all():
        wrong = f"{path}: a time is {np.abs(seconds).max():g} s, but must be below {2**53 / TICKS:g} s"
        raise InputError(f"{wrong}: if these are no seconds, set tracks.frame_rate, the units of time per second")
    if not (np.abs(position) <= FARTHEST).all():
        wrong = f"{path}: a coordinate is {np.abs(position).max():g} m, but must be {FARTHEST:g} m at most"
        raise InputError(f"{wrong}: if these are no metres, set tracks.scale, the metres of a pixel or other unit")
    tick = np.rint(TICKS * seconds).astype(np.int64)
    order = np.lexsort((tick, number))
    pedestrian = np.unique(number, return_inverse=True)[1][order]
    tracks = RecordedTracks(str(path), tick[order], pedestrian, position[order], FRAME_STEP / TICKS)
    again = np.flatnonzero((np.diff(tracks.frame) == 0) & (np.diff(tracks.pedestrian) == 0))
    for row in again[:1].tolist():
        raise InputError(
            f"{path}: a pedestrian has two positions at {tracks.seconds[row]:g} s, and there are {len(again)} such "
            "pairs, but each time of a pedestrian must be there once"
        )
    check_speeds(tracks)
    return split_reused_numbers(tracks)


def _read_eth_ucy(paths: Sequence[Path], scale: float | None, frame_rate: float | None) -> RecordedTracks:
    return read_tracks(paths[0], scale or 1.0, frame_rate)


FORMATS: Mapping[str, TrackFormat] = {
    "eth_ucy": TrackFormat(("{}.txt",), _read_eth_ucy),
    "csv": TrackFormat(("{}.csv",), read_csv),
    "sdd": TrackFormat(("{}/annotations.txt",), read_sdd),
    "ind": TrackFormat(("{}_tracks.csv", "{}_tracksMeta.csv", "{}_recordingMeta.csv"), read_ind),
    "jrdb": TrackFormat(("{}.json",), read_jrdb),
}

DEFAULT = "eth_ucy"
"""The format of files without `tracks.format`."""
