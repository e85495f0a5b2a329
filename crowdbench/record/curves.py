"""Training curves as a Rerun recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from crowdbench.files import whole
from crowdbench.record import rrd


def write(path: Path, title: str, points: Sequence[Mapping[str, float]]) -> None:
    """Write training curves.

    Args:
        path: The file to write.
        title: Name of the recording.
        points: Quantities by name, at several times. The first quantity is the horizontal axis of the others.

    Raises:
        InputError: Rerun is switched off.
        OSError: The file cannot be written.
    """
    with rrd.errors_as(f"{path} cannot be recorded: does the environment variable RERUN switch Rerun off?"):
        content = _recording(title, points)
    with whole(path) as partial:
        partial.write_bytes(content)


def _recording(title: str, points: Sequence[Mapping[str, float]]) -> bytes:
    """The content of the file. In memory, because Rerun waits for ever where it cannot write to the disk."""
    axis, *names = points[0]
    views = [rrb.TimeSeriesView(name=name.replace("_", " "), origin=f"/{name}") for name in names]
    recording = rr.RecordingStream("crowdbench training", recording_id=title)
    stream = recording.binary_stream()
    recording.send_blueprint(rrb.Blueprint(rrb.Grid(*views), collapse_panels=True))
    along = rr.TimeColumn(axis, sequence=[int(point[axis]) for point in points])
    for name in names:
        scalars = rr.Scalars.columns(scalars=[point[name] for point in points])
        recording.send_columns(name, [along], scalars)
    content = stream.read()
    assert content is not None  # it is a stream in memory
    return content
