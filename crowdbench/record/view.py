"""Shows a recording in the Rerun viewer."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb
from rerun.chunk import Chunk, LazyChunkStream, RrdReader, StoreEntry

from crowdbench.errors import InputError
from crowdbench.record import drawing, exact, rrd, viewer
from crowdbench.record.blueprint import blueprint, side_by_side
from crowdbench.record.plots import logged_curves
from crowdbench.types import Outcome, Trace

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
    _check(case, screenshot, seconds, web)
    with tempfile.TemporaryDirectory() as folder:
        if case is None:
            _entries(path)
            shown = path.resolve()
        else:
            shown = _extract(path, case, Path(folder), is_picture=screenshot is not None)
        _show(shown, screenshot, seconds, web)


def _check(case: int | None, screenshot: Path | None, seconds: float | None, web: bool) -> None:
    """Raises InputError where the arguments of `view` do not fit each other."""
    if screenshot is not None and (case is None or screenshot.suffix != ".png" or not screenshot.parent.is_dir()):
        raise InputError(f"a picture shows one case (--case 37) and goes to a .png file in a folder, not {screenshot}")
    if seconds is not None and (case is None or web):
        raise InputError("--time shows a moment of one case (--case 37), in a window or a picture, not with --web")


def _show(file: Path, screenshot: Path | None, seconds: float | None, web: bool) -> None:
    """Open a file in the viewer, or take a picture of it. The arguments are those of `view`."""
    if screenshot is None:
        viewer.show(file, seconds, web=web)
    else:
        viewer.picture(file, screenshot, seconds)


def view_beside(
    paths: Sequence[Path], case: int, screenshot: Path | None = None, *, seconds: float | None = None, web: bool = False
) -> None:
    """Open the same case of several recordings side by side, and wait until the viewer is closed.

    Args:
        paths: The recordings.
        case: Number of the case.
        screenshot: As in `view`.
        seconds: As in `view`.
        web: As in `view`.

    Raises:
        InputError: As in `view`, or the case does not start alike in all recordings.
    """
    _check(case, screenshot, seconds, web)
    found = [_episode(path, case) for path in paths]
    first, *others = (one.trace for one in found)
    for path, other in zip(paths[1:], others, strict=True):
        there = other.split, other.rules.dt, other.position[:, 0].shape
        if there != (first.split, first.rules.dt, first.position[:, 0].shape) or not np.array_equal(
            other.position[:, 0], first.position[:, 0], equal_nan=True
        ):
            raise InputError(f"case {case} starts otherwise in {path} than in {paths[0]}: give runs of one scenario")
    with tempfile.TemporaryDirectory() as folder:
        chunks = [
            chunk.with_entity_path(f"/{n}{chunk.entity_path}")
            for n, one in enumerate(found)
            for chunk in one.chunks
            if chunk.entity_path.startswith(("/world", "/plots"))
        ]
        names = [f"{one.planner}: {Outcome(int(one.trace.outcome[0])).label}" for one in found]
        fastest = max(float(one.trace.preferred_speed[0, 0]) for one in found)
        longest = first.rules.dt * max(int(one.trace.steps[0]) for one in found)
        extents = [drawing.extent(one.trace, 0) for one in found]
        layout = side_by_side(names, extents, fastest, longest, has_menu=screenshot is None)
        name = f"case {case} of {len(paths)} planners"
        shown = _written(chunks, Path(folder), application=name, recording=f"{first.split}-{case:04d}", layout=layout)
        _show(shown, screenshot, seconds, web)


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


@dataclass(frozen=True)
class _Recorded:
    """A recorded episode: its chunks, what they are of, and what the file calls the run and the episode."""

    chunks: list[Chunk]
    trace: Trace
    planner: str
    entry: StoreEntry


def _episode(path: Path, case: int) -> _Recorded:
    """One case of a recording. Raises InputError where it cannot be read, or has no such case."""
    reader, entries = _entries(path)
    if case not in entries:
        near = sorted(sorted(entries, key=lambda other: abs(other - case))[:10])
        raise InputError(
            f"case {case} is not recorded in {path}: recorded near it are {_ranges(near)} (all are with --record all)"
        )
    with rrd.opening(path):
        chunks = rrd.chunks_of(reader, entries[case], "/**")
        episode = exact.episode(chunks)
    facts = exact.facts_of(episode)
    return _Recorded(chunks, exact.trace([episode], facts), facts["planner"], entries[case])


def _extract(path: Path, case: int, folder: Path, *, is_picture: bool) -> Path:
    """Make a file of one case with its own blueprint.

    Args:
        path: The recording.
        case: Number of the case.
        folder: Where to write the file.
        is_picture: Whether it is for a picture, which needs no menu.

    Returns:
        The file.

    Raises:
        InputError: The recording cannot be read, has no such case, or the file cannot be written.
    """
    found = _episode(path, case)
    extent, fastest = drawing.extent(found.trace, 0), float(found.trace.preferred_speed[0, 0])
    layout = blueprint([extent], logged_curves(found.chunks), fastest, has_menu=not is_picture)
    entry = found.entry
    return _written(found.chunks, folder, application=entry.application_id, recording=entry.recording_id, layout=layout)


def _written(chunks: Sequence[Chunk], folder: Path, *, application: str, recording: str, layout: rrb.Blueprint) -> Path:
    """Write a file of one recording.

    Args:
        chunks: What it holds.
        folder: Where it is written.
        application: The name under which the viewer lists the file.
        recording: The name of the recording.
        layout: How the viewer shows it.
    """
    with rrd.writing(f"a copy of the case in {folder}"):
        LazyChunkStream.from_iter(chunks).write_rrd(
            folder / "case.rrd", application_id=application, recording_id=recording
        )
        return rrd.join(folder, ["case.rrd"], application, layout)


def _ranges(numbers: Iterable[int]) -> str:
    """Numbers as ranges, such as 0-9, 12, 17-18."""
    known = set(numbers)
    starts = sorted(n for n in known if n - 1 not in known)
    ends = sorted(n for n in known if n + 1 not in known)
    return ", ".join(f"{a}-{b}" if a < b else f"{a}" for a, b in zip(starts, ends, strict=True))
