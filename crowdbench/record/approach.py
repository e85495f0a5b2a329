"""Where the vehicle and a pedestrian would come closest to each other if both went on as they do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr
from jaxtyping import Float
from rerun.chunk import Chunk

from crowdbench.geometry import norm
from crowdbench.record.chunks import moments, still
from crowdbench.record.style import FAILURE, MUTED
from crowdbench.types import Outcome, Trace

AHEAD = 4.0
"""How far ahead it is looked for, in seconds."""

NEAR = 0.5
"""The largest gap in metres that is shown."""

KEY = f"*line with a gap and a time: the closest approach in the next {AHEAD:g} s if both go on; red: they touch*"
"""What the mark means, as text beside the picture."""


def closest(
    position: Float[np.ndarray, "*batch 2"], velocity: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch"]:
    """When two points with constant velocities are nearest to each other, in seconds from now, up to `AHEAD`.

    Args:
        position: One relative to the other, in metres.
        velocity: Likewise, in m/s.
    """
    speed = (velocity**2).sum(axis=-1)
    when = -(position * velocity).sum(axis=-1) / np.where(speed > 0.0, speed, np.inf)
    return np.clip(when, 0.0, AHEAD)


def drawn(trace: Trace, row: int, label: float) -> Iterator[Chunk]:
    """The closest approach ahead of each state: a line between both centres then, with the gap and the time.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        label: Height of a line of text in metres.
    """
    states = int(trace.steps[row]) + 1
    position, velocity = trace.position[row, :states], trace.velocity[row, :states]
    if position.shape[1] == 1:
        return
    when = closest(position[:, 1:] - position[:, :1], velocity[:, 1:] - velocity[:, :1])
    ahead = np.stack(
        [position[:, :1] + velocity[:, :1] * when[..., None], position[:, 1:] + velocity[:, 1:] * when[..., None]]
    )
    gap = norm(ahead[1] - ahead[0]) - trace.radius[row, :states, 1:] - trace.radius[row, :states, :1]
    gap = np.where(np.isfinite(gap) & (when > 0.0), gap, np.inf)
    state, who = np.arange(states), gap.argmin(axis=1)
    is_shown = gap[state, who] < NEAR
    if trace.outcome[row] == Outcome.COLLISION:
        is_shown[-1] = False  # the mark of the collision is there
    if not is_shown.any():
        return
    lines = ahead[:, state, who].swapaxes(0, 1)[is_shown]
    labels = [f"{max(gap[t, who[t]], 0.0):.2f} m in {when[t, who[t]]:.1f} s" for t in np.flatnonzero(is_shown)]
    colors = [FAILURE if gap[t, who[t]] < 0.0 else MUTED for t in np.flatnonzero(is_shown)]
    # The text stands over the pedestrian, away from the vehicle's name.
    above = lines[:, 1] + [0.0, trace.radius[row, 0, 0] + label]
    yield still(
        "world/approach",
        rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(1.5), draw_order=46),
        rr.Points2D.from_fields(radii=rr.Radius.ui_points(0)),
    )
    columns = [
        *rr.LineStrips2D.columns(strips=lines, colors=colors),
        *rr.Points2D.columns(positions=above, labels=labels, colors=colors),
    ]
    counts = is_shown.astype(int).tolist()
    timelines = moments(state, trace.rules.dt)
    yield Chunk.from_columns("world/approach", timelines, [column.partition(counts) for column in columns])
