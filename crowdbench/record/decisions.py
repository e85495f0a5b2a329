"""A planner's decisions in the plane of a recording: commands with their values, futures, attention.

The predicted, considered and planned paths can be read back from a recording, for figures.
"""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from jaxtyping import Float, Int
from rerun.chunk import Chunk

from crowdbench.core.types import Trace
from crowdbench.drawing import DARK, LIGHT, Color, Line, Palette
from crowdbench.record.rrd import moments, moving, still, width

ATTENTION_LOG = "attention"
"""The log `[world, pedestrian]` that is drawn as lines from the vehicle to the pedestrians, besides its curves."""

PLANNED_LOG = "planned"
"""The log `[world, time, 1, 2]` of the path that the planner has chosen."""

_FADES = (255, 130, 60)
"""Opacity of the first, second and last third of a future."""

ROLES = {"predicted": 0.75, "considered": 0.75, "planned": 2.5}
"""The roles of lines over time, each with its width in points."""

PATHS = re.compile(rf"/world/planner/({'|'.join(ROLES)})/\w+/\d")
"""Entities of the lines over time, see `_draw_lines`."""

BEST = 12
"""Number of considered paths that are shown, the best ones."""

FAN = re.compile(r"/world/planner/\w+?(/best)?")
"""Entities of the arrows of commands, and of the best command, see `_draw_fan`."""


class _Log(NamedTuple):
    """Arrays logged under one name in an episode.

    Attributes:
        entity: Path of the entity that shows them.
        steps: The steps of the decisions in which they were logged.
        values: The logged array of each decision.
        position: Positions of the agents in these steps, in metres.
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
    """Yield the planner's logs that can be drawn in the plane, see `Observation.log`.

    A log is shown from its step until the next logged step. The past part of paths over time is not shown.
    """
    end, dt = int(trace.steps[row]), trace.rules.dt
    for name, array in trace.logs.items():
        steps = steps_logged(trace, row, name)
        values = _start_at_measured(trace, row, steps, array[row, steps])
        log = _Log(f"world/planner/{name}", steps, values, trace.position[row, steps], end, dt)
        if not len(steps):
            continue
        if name == ATTENTION_LOG and log.values.shape == log.position[:, 1:, 0].shape:
            yield from _draw_attention(log)
        if _is_fan(log.values[0]):
            yield from _draw_fan(log)
        elif log.values.ndim == 3 and log.values.shape[-1] == 2:
            points = rr.Points2D.columns(positions=log.values.reshape(-1, 2))
            yield still(log.entity, rr.Points2D.from_fields(colors=[DARK.predicted], radii=width(2)))
            yield moving(log.entity, moments(steps, dt), [log.values.shape[1]] * len(steps), points)
        elif log.values.ndim > 3:
            yield from _draw_lines(log, _role(name, log.values.shape))


def _role(name: str, shape: tuple[int, ...]) -> str:
    """Return the role of lines over time, by the name and the shape with which they were logged."""
    return "planned" if name == PLANNED_LOG else "considered" if shape[-1] == 3 else "predicted"


def _start_at_measured(
    trace: Trace, row: int, steps: Int[np.ndarray, "decision"], values: Float[np.ndarray, "decision *shape"]
) -> Float[np.ndarray, "decision *shape"]:
    """Return paths of pedestrians with their measured positions in front, and other values as they are.

    Paths of pedestrians that the vehicle neither sees nor remembers are NaN.
    """
    where = trace.position[row, steps, 1:] if trace.perceived is None else trace.perceived[row, steps]
    if values.ndim < 4 or values.shape[-2:] != where.shape[-2:]:
        return values
    start = where.reshape(len(steps), *[1] * (values.ndim - 3), *where.shape[1:])
    start = np.broadcast_to(start, (*values.shape[:-3], 1, *where.shape[1:]))
    return np.where(np.isfinite(start), np.concatenate([start, values], axis=-3), np.nan)


def steps_logged(trace: Trace, row: int, name: str) -> Int[np.ndarray, "decision"]:
    """Return the steps of an episode in which the planner logged an array under a name.

    Args:
        trace: The trace with logs.
        row: The row of the episode.
        name: The name of the log.
    """
    end = int(trace.steps[row])
    return np.flatnonzero(~np.isnan(trace.logs[name][row, :end].reshape(end, -1)).all(axis=1))


def marks_of(trace: Trace) -> set[str]:
    """Return the kinds of marks of the planner's decisions: roles of `ROLES`, "commands" and `ATTENTION_LOG`."""
    lines = {_role(name, logged.shape) for name, logged in trace.logs.items() if logged[0, 0].ndim > 2}
    fans = {"commands" for logged in trace.logs.values() if _is_fan(logged[0, 0])}
    return lines | fans | ({ATTENTION_LOG} & trace.logs.keys())


def _is_fan(logged: Float[np.ndarray, "*_"]) -> bool:
    """Return True if the array logged in one decision has the shape of commands with values, `[command, 3]`."""
    return logged.ndim == 2 and logged.shape[-1] == 3


def _draw_fan(log: _Log) -> Iterator[Chunk]:
    """Draw commands as arrows as long as the path of one second, and the best one over them.

    A command that cannot be chosen has no finite value.
    """
    known = [commands[np.isfinite(commands[:, 2])] for commands in log.values]
    best = [commands[np.argsort(commands[:, 2], kind="stable")[-1:]] for commands in known]
    for name, commands, role, size, order in (("", known, "considered", 0.75, 20), ("/best", best, "planned", 2.0, 45)):
        style = rr.Arrows2D.from_fields(colors=[_color(role, DARK)], radii=width(size), draw_order=order)
        yield still(f"{log.entity}{name}", style)
        counts = [len(arrows) for arrows in commands]
        arrows = rr.Arrows2D.columns(vectors=np.concatenate(commands)[:, :2]).partition(counts)
        # All arrows of a step share one origin.
        origins = rr.Arrows2D.columns(origins=log.position[:, 0]).partition([1] * len(counts))
        yield Chunk.from_columns(f"{log.entity}{name}", moments(log.steps, log.dt), [*arrows, *origins])


