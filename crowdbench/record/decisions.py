"""What a recording shows of a planner's decisions in the plane: commands with their values, futures, attention."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float, Int, UInt8
from rerun.chunk import Chunk

from crowdbench.core.types import Trace
from crowdbench.drawing.palette import ATTENTION, DARK, MUTED, REMEMBERED, SCALE
from crowdbench.record.rrd import moments, moving, still

ATTENTION_LOG = "attention"
"""The log `[world, pedestrian]` that is drawn as lines from the vehicle to the pedestrians, besides its curves."""

_FADES = (255, 130, 60)
"""Opacity of the first, second and last third of a future."""


def draw_decisions(trace: Trace, row: int) -> Iterator[Chunk]:
    """What the planner logged that has a place in the plane, see `Observation.log`.

    It is shown from the step in which it was logged until the next one; of a future, what is still to come.
    """
    end, dt = int(trace.steps[row]), trace.rules.dt
    for name, array in trace.logs.items():
        entity = f"world/planner/{name}"
        logged_at = steps_logged(trace, row, name)
        logged = array[row, logged_at]
        if not len(logged):
            continue
        if name == ATTENTION_LOG and logged.shape[1:] == trace.position[row, 0, 1:, 0].shape:
            yield from _draw_attention(trace, row, logged_at, logged)
        if _is_fan(logged[0]):
            yield from _draw_fan(entity, logged, trace.position[row, logged_at, 0], logged_at, dt)
        elif logged.ndim == 3 and logged.shape[-1] == 2:
            points = rr.Points2D.columns(positions=logged.reshape(-1, 2))
            yield still(entity, rr.Points2D.from_fields(colors=[MUTED], radii=rr.Radius.ui_points(2)))
            yield moving(entity, moments(logged_at, dt), [logged.shape[1]] * len(logged), points)
        elif logged.ndim > 3:
            yield from _draw_lines(entity, logged, logged_at, end, dt)


def steps_logged(trace: Trace, row: int, name: str) -> Int[np.ndarray, "decision"]:
    """The steps of an episode in which the planner logged something by a name."""
    end = int(trace.steps[row])
    return np.flatnonzero(~np.isnan(trace.logs[name][row, :end].reshape(end, -1)).all(axis=1))


def key_text(trace: Trace) -> str:
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


def _draw_fan(
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
    known = [each[np.isfinite(each[:, 2])] for each in logged]
    vectors = [each[:, :2] for each in known]
    colors = [shades(_to_shares(each[:, 2])) for each in known]
    best = [each[np.argsort(each[:, 2], kind="stable")[-2:], :2] for each in known]
    style = rr.Radius.ui_points(0.75)
    yield still(entity, rr.Arrows2D.from_fields(radii=style, draw_order=20))
    yield _draw_arrows(entity, origin, vectors, steps, dt, np.concatenate(colors))
    marks = rr.Arrows2D.from_fields(radii=rr.Radius.ui_points(2.0), draw_order=45)
    yield still(f"{entity}/best", marks)
    two = np.array([REMEMBERED, DARK.vehicle], np.uint8)
    yield _draw_arrows(
        f"{entity}/best", origin, best, steps, dt, np.concatenate([two[2 - len(each) :] for each in best])
    )


def _draw_arrows(
    entity: str,
    origin: Float[np.ndarray, "decision 2"],
    vectors: list[np.ndarray],
    steps: Int[np.ndarray, "decision"],
    dt: float,
    colors: UInt8[np.ndarray, "arrow 3"],
) -> Chunk:
    """Arrows from one point at each of several steps; `colors` are those of all arrows, one after the other."""
    counts = [len(each) for each in vectors]
    arrows = rr.Arrows2D.columns(vectors=np.concatenate(vectors), colors=colors)
    columns = [column.partition(counts) for column in arrows]
    # One origin stands for all arrows of a step.
    columns += [column.partition([1] * len(origin)) for column in rr.Arrows2D.columns(origins=origin)]
    return Chunk.from_columns(entity, moments(steps, dt), columns)


def _draw_lines(
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
    timeline = moments(np.array([steps[i] + k for i, k in shown]), dt)
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
        changing: dict[str, Any] = {"strips": flat}
        always: dict[str, Any] = {}
        if logged.shape[-1] == 3:
            weights = [logged[i][..., 0, :, 2].ravel() for i, _ in shown]
            shares = [_to_shares(each)[:count] for each, count in zip(weights, counts, strict=True)]
            changing["colors"] = shades(np.concatenate(shares))
        else:
            always["colors"] = [(*MUTED, _FADES[third])]
        yield still(path, rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(0.75), draw_order=15, **always))
        yield moving(path, timeline, counts, rr.LineStrips2D.columns(**changing))


def _to_shares(values: Float[np.ndarray, "_"]) -> Float[np.ndarray, "_"]:
    """Values as shares from the smallest, 0, to the largest, 1; 1 where they are all the same."""
    spread = float(np.ptp(values)) if len(values) else 0.0
    return (values - values.min()) / spread if spread > 0.0 else np.ones(len(values))


def _draw_attention(
    trace: Trace, row: int, steps: Int[np.ndarray, "decision"], logged: Float[np.ndarray, "decision pedestrian"]
) -> Iterator[Chunk]:
    """Lines from the vehicle to the pedestrians, the wider the more, from 0 to 1, it attends to them."""
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
    yield moving("world/planner/attention", moments(steps, trace.rules.dt), counts, lines)
