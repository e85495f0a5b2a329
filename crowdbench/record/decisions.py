"""What a recording shows of a planner's decisions in the plane: commands with their values, futures, attention."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import rerun as rr
from jaxtyping import Float, Int, UInt8
from rerun.chunk import Chunk

from crowdbench.record.chunks import moments, still
from crowdbench.record.style import ATTENTION, MUTED, REMEMBERED, SCALE, VEHICLE
from crowdbench.types import Trace

ATTENTION_LOG = "attention"
"""The log `[world, pedestrian]` that is drawn as lines from the vehicle to the pedestrians, besides its curves."""

_FADES = (255, 130, 60)
"""Opacity of the first, second and last third of a future."""


def drawn(trace: Trace, row: int) -> Iterator[Chunk]:
    """What the planner logged that has a place in the plane, see `Observation.log`.

    It is shown from the step in which it was logged until the next one; of a future, what is still to come.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
    """
    end, dt = int(trace.steps[row]), trace.rules.dt
    for name, array in trace.logs.items():
        entity = f"world/planner/{name}"
        logged_at = np.flatnonzero(~np.isnan(array[row, :end].reshape(end, -1)).all(axis=1))
        logged = array[row, logged_at]
        if not len(logged):
            continue
        if name == ATTENTION_LOG and logged.shape[1:] == trace.position[row, 0, 1:, 0].shape:
            yield from _attention(trace, row, logged_at, logged)
        if _is_fan(logged[0]):
            yield from _fan(entity, logged, trace.position[row, logged_at, 0], logged_at, dt)
        elif logged.ndim == 3 and logged.shape[-1] == 2:
            points = rr.Points2D.columns(positions=logged.reshape(-1, 2))
            yield still(entity, rr.Points2D.from_fields(colors=[MUTED], radii=rr.Radius.ui_points(2)))
            yield Chunk.from_columns(entity, moments(logged_at, dt), points.partition([logged.shape[1]] * len(logged)))
        elif logged.ndim > 3:
            yield from _lines(entity, logged, logged_at, end, dt)


def key(trace: Trace) -> str:
    """What the marks of its decisions mean, as text beside the picture; empty where there are none."""
    marks = []
    logged = list(trace.logs.values())
    if any(_is_fan(array[0, 0]) for array in logged):
        marks.append(
            "arrows from the vehicle: the commands that it could give, dark to light by their value; yellow: the best "
            "one, brown: the next"
        )
    if any(array[0, 0].ndim > 2 for array in logged):
        marks.append("grey lines: predicted ways, fainter the further ahead")
    if ATTENTION_LOG in trace.logs:
        marks.append("violet: whom it attends to")
    return f"*{' · '.join(marks)}*" if marks else ""


def _is_fan(logged: Float[np.ndarray, "*_"]) -> bool:
    """Whether what is logged in one decision, or row by row, are commands with values `[..., command, 3]`."""
    return logged.ndim == 2 and logged.shape[-1] == 3


def shades(value: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape 3"]:
    """Colours from dark to light, by values from 0 to 1."""
    stops = np.linspace(0.0, 1.0, len(SCALE))
    channels = [np.interp(value, stops, channel) for channel in np.array(SCALE, float).T]
    return np.stack(channels, axis=-1).astype(np.uint8)


def _fan(
    entity: str,
    logged: Float[np.ndarray, "decision command 3"],
    origin: Float[np.ndarray, "decision 2"],
    steps: Int[np.ndarray, "decision"],
    dt: float,
) -> Iterator[Chunk]:
    """Commands as arrows as long as the way of one second, coloured by value; the best two are marked.

    Args:
        entity: Path of the entity.
        logged: Velocities in m/s and a value each; what cannot be chosen has no finite value.
        origin: Where the vehicle was, in metres.
        steps: The steps of the decisions.
        dt: Length of a step in seconds.
    """
    vectors: list[np.ndarray] = []
    colors: list[np.ndarray] = []
    best: list[np.ndarray] = []
    for each in logged:
        known = each[np.isfinite(each[:, 2])]
        order = np.argsort(known[:, 2], kind="stable")
        spread = float(np.ptp(known[:, 2])) if len(known) else 0.0
        shares = (known[:, 2] - known[:, 2].min(initial=np.inf)) / spread if spread > 0.0 else np.ones(len(known))
        vectors.append(known[:, :2])
        colors.append(shades(shares))
        best.append(known[order[-2:], :2])
    style = rr.Radius.ui_points(0.75)
    yield still(entity, rr.Arrows2D.from_fields(radii=style, draw_order=20))
    yield _arrows(entity, origin, vectors, steps, dt, np.concatenate(colors))
    marks = rr.Arrows2D.from_fields(radii=rr.Radius.ui_points(2.0), draw_order=45)
    yield still(f"{entity}/best", marks)
    two = np.array([REMEMBERED, VEHICLE], np.uint8)
    yield _arrows(f"{entity}/best", origin, best, steps, dt, np.concatenate([two[2 - len(each) :] for each in best]))


def _arrows(
    entity: str,
    origin: Float[np.ndarray, "decision 2"],
    vectors: list[np.ndarray],
    steps: Int[np.ndarray, "decision"],
    dt: float,
    colors: UInt8[np.ndarray, "arrow 3"],
) -> Chunk:
    """Arrows from one point at each of several steps.

    Args:
        entity: Path of the entity.
        origin: The point, in metres.
        vectors: The arrows of each step, in metres.
        steps: The steps.
        dt: Length of a step in seconds.
        colors: The colours of all arrows, one after the other.
    """
    counts = [len(each) for each in vectors]
    arrows = rr.Arrows2D.columns(vectors=np.concatenate(vectors), colors=colors)
    columns = [column.partition(counts) for column in arrows]
    # One origin stands for all arrows of a step.
    columns += [column.partition([1] * len(origin)) for column in rr.Arrows2D.columns(origins=origin)]
    return Chunk.from_columns(entity, moments(steps, dt), columns)


def _lines(
    entity: str,
    logged: Float[np.ndarray, "decision *_ time line xy"],
    steps: Int[np.ndarray, "decision"],
    end: int,
    dt: float,
) -> Iterator[Chunk]:
    """Lines over time that fade with the time ahead, in thirds. Each is shorter by a point a step, as time goes on.

    Args:
        entity: Path of the entity.
        logged: Points in metres, from the step after the decision on; a third number is a weight of the line.
        steps: The steps of the decisions.
        end: The last step of the episode.
        dt: Length of a step in seconds.
    """
    length, lines = logged.shape[-3], logged[0, ..., 0, :, 0].size
    until = np.append(steps[1:], end)
    shown = [(i, k) for i, (a, b) in enumerate(zip(steps, until, strict=True)) for k in range(max(b - a, 1))]
    timelines = moments(np.array([steps[i] + k for i, k in shown]), dt)
    bounds = np.linspace(0, length - 1, len(_FADES) + 1).round().astype(int)
    for third, (low, high) in enumerate(itertools.pairwise(bounds.tolist())):
        strips: list[np.ndarray] = []
        for i, k in shown:
            part = logged[i][..., max(low, k) : high + 1, :, :2]
            strips.append(part.swapaxes(-3, -2).reshape(lines, part.shape[-3], 2))
        counts = [len(each) if each.shape[1] > 1 else 0 for each in strips]
        flat = [line for each, count in zip(strips, counts, strict=True) for line in each[:count]]
        if not flat:
            continue
        path = f"{entity}/{third}"
        columns = [rr.LineStrips2D.columns(strips=flat).partition(counts)]
        always = {"colors": [(*MUTED, _FADES[third])]}
        if logged.shape[-1] == 3:
            weights = np.concatenate([_shares(logged[i], count) for (i, _), count in zip(shown, counts, strict=True)])
            columns.append(rr.LineStrips2D.columns(colors=shades(weights)).partition(counts))
            always = {}
        yield still(path, rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(0.75), draw_order=15, **always))
        yield Chunk.from_columns(path, timelines, [each for column in columns for each in column])


def _shares(logged: Float[np.ndarray, "*_ time line 3"], count: int) -> Float[np.ndarray, "_"]:
    """The weights of lines as shares from the smallest to the largest; nothing where no line is shown."""
    weights = logged[..., 0, :, 2].ravel()
    spread = float(np.ptp(weights))
    return ((weights - weights.min()) / spread if spread > 0.0 else np.ones(len(weights)))[:count]


def _attention(
    trace: Trace, row: int, steps: Int[np.ndarray, "decision"], logged: Float[np.ndarray, "decision pedestrian"]
) -> Iterator[Chunk]:
    """Lines from the vehicle to the pedestrians, the wider the more it attends to them.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        steps: The steps of the decisions.
        logged: How much it attends to each of them, from 0 to 1.
    """
    position = trace.position[row, steps]
    strips, widths, counts = [], [], []
    for place, share in zip(position, logged, strict=True):
        seen = np.flatnonzero(np.isfinite(place[1:, 0]) & (share > 0.02))
        strips += [place[[0, 1 + one]] for one in seen]
        widths += (6.0 * share[seen]).tolist()
        counts.append(len(seen))
    if not strips:
        return
    lines = rr.LineStrips2D.columns(strips=strips, radii=rr.Radius.ui_points(widths))
    yield still("world/planner/attention", rr.LineStrips2D.from_fields(colors=[ATTENTION], draw_order=12))
    yield Chunk.from_columns(
        "world/planner/attention",
        moments(steps, trace.rules.dt),
        [column.partition(counts) for column in lines],
    )