def _draw_lines(log: _Log, role: str) -> Iterator[Chunk]:
    """Draw lines over time in thirds, which fade with the time ahead. Each line loses one point per step.

    They are logged as `[..., time, line, 2]`. Lines of pedestrians start at the decision, other lines one step later. A
    third number is the value of a
    line; only the best lines are drawn.
    """
    length, each = log.values.shape[-3], np.moveaxis(log.values, -3, -2)
    lines = each.reshape(len(each), -1, *each.shape[-2:])
    if role == "considered":
        best = np.argsort(-lines[:, :, 0, 2], axis=1, kind="stable")[:, :BEST]
        lines = np.take_along_axis(lines, best[..., None, None], axis=1)
    until = np.append(log.steps[1:], log.end)
    shown = [(i, k) for i, (a, b) in enumerate(zip(log.steps, until, strict=True)) for k in range(max(b - a, 1))]
    timeline = moments(np.array([log.steps[i] + k for i, k in shown]), log.dt)
    bounds = np.linspace(0, length - 1, len(_FADES) + 1).round().astype(int)
    color = _color(role, DARK)
    for third, (low, high) in enumerate(itertools.pairwise(bounds.tolist())):
        strips = [lines[i, :, max(low, k) : high + 1, :2] for i, k in shown]
        drawn = [values[np.isfinite(values).all(axis=(1, 2))] if values.shape[1] > 1 else [] for values in strips]
        if flat := [line for values in drawn for line in values]:
            style = {"colors": [(*color, _FADES[third])], "radii": width(ROLES[role]), "draw_order": 15}
            path = log.entity.replace("planner", f"planner/{role}") + f"/{third}"
            yield still(path, rr.LineStrips2D.from_fields(**style))
            yield moving(path, timeline, list(map(len, drawn)), rr.LineStrips2D.columns(strips=flat))


def _color(role: str, palette: Palette) -> Color:
    """Return the colour of a role of `ROLES`: the planned path has the vehicle's colour."""
    return getattr(palette, role.replace("planned", "vehicle"))


def _draw_attention(log: _Log) -> Iterator[Chunk]:
    """Draw lines from the vehicle to the pedestrians, which are wider for larger attention weights, from 0 to 1."""
    seen = np.isfinite(log.position[:, 1:, 0]) & (log.values > 0.02)
    if not seen.any():
        return
    decision, pedestrian = np.nonzero(seen)
    strips = np.stack([log.position[decision, 0], log.position[decision, 1 + pedestrian]], axis=1)
    lines = rr.LineStrips2D.columns(strips=strips, radii=width((6.0 * log.values[seen]).tolist()))
    yield still(log.entity, rr.LineStrips2D.from_fields(colors=[DARK.attention], draw_order=12))
    yield moving(log.entity, moments(log.steps, log.dt), seen.sum(axis=1), lines)


class PlannedPaths(NamedTuple):
    """Paths in metres of one state.

    Attributes:
        predicted: Paths of pedestrians, as the planner predicted them.
        considered: The best paths that the planner considered.
        planned: The path that the planner has chosen.
    """

    predicted: Sequence[Float[np.ndarray, "point 2"]] = ()
    considered: Sequence[Float[np.ndarray, "point 2"]] = ()
    planned: Sequence[Float[np.ndarray, "point 2"]] = ()

    def shapes(self) -> Iterator[Line]:
        """Return the paths as lines of a picture."""
        for role, size in ROLES.items():
            yield from (Line(path, _color(role, LIGHT), 0.6 * size) for path in getattr(self, role))


def read_paths(chunks: Sequence[Chunk], dt: float, *, commands: bool = False) -> dict[int, PlannedPaths]:
    """Read the paths that a planner predicted, considered and planned, by the number of the state.

    Args:
        chunks: All chunks of an episode.
        dt: Length of a step in seconds.
        commands: True to add the commands that the planner compared, as paths of one second.
    """
    paths: dict[int, PlannedPaths] = defaultdict(lambda: PlannedPaths([], [], []))
    for chunk in chunks:
        path = PATHS.fullmatch(chunk.entity_path)
        fan = FAN.fullmatch(chunk.entity_path) if commands else None
        if chunk.is_static or not (path or fan):
            continue
        batch = chunk.to_record_batch()
        if path:
            role, lines = path[1], [strips or [] for strips in batch["LineStrips2D:strips"].to_pylist()]
        elif fan and "Arrows2D:vectors" in batch.schema.names:
            role, lines = "planned" if fan[1] else "considered", _arrows(batch)
        else:
            continue
        states = np.round(batch["time"].cast(pa.int64()).to_numpy() / (1e9 * dt)).astype(int)
        for state, each in zip(states.tolist(), lines, strict=True):
            getattr(paths[state], role).extend(np.array(line, float) for line in each)
    return dict(paths)


def _arrows(batch: pa.RecordBatch) -> list[list[np.ndarray]]:
    """Return the arrows of each time as lines of two points."""
    rows = zip(batch["Arrows2D:origins"].to_pylist(), batch["Arrows2D:vectors"].to_pylist(), strict=True)
    return [[np.array([origin, np.add(origin, vector)]) for vector in vectors] for [origin], vectors in rows]
