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
from crowdbench.record.style import CURVES
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
    """What the planner logged that is a curve, see `Observation.log`. A value holds until the next one is logged.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
    """
    end = int(trace.steps[row])
    for name, array in trace.logs.items():
        # Steps without a value are left out, because Rerun draws no curve between values separated by NaN.
        logged_at = np.flatnonzero(~np.isnan(array[row, :end].reshape(end, -1)).all(axis=1))
        if not is_curve(array) or not len(logged_at):
            continue
        curves = array[row, logged_at].reshape(len(logged_at), -1)
        names = [f"{name} {n}" if curves.shape[1] > 1 else name for n in range(curves.shape[1])]
        style = rr.SeriesLines(
            names=names,
            colors=list(itertools.islice(itertools.cycle(CURVES), len(names))),
            interpolation_mode=rr.components.InterpolationMode.StepAfter,
        )
        yield still(f"{PLANNER_PLOTS}/{name}", style)
        yield _curves(f"{PLANNER_PLOTS}/{name}", moments(logged_at, trace.rules.dt), curves)


def is_curve(logged: np.ndarray) -> bool:
    """Whether a logged array `[world, step, ...]` is shown as curves over time."""
    return logged.ndim <= 3
