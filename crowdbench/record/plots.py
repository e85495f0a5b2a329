"""What a recording shows over time: gap, speed, and what the planner logged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import rerun as rr
from jaxtyping import Float
from rerun.chunk import Chunk

from crowdbench.geometry import norm
from crowdbench.record.chunks import moments, times
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
    """What the planner logged that is a curve, see `Observation.log`. How it is drawn is in the blueprint.

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
        yield _curves(f"{PLANNER_PLOTS}/{name}", moments(logged_at, trace.rules.dt), curves)


def logged_curves(chunks: Iterable[Chunk]) -> dict[str, int]:
    """The curves of `logs` in the chunks of a recording: how many there are by each name, in order."""
    found = {}
    for chunk in chunks:
        name = chunk.entity_path.removeprefix(f"/{PLANNER_PLOTS}/")
        if name != chunk.entity_path and not chunk.is_static and chunk.num_rows:
            found[name] = len(chunk.to_record_batch().column("Scalars:scalars")[0])
    return dict(sorted(found.items()))


def is_curve(logged: np.ndarray) -> bool:
    """Whether a logged array `[world, step, ...]` is shown as curves over time."""
    return logged.ndim <= 3
