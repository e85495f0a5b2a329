"""Training curves as a Rerun recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int

from crowdbench.drawing import DARK, MUTED, SUCCESS
from crowdbench.record import rrd
from crowdbench.record.blueprint import axis_between, plot, style_of
from crowdbench.utils.files import whole


def write(
    path: Path,
    title: str,
    points: Sequence[Mapping[str, float]],
    *,
    best: int,
    intervals: Mapping[str, Sequence[tuple[float, float]]],
) -> None:
    """Write training curves.

    Args:
        path: The file to write.
        title: Name of the recording.
        points: Quantities by name, at several times. The first quantity is the horizontal axis of the others.
        best: The point with the best network, which is marked as kept.
        intervals: Low and high ends of the quantities that have an interval, at the same times.

    Raises:
        InputError: Rerun is switched off.
        OSError: The file cannot be written.
    """
    with rrd.errors_as(f"{path} cannot be recorded: does the environment variable RERUN switch Rerun off?"):
        content = _recording(title, points, best, intervals)
    with whole(path) as partial:
        partial.write_bytes(content)


def _recording(
    title: str, points: Sequence[Mapping[str, float]], best: int, intervals: Mapping[str, Sequence[tuple[float, float]]]
) -> bytes:
    """The content of the file. In memory, because Rerun waits for ever where it cannot write to the disk."""
    axis, *names = points[0]
    recording = rr.RecordingStream("crowdbench training", recording_id=title)
    stream = recording.binary_stream()
    along = np.array([int(point[axis]) for point in points])
    views = []
    for name in names:
        values = np.array([[point[name]] for point in points], float)
        if name in intervals:
            values = np.concatenate([values, np.array(intervals[name])], axis=1)
        columns = rr.Scalars.columns(scalars=values.ravel()).partition([values.shape[1]] * len(values))
        recording.send_columns(name, [rr.TimeColumn(axis, sequence=along)], columns)
        mark = rr.Scalars.columns(scalars=[values[best, 0]])
        recording.send_columns(f"{name}/kept", [rr.TimeColumn(axis, sequence=along[[best]])], mark)
        views.append(_view(name, along, values, has_interval=name in intervals))
    panel = rrb.TimePanel(timeline=axis, play_state="following", state="collapsed")
    recording.send_blueprint(rrb.Blueprint(rrb.Grid(*views), panel, collapse_panels=True))
    content = stream.read()
    assert content is not None  # it is a stream in memory
    return content


def _view(
    name: str, along: Int[np.ndarray, "time"], values: Float[np.ndarray, "time curve"], *, has_interval: bool
) -> rrb.TimeSeriesView:
    """The view of a quantity, whose axes have the ranges of its values."""
    axis = axis_between(*(rrb.TimeRangeBoundary.absolute(seq=int(at)) for at in (along[0], along[-1])))
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.05 * (high - low) or 0.5
    names, colors, key = [name], [DARK.vehicle], ""
    if has_interval:
        names, colors, key = [name, "low", "high"], [DARK.vehicle, MUTED, MUTED], "grey: 95 % interval, "
    mark = rr.SeriesPoints(names="kept", colors=SUCCESS, markers="circle", marker_sizes=6.0)
    styles = {f"/{name}": style_of(names, colors), f"/{name}/kept": mark}
    return plot(f"{name.replace('_', ' ')} ({key}green: kept)", styles, (low - margin, high + margin), axis)
