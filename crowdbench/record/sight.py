"""What a recording shows of the sensor: where the vehicle sees pedestrians, how far it sees, its lidar's beams."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from jaxtyping import Bool
from rerun.chunk import Chunk

from crowdbench.record.chunks import still
from crowdbench.record.style import FAINT, HIDDEN, PEDESTRIAN, REMEMBERED, VEHICLE, Color
from crowdbench.sim.lines_of_sight import measure_all_beams
from crowdbench.types import Sensor, Trace

MOST_BEAMS = 90
"""Of a lidar with more beams than this, only every second one is drawn, or every third one, ..."""

KEY = (
    "*dark blue: not seen · ring: where the vehicle sees a pedestrian, or (dark ring) remembers it · "
    "grey: range, field of view, lidar*"
)
"""What the marks mean, as text beside the picture."""


def drawn(trace: Trace, row: int, timelines: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """All that is shown of the sensor in one episode; nothing of a perfect one.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        timelines: Times of the states.
    """
    sensor = trace.rules.sensor
    if sensor.lidar is not None:
        yield from _beams(trace, row, timelines)
    if sensor.range is not None or sensor.field_of_view < 360.0:
        yield from _view(trace, row, sensor, timelines)
    if trace.perceived is not None:
        yield from _marks(trace, row, timelines)


def colors(seen: Bool[np.ndarray, "time pedestrian"]) -> list[Color]:
    """The colours of all agents in all states, the vehicle first in each.

    Args:
        seen: Whether the vehicle sees each pedestrian.
    """
    return [
        color for state in seen.tolist() for color in (VEHICLE, *(PEDESTRIAN if each else HIDDEN for each in state))
    ]


def _marks(trace: Trace, row: int, timelines: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """A ring around each pedestrian where the vehicle sees it, or thinks it to be."""
    assert trace.perceived is not None
    assert trace.age is not None
    states = int(trace.steps[row]) + 1
    known, radius = np.isfinite(trace.age[row, :states]), trace.radius[row, :states, 1:]
    seen = trace.seen[row, :states][known].tolist()
    rings = rr.Ellipses2D.columns(
        centers=trace.perceived[row, :states][known],
        half_sizes=np.repeat(radius[known][:, None], 2, axis=1),
        colors=[VEHICLE if each else REMEMBERED for each in seen],
    )
    yield still("world/sight", rr.Ellipses2D.from_fields(line_radii=rr.Radius.ui_points(1.5), draw_order=45))
    yield Chunk.from_columns("world/sight", timelines, [ring.partition(known.sum(axis=1)) for ring in rings])


def _view(trace: Trace, row: int, sensor: Sensor, timelines: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """The outline of what is in range and in the field of view: whose rim is inside and centre in the view is seen."""
    states = int(trace.steps[row]) + 1
    position, heading = trace.position[row, :states, 0], trace.heading[row, :states]
    # Without a range the outline goes beyond all that is shown.
    largest = 2.0 * float(np.nanmax(np.abs(trace.position[row, :states]))) + 10.0
    reach = largest if sensor.range is None else sensor.range + float(trace.radius[row, 0, 0])
    half = math.radians(sensor.field_of_view / 2.0)
    angle = heading[:, None] + np.linspace(-half, half, 49)
    outline = position[:, None] + reach * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    if sensor.field_of_view < 360.0:
        outline = np.concatenate([position[:, None], outline, position[:, None]], axis=1)
    yield still("world/view", rr.LineStrips2D.from_fields(colors=[FAINT], radii=rr.Radius.ui_points(1), draw_order=3))
    yield Chunk.from_columns("world/view", timelines, rr.LineStrips2D.columns(strips=outline).partition([1] * states))


def _beams(trace: Trace, row: int, timelines: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """The beams of the lidar, measured again in each state, from the vehicle to where they end."""
    lidar, states = trace.rules.sensor.lidar, int(trace.steps[row]) + 1
    assert lidar is not None
    distance = np.empty((states, lidar.beams))
    heading, position = trace.heading[row, :states], np.ascontiguousarray(trace.position[row, :states])
    radius, present = (np.ascontiguousarray(each[row, :states]) for each in (trace.radius, trace.present))
    obstacles = np.repeat(trace.obstacles[row][None], states, axis=0)
    measure_all_beams(heading, position, radius, present, obstacles, lidar.range, distance)
    number = np.arange(0, lidar.beams, math.ceil(lidar.beams / MOST_BEAMS))
    angle = heading[:, None] + 2.0 * np.pi * number / lidar.beams
    way = distance[:, number, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    beams = position[:, :1, None] + np.stack([np.zeros_like(way), way], axis=2)
    style = rr.LineStrips2D.from_fields(colors=[FAINT], radii=rr.Radius.ui_points(0.75), draw_order=4)
    yield still("world/lidar", style)
    columns = rr.LineStrips2D.columns(strips=beams.reshape(-1, 2, 2))
    yield Chunk.from_columns("world/lidar", timelines, columns.partition([len(number)] * states))
