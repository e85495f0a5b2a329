"""Training curves as a Rerun recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from crowdbench.files import whole


def write(path: Path, title: str, points: Sequence[Mapping[str, float]]) -> None:
    """Write training curves.

    Args:
        path: The file to write.
        title: Name of the recording.
        points: Quantities by name, at several times. The first quantity is the horizontal axis of the others.
    """
    axis, *names = points[0]
    views = [rrb.TimeSeriesView(name=name.replace("_", " "), origin=f"/{name}") for name in names]
    with whole(path) as partial:
        recording = rr.RecordingStream("crowdbench training", recording_id=title)
        recording.save(partial, default_blueprint=rrb.Blueprint(rrb.Grid(*views), collapse_panels=True))
        along = rr.TimeColumn(axis, sequence=[int(point[axis]) for point in points])
        for name in names:
            scalars = rr.Scalars.columns(scalars=[point[name] for point in points])
            recording.send_columns(name, [along], scalars)
        recording.flush()
        recording.disconnect()
