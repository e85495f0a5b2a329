"""Marks of a recording in addition to the agents: measurements of the sensor, and the closest approach ahead."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from crowdbench.core.arrays import Numbers, Vectors
from crowdbench.core.geometry import norm
from crowdbench.core.types import Outcome, Trace
from crowdbench.drawing import DARK
from crowdbench.record.rrd import moments, moving, still, width
from crowdbench.sim.lidar import measure_beams

MOST_BEAMS = 90
"""Largest number of beams that are drawn. Of a lidar with more, only every second beam is drawn, or every third, ..."""

AHEAD = 2.0
"""Only a closest approach within this time is shown, in seconds."""

NEAR = 0.5
"""The largest gap in metres that is shown."""


def draw_sensor(trace: Trace, row: int, timeline: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """Draw the measurements and limits of the sensor in one episode; nothing for a perfect sensor.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        timeline: Times of the states.
    """
    sensor = trace.rules.sensor
    if sensor.lidar is not None:
        yield from _draw_beams(trace, row, timeline)
    if sensor.range is not None or sensor.field_of_view < 360.0:
        yield from _draw_view(trace, row, timeline)
    if trace.perceived is not None:
        yield from _draw_perceived(trace, row, timeline)


def _draw_perceived(trace: Trace, row: int, timeline: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """Draw a ring around each pedestrian at the position that the vehicle measures or remembers."""
    assert trace.perceived is not None
    assert trace.age is not None
    states = int(trace.steps[row]) + 1
    known, detector, seen = np.isfinite(trace.age[row, :states]), trace.rules.sensor.detector, trace.seen[row, :states]
    radius = trace.radius[row, :states, 1:]
    if detector is not None:  # the rings are tracks
        late = trace.rules.sensor.delay + 0.5 * trace.rules.dt
        radius, seen = np.full(known.shape, detector.radius), trace.age[row, :states] < late
    colors = [DARK.vehicle if is_seen else DARK.considered for is_seen in seen[known].tolist()]
    sizes = np.repeat(radius[known][:, None], 2, axis=1)
    rings = rr.Ellipses2D.columns(centers=trace.perceived[row, :states][known], half_sizes=sizes, colors=colors)
    yield still("world/sight", rr.Ellipses2D.from_fields(line_radii=width(1.5), draw_order=45))
    yield moving("world/sight", timeline, known.sum(axis=1), rings)


def _draw_view(trace: Trace, row: int, timeline: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """Draw the outline of the range and the field of view: a pedestrian with its rim in range and its centre in the
    field is seen."""
    sensor, states = trace.rules.sensor, int(trace.steps[row]) + 1
    position, heading = trace.position[row, :states, 0], trace.heading[row, :states]
    # Without a range the outline goes beyond all that is shown.
    largest = 2.0 * float(np.nanmax(np.abs(trace.position[row, :states]))) + 10.0
    reach = largest if sensor.range is None else sensor.range + float(trace.radius[row, 0, 0])
    half = math.radians(sensor.field_of_view / 2.0)
    angle = heading[:, None] + np.linspace(-half, half, 49)
    outline = position[:, None] + reach * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    if sensor.field_of_view < 360.0:
        outline = np.concatenate([position[:, None], outline, position[:, None]], axis=1)
    yield still("world/view", rr.LineStrips2D.from_fields(colors=[DARK.faint], radii=width(1), draw_order=3))
    yield moving("world/view", timeline, [1] * states, rr.LineStrips2D.columns(strips=outline))


def _draw_beams(trace: Trace, row: int, timeline: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """Draw the beams of the lidar without noise, measured again in each state, from the vehicle to their ends."""
    lidar, states = trace.rules.sensor.lidar, int(trace.steps[row]) + 1
    assert lidar is not None
    distance = np.empty((states, 1, lidar.beams))
    arrays = trace.position, trace.velocity, trace.radius, trace.present, trace.person
    people = [np.ascontiguousarray(array[row, :states]) for array in arrays]
    position, heading, seconds = people[0], trace.heading[row, :states, None], np.arange(states) * trace.rules.dt
    obstacles = np.repeat(trace.obstacles[row][None], states, axis=0)
    shown = seconds if lidar.legs else np.zeros(0)
    measure_beams(heading, *people, shown, np.zeros(0), obstacles, lidar.range, distance)
    distance = distance[:, 0]
    number = np.arange(0, lidar.beams, math.ceil(lidar.beams / MOST_BEAMS))
    angle = heading + 2.0 * np.pi * number / lidar.beams
    beam = distance[:, number, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    beams = (position[:, :1, None] + np.stack([np.zeros_like(beam), beam], axis=2)).reshape(-1, 2, 2)
    yield still("world/lidar", rr.LineStrips2D.from_fields(colors=[DARK.faint], radii=width(0.75), draw_order=4))
    yield moving("world/lidar", timeline, [len(number)] * states, rr.LineStrips2D.columns(strips=beams))


def time_to_closest(position: Vectors, velocity: Vectors) -> Numbers:
    """Return the time in seconds until two points with constant velocities are closest to each other, at most `AHEAD`.

    Args:
        position: Position of one point relative to the other, in metres.
        velocity: Velocity of one point relative to the other, in m/s.
    """
    speed = (velocity**2).sum(axis=-1)
    when = -(position * velocity).sum(axis=-1) / np.where(speed > 0.0, speed, np.inf)
    return np.clip(when, 0.0, AHEAD)


def draw_approach(trace: Trace, row: int, label: float) -> Iterator[Chunk]:
    """Draw the closest approach ahead of each state, if it is soon: a line between both centres at that time, with the
    gap and the time.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        label: Height of a line of text in metres.
    """
    states = int(trace.steps[row]) + 1
    position, velocity = trace.position[row, :states], trace.velocity[row, :states]
    if position.shape[1] == 1:
        return
    when = time_to_closest(position[:, 1:] - position[:, :1], velocity[:, 1:] - velocity[:, :1])
    vehicle, pedestrian = (position[:, who] + velocity[:, who] * when[..., None] for who in (slice(1), slice(1, None)))
    gap = norm(pedestrian - vehicle) - trace.radius[row, :states, 1:] - trace.radius[row, :states, :1]
    gap = np.where(np.isfinite(gap) & (when > 0.0) & (when < AHEAD), gap, np.inf)
    state, who = np.arange(states), gap.argmin(axis=1)
    is_shown = gap[state, who] < NEAR
    if trace.outcome[row] == Outcome.COLLISION:
        is_shown[-1] = False  # the collision is marked in this state
    if not is_shown.any():
        return
    nearest = state[is_shown], who[is_shown]
    lines = np.stack([vehicle[nearest], pedestrian[nearest]], axis=1)
    labels = [f"{max(g, 0.0):.2f} m in {t:.1f} s" for g, t in zip(gap[nearest], when[nearest], strict=True)]
    colors = [DARK.contact if distance < 0.0 else DARK.wall for distance in gap[nearest]]
    # The text stands over the pedestrian, away from the vehicle's name.
    above = lines[:, 1] + [0.0, trace.radius[row, 0, 0] + label]
    style = rr.LineStrips2D.from_fields(radii=width(1.5), draw_order=46)
    yield still("world/approach", style, rr.Points2D.from_fields(radii=width(0)))
    strips = rr.LineStrips2D.columns(strips=lines, colors=colors)
    texts = rr.Points2D.columns(positions=above, labels=labels, colors=colors)
    yield moving("world/approach", moments(state, trace.rules.dt), is_shown.astype(int), strips, texts)
