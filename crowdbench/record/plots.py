"""What a recording shows over time: gap, speed, and what the planner logged."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from jaxtyping import Float
from rerun.chunk import Chunk

from crowdbench.geometry import norm
from crowdbench.record.chunks import moments, still, times
from crowdbench.record.style import CURVES, MUTED
from crowdbench.types import DISCOMFORT_GAP, Trace

PLANNER_PLOTS = "plots/planner"
"""Path of the planner's own curves."""


def plots(trace: Trace, row: int) -> Iterator[Chunk]:
    """Gap and speed over time, with the values to compare them with. Their colours are in the blueprint.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
    """
    steps, dt = int(trace.steps[row]), trace.rules.dt
    gap = trace.gap[row, :steps]
    somebody = np.isfinite(gap)
    if somebody.any():
        curves = np.stack([gap, np.full(steps, DISCOMFORT_GAP), np.zeros(steps)], axis=1)
        yield _curves("plots/gap", moments(np.flatnonzero(somebody) + 1, dt), curves[somebody])
    speed = norm(trace.velocity[row, : steps + 1, 0])
    preferred = np.full(steps + 1, trace.preferred_speed[row, 0])
    yield _curves("plots/speed", times(0, steps + 1, dt), np.stack([speed, preferred], axis=1))


def _curves(entity: str, timelines: Sequence[rr.TimeColumn], values: Float[np.ndarray, "time curve"]) -> Chunk:
    """Curves of one entity over time."""
    columns = rr.Scalars.columns(scalars=values.ravel())
    return Chunk.from_columns(entity, timelines, columns.partition([values.shape[1]] * len(values)))


def logs(trace: Trace, row: int) -> Iterator[Chunk]:
    """What the planner logged, see `Observation.log`. Each value is shown until the planner logs the next one.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
    """
    end = int(trace.steps[row])
    for name, array in trace.logs.items():
        entity = f"world/planner/{name}"
        # Steps without a value are left out, because Rerun draws no curve between values separated by NaN.
        logged_at = np.flatnonzero(~np.isnan(array[row, :end].reshape(end, -1)).all(axis=1))
        logged, steps, timelines = array[row, logged_at], len(logged_at), moments(logged_at, trace.rules.dt)
        if steps == 0:
            continue
        if is_curve(array):
            curves = logged.reshape(steps, -1)
            names = [f"{name} {n}" if curves.shape[1] > 1 else name for n in range(curves.shape[1])]
            style = rr.SeriesLines(names=names, colors=list(itertools.islice(itertools.cycle(CURVES), len(names))))
            yield still(f"{PLANNER_PLOTS}/{name}", style)
            yield _curves(f"{PLANNER_PLOTS}/{name}", timelines, curves)
        elif logged.shape[-1] == 2 and logged.ndim == 3:
            points = rr.Points2D.columns(positions=logged.reshape(-1, 2))
            yield still(entity, rr.Points2D.from_fields(colors=[MUTED], radii=rr.Radius.ui_points(2)))
            yield Chunk.from_columns(entity, timelines, points.partition([logged[0].size // 2] * steps))
        elif logged.shape[-1] == 2:
            strips = logged.swapaxes(-3, -2).reshape(-1, logged.shape[-3], 2)
            lines = rr.LineStrips2D.columns(strips=strips)
            yield still(entity, rr.LineStrips2D.from_fields(colors=[MUTED], radii=rr.Radius.ui_points(0.75)))
            yield Chunk.from_columns(entity, timelines, lines.partition([len(strips) // steps] * steps))


def is_curve(logged: np.ndarray) -> bool:
    """Whether a logged array `[world, step, ...]` is shown as curves over time."""
    return logged.ndim <= 3
