"""Shows a recording in the Rerun viewer."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable
from pathlib import Path

from rerun.chunk import LazyChunkStream, RrdReader, StoreEntry

from crowdbench.errors import InputError
from crowdbench.record import drawing, exact, rrd, viewer
from crowdbench.record.blueprint import blueprint
from crowdbench.record.plots import logged_curves

NAME = re.compile(r"[a-z]+-(\d+)-[a-z_]+(-[0-9a-f]+)?")
"""The name of an episode's recording in the viewer: split, case, outcome, and what tells the run from others."""


def view(
    path: Path,
    case: int | None = None,
    screenshot: Path | None = None,
    *,
    seconds: float | None = None,
    web: bool = False,
) -> None:
    """Open a recording in the Rerun viewer and wait until it is closed.

    Args:
        path: The recording.
        case: Number of the only case to show.
        screenshot: Path of a .png file: write a picture of the case instead of opening a window.
        seconds: The time in the case that is shown first; its end if None.
        web: Whether to open it in a browser instead of a window.

    Raises:
        InputError: The file or the case does not exist, or the viewer does not start.
    """
    if screenshot is not None and (case is None or screenshot.suffix != ".png" or not screenshot.parent.is_dir()):
        raise InputError(f"a picture shows one case (--case 37) and goes to a .png file in a folder, not {screenshot}")
    if seconds is not None and (case is None or web):
        raise InputError("--time shows a moment of one case (--case 37), in a window or a picture, not with --web")
    with tempfile.TemporaryDirectory() as folder:
        shown = _extract(path, case, Path(folder), is_picture=screenshot is not None)
        if screenshot is None:
            viewer.show(shown, seconds, web=web)
        else:
            viewer.picture(shown, screenshot, seconds)


def recorded_cases(path: Path) -> list[int]:
    """The numbers of the cases in a recording. Raises InputError where it cannot be read, or is none of crowdbench."""
    return sorted(_entries(path)[1])


def _entries(path: Path) -> tuple[RrdReader, dict[int, StoreEntry]]:
    """A recording, and the recording of each case in it."""
    with rrd.opening(path):
        reader = RrdReader(path)
        named = [(NAME.fullmatch(entry.recording_id), entry) for entry in reader.recordings()]
    entries = {int(match[1]): entry for match, entry in named if match}
    if not entries:
        raise rrd.foreign(path)
    return reader, entries


def _extract(path: Path, case: int | None, folder: Path, *, is_picture: bool) -> Path:
    """Make a file of one case with its own blueprint.

    Args:
        path: The recording.
        case: Number of the case; None for the whole recording.
        folder: Where to write the file.
        is_picture: Whether it is for a picture, which needs no menu.

    Returns:
        The file; the recording itself where `case` is None.

    Raises:
        InputError: The recording cannot be read, has no such case, or the file cannot be written.
    """
    reader, entries = _entries(path)
    if case is None:
        return path.resolve()
    if case not in entries:
        near = sorted(sorted(entries, key=lambda other: abs(other - case))[:10])
        raise InputError(
            f"case {case} is not recorded in {path}: recorded near it are {_ranges(near)} (all are with --record all)"
        )
    with rrd.opening(path):
        chunks = rrd.chunks_of(reader, entries[case], "/**")
    episode, entry = exact.episode(chunks), entries[case]
    trace = exact.trace([episode], exact.facts_of(episode))
    fastest = float(trace.preferred_speed[0, 0])
    shown = blueprint([drawing.extent(trace, 0)], logged_curves(chunks), fastest, has_menu=not is_picture)
    with rrd.writing(f"a copy of case {case} in {folder}"):
        LazyChunkStream.from_iter(chunks).write_rrd(
            folder / "case.rrd", application_id=entry.application_id, recording_id=entry.recording_id
        )
        return rrd.join(folder, ["case.rrd"], entry.application_id, shown)


def _ranges(numbers: Iterable[int]) -> str:
    """Numbers as ranges, such as 0-9, 12, 17-18."""
    known = set(numbers)
    starts = sorted(n for n in known if n - 1 not in known)
    ends = sorted(n for n in known if n + 1 not in known)
    return ", ".join(f"{a}-{b}" if a < b else f"{a}" for a, b in zip(starts, ends, strict=True))
