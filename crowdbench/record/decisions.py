"""A planner's decisions in the plane of a recording: commands with their values, futures, attention.

The predicted and considered paths can be read back from a recording, for figures.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from jaxtyping import Float, Int, UInt8
from rerun.chunk import Chunk

from crowdbench.core.types import Trace
from crowdbench.drawing import ATTENTION, DARK, MUTED, REMEMBERED, SCALE
from crowdbench.record.rrd import moments, moving, still, width

ATTENTION_LOG = "attention"
"""The log `[world, pedestrian]` that is drawn as lines from the vehicle to the pedestrians, besides its curves."""

_FADES = (255, 130, 60)
"""Opacity of the first, second and last third of a future."""


PATHS = re.compile(r"/world/planner/\w+/\d")
"""Entities of the lines over time, see `_draw_lines`."""

BEST = 12
"""How many of the paths that a planner considers are read, the best ones."""

STRIPS, COLORS = "LineStrips2D:strips", "LineStrips2D:colors"


class _Log(NamedTuple):
    """Arrays logged by one name in an episode.

    Attributes:
        entity: Path of the entity that shows it.
        steps: The steps of the decisions in which it was logged.
        values: The logged array of each of them.
        position: Where the agents were then, in metres.
        end: The last step of the episode.
        dt: Length of a step in seconds.
    """

    entity: str
    steps: Int[np.ndarray, "decision"]
    values: Float[np.ndarray, "decision *shape"]
    position: Float[np.ndarray, "decision agent 2"]
    end: int
    dt: float


def draw_decisions(trace: Trace, row: int) -> Iterator[Chunk]:
    """Yield the planner's logs that have a place in the plane, see `Observation.log`.

    It is shown from the step in which it was logged until the next one; of a future, what is still to come.
    """
    end, dt = int(trace.steps[row]), trace.rules.dt
    for name, array in trace.logs.items():
        steps = steps_logged(trace, row, name)
        values = _of_the_known(trace, row, steps, array[row, steps])
        log = _Log(f"world/planner/{name}", steps, values, trace.position[row, steps], end, dt)
        if not len(steps):
            continue
        if name == ATTENTION_LOG and log.values.shape == log.position[:, 1:, 0].shape:
            yield from _draw_attention(log)
        if _is_fan(log.values[0]):
            yield from _draw_fan(log)
        elif log.values.ndim == 3 and log.values.shape[-1] == 2:
            points = rr.Points2D.columns(positions=log.values.reshape(-1, 2))
            yield still(log.entity, rr.Points2D.from_fields(colors=[MUTED], radii=width(2)))
            yield moving(log.entity, moments(steps, dt), [log.values.shape[1]] * len(steps), points)
        elif log.values.ndim > 3:
            yield from _draw_lines(log)


def _of_the_known(
    trace: Trace, row: int, steps: Int[np.ndarray, "decision"], values: Float[np.ndarray, "decision *shape"]
) -> Float[np.ndarray, "decision *shape"]:
    """Return paths of pedestrians; NaN for pedestrians that the vehicle neither sees nor remembers."""
    where = trace.position[row, steps, 1:] if trace.perceived is None else trace.perceived[row, steps]
    if values.ndim < 4 or values.shape[-2:] != where.shape[-2:]:
        return values
    known = np.isfinite(where).all(axis=-1)
    return np.where(known.reshape(len(steps), *[1] * (values.ndim - 3), -1, 1), values, np.nan)


def steps_logged(trace: Trace, row: int, name: str) -> Int[np.ndarray, "decision"]:
    """The steps of an episode in which the planner logged something by a name."""
    end = int(trace.steps[row])
    return np.flatnonzero(~np.isnan(trace.logs[name][row, :end].reshape(end, -1)).all(axis=1))


def key_text(trace: Trace) -> str:
    """Return the legend of the marks of its decisions; empty where there are none."""
    marks = []
    logged = list(trace.logs.values())
    if any(_is_fan(array[0, 0]) for array in logged):
        marks.append(
            "arrows from the vehicle: the commands that it could give, dark to light by their value; yellow: the best "
            "one, brown: the next"
        )
    lines = [array.shape[-1] for array in logged if array[0, 0].ndim > 2]
    if 2 in lines:
        marks.append("grey lines: predicted ways, fainter the further ahead")
    if 3 in lines:
        marks.append("coloured lines: ways that were considered, dark to light by their value")
    if ATTENTION_LOG in trace.logs:
        marks.append("pink: attention to pedestrians")
    return f"*{' · '.join(marks)}*" if marks else ""


def _is_fan(logged: Float[np.ndarray, "*_"]) -> bool:
    """Return whether what is logged in one decision, or row by row, are commands with values `[..., command, 3]`."""
    return logged.ndim == 2 and logged.shape[-1] == 3


def shades(value: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape 3"]:
    """Colours from dark to light, by values from 0 to 1."""
    stops = np.linspace(0.0, 1.0, len(SCALE))
    channels = [np.interp(value, stops, channel) for channel in np.array(SCALE, float).T]
    return np.stack(channels, axis=-1).astype(np.uint8)


def _draw_fan(log: _Log) -> Iterator[Chunk]:
    """Commands as arrows as long as the way of one second, coloured by value; the best two are marked.

    A command that cannot be chosen has no finite value.
    """
    known = [commands[np.isfinite(commands[:, 2])] for commands in log.values]
    yield still(log.entity, rr.Arrows2D.from_fields(radii=width(0.75), draw_order=20))
    yield _draw_arrows(log, known, [shades(_to_shares(commands[:, 2])) for commands in known])
    best = log._replace(entity=f"{log.entity}/best")
    yield still(best.entity, rr.Arrows2D.from_fields(radii=width(2.0), draw_order=45))
    ranked = [commands[np.argsort(commands[:, 2], kind="stable")[-2:]] for commands in known]
    two = np.array([REMEMBERED, DARK.vehicle], np.uint8)
    yield _draw_arrows(best, ranked, [two[2 - len(commands) :] for commands in ranked])


def _draw_arrows(log: _Log, commands: list[np.ndarray], colors: list[np.ndarray]) -> Chunk:
    """Arrows from the vehicle in each decision: commands `[command, 3]` and their colours."""
    counts = [len(arrows) for arrows in commands]
    arrows = rr.Arrows2D.columns(vectors=np.concatenate(commands)[:, :2], colors=np.concatenate(colors))
    columns = [column.partition(counts) for column in arrows]
    # One origin stands for all arrows of a step.
    columns += [column.partition([1] * len(counts)) for column in rr.Arrows2D.columns(origins=log.position[:, 0])]
    return Chunk.from_columns(log.entity, moments(log.steps, log.dt), columns)


def _draw_lines(log: _Log) -> Iterator[Chunk]:
    """Lines over time that fade with the time ahead, in thirds. Each is shorter by a point a step, as time goes on.

    They are logged as `[..., time, line, 2]`, from the step after the decision on; a third number is a line's weight.
    """
    length, lines = log.values.shape[-3], log.values[0, ..., 0, :, 0].size
    until = np.append(log.steps[1:], log.end)
    shown = [(i, k) for i, (a, b) in enumerate(zip(log.steps, until, strict=True)) for k in range(max(b - a, 1))]
    timeline = moments(np.array([log.steps[i] + k for i, k in shown]), log.dt)
    bounds = np.linspace(0, length - 1, len(_FADES) + 1).round().astype(int)
    for third, (low, high) in enumerate(itertools.pairwise(bounds.tolist())):
        strips: list[np.ndarray] = []
        for i, k in shown:
            part = log.values[i][..., max(low, k) : high + 1, :, :2]
            strips.append(part.swapaxes(-3, -2).reshape(lines, part.shape[-3], 2))
        drawn = [np.isfinite(values).all(axis=(1, 2)) & (values.shape[1] > 1) for values in strips]
        counts = [int(values.sum()) for values in drawn]
        flat = [line for values, shown_lines in zip(strips, drawn, strict=True) for line in values[shown_lines]]
        if not flat:
            continue
        path = f"{log.entity}/{third}"
        changing: dict[str, Any] = {"strips": flat}
        always: dict[str, Any] = {}
        if log.values.shape[-1] == 3:
            weights = [log.values[i][..., 0, :, 2].ravel() for i, _ in shown]
            shares = [_to_shares(values)[shown_lines] for values, shown_lines in zip(weights, drawn, strict=True)]
            changing["colors"] = shades(np.concatenate(shares))
        else:
            always["colors"] = [(*MUTED, _FADES[third])]
        yield still(path, rr.LineStrips2D.from_fields(radii=width(0.75), draw_order=15, **always))
        yield moving(path, timeline, counts, rr.LineStrips2D.columns(**changing))


def _to_shares(values: Float[np.ndarray, "_"]) -> Float[np.ndarray, "_"]:
    """Values as shares from the smallest, 0, to the largest, 1; 1 where they are all the same."""
    spread = float(np.ptp(values)) if len(values) else 0.0
    return (values - values.min()) / spread if spread > 0.0 else np.ones(len(values))


def _draw_attention(log: _Log) -> Iterator[Chunk]:
    """Lines from the vehicle to the pedestrians, the wider the more, from 0 to 1, it attends to them."""
    seen = np.isfinite(log.position[:, 1:, 0]) & (log.values > 0.02)
    if not seen.any():
        return
    decision, pedestrian = np.nonzero(seen)
    strips = np.stack([log.position[decision, 0], log.position[decision, 1 + pedestrian]], axis=1)
    lines = rr.LineStrips2D.columns(strips=strips, radii=width((6.0 * log.values[seen]).tolist()))
    yield still(log.entity, rr.LineStrips2D.from_fields(colors=[ATTENTION], draw_order=12))
    yield moving(log.entity, moments(log.steps, log.dt), seen.sum(axis=1), lines)


class PlannedPaths(NamedTuple):
    """Paths in metres that a planner predicted and considered in one state.

    Attributes:
        predicted: Paths of pedestrians.
        considered: The best of those that the vehicle could drive.
    """

    predicted: list[Float[np.ndarray, "point 2"]]
    considered: list[Float[np.ndarray, "point 2"]]


def read_paths(chunks: Sequence[Chunk], dt: float) -> dict[int, PlannedPaths]:
    """Read the paths that a planner predicted and considered, by the number of the state.

    Args:
        chunks: All chunks of an episode.
        dt: Length of a step in seconds.
    """
    paths: dict[int, PlannedPaths] = {}
    for chunk in chunks:
        if not PATHS.fullmatch(chunk.entity_path) or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        states = np.round(batch["time"].cast(pa.int64()).to_numpy() / (1e9 * dt)).astype(int)
        is_valued = COLORS in batch.schema.names
        for row, state in enumerate(states.tolist()):
            planned = paths.setdefault(state, PlannedPaths([], []))
            strips = [np.array(strip, float) for strip in batch[STRIPS][row].as_py() or []]
            if is_valued:  # dark to light by their value
                colors = np.array(batch[COLORS][row].as_py() or [], np.uint32).view(np.uint8).reshape(-1, 4)
                best = np.argsort(-colors.sum(axis=1, dtype=int), kind="stable")[:BEST]
                strips = [strips[number] for number in best]
            (planned.considered if is_valued else planned.predicted).extend(strips)
    return paths
