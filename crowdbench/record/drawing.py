"""What a recording shows of an episode in the plane.

All of it is under `/world`, whose transform turns y upwards, because Rerun's y points down: the numbers that one
hovers over are the simulator's. The vehicle is yellow, pedestrians are blue, a failure is red.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float, Int
from rerun.chunk import Chunk

from crowdbench.dynamics import Holonomic, nose, outline, reach
from crowdbench.geometry import polygons
from crowdbench.record import approach, decisions, sight
from crowdbench.record.chunks import still, times
from crowdbench.record.hit import pedestrian_hit
from crowdbench.record.plots import is_curve, logs, plots
from crowdbench.record.style import ARROW, CURVES, FAILURE, FAINT, GRID, PEDESTRIAN, SUCCESS, VEHICLE, WALKED, Color
from crowdbench.record.walls import drawn
from crowdbench.types import Outcome, Trace

KEY = "*yellow: vehicle, blue: pedestrians, small dots: their goals · arrow: the way of 1 s · grid: 1 m*"
"""What the picture means, as text beside it."""


_ANGLE = np.linspace(0.0, 2.0 * np.pi, 49)
CIRCLE: Float[np.ndarray, "49 2"] = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], axis=1)


def episode(trace: Trace, row: int, title: str, values: Mapping[str, float | bool]) -> Iterator[Chunk]:
    """All that is shown of one episode.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        title: Which run it belongs to.
        values: Its metrics by name, with units.
    """
    states, dt = int(trace.steps[row]) + 1, trace.rules.dt
    present = np.asarray(trace.present[row, :states].any(axis=0))
    position, velocity = trace.position[row, :states, present], trace.velocity[row, :states, present]
    goal, radius = trace.goal[row, :states, present], trace.radius[row, :states, present]
    same = np.ones((len(position), states - 1), bool)
    same[1:] = np.diff(trace.person[row, :states], axis=0).T[present[1:]] == 0
    low, high = extent(trace, row)
    label = 0.035 * float((high - low).max())  # height of a line of text in the viewer, in metres
    yield still("world", rr.Transform3D(scale=[1.0, -1.0, 1.0]))
    way = np.concatenate([position[0, :1], trace.route[row][~np.isnan(trace.route[row][:, 0])], goal[0, :1]])
    near = radius[0, 0] if trace.rules.goal_tolerance is None else trace.rules.goal_tolerance
    paths = [way, *(path for each, kept in zip(position, same, strict=True) for path in _paths(each, kept))]
    yield _ground(low, high, paths, goal[0, 0], float(near))
    if len(walls := polygons(trace.obstacles[row])):
        yield drawn(walls)
    yield from _trails(position, same, times(1, states, dt))
    timelines = times(0, states, dt)
    yield from _goals(timelines, np.where(np.isnan(position), np.nan, goal))
    seen = None if trace.perceived is None else trace.seen[row, :states, present[1:]]
    yield from _discs(timelines, position, velocity, radius, seen)
    yield from sight.drawn(trace, row, timelines)
    if not isinstance(trace.rules.dynamics, Holonomic):
        yield from _body(trace, row, timelines)
    number = np.flatnonzero(present)
    yield from _names(timelines, position, goal[0, 0], radius, number, label, _name_colors(trace, number))
    sentence, mark = _ending(trace, row, label)
    yield mark
    yield from plots(trace, row)
    yield from logs(trace, row)
    yield from decisions.drawn(trace, row)
    yield from approach.drawn(trace, row, label)
    yield _text("summary", _summary(trace, row, title, sentence))
    yield _text("metrics", _metrics(values))


def extent(trace: Trace, row: int) -> Float[np.ndarray, "2 2"]:
    """The rectangle that an episode needs, with a margin.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.

    Returns:
        The smallest and the largest x and y, in whole metres.
    """
    states = slice(trace.steps[row] + 1)
    present = trace.present[row, states]
    path, goals = trace.position[row, states][present], trace.goal[row, states][present]
    points = np.concatenate([path, goals, *polygons(trace.obstacles[row])])
    margin = 0.5 + reach(trace.rules.body)
    return np.stack([np.floor(points.min(0) - margin), np.ceil(points.max(0) + margin)])


def _ground(
    low: Float[np.ndarray, "2"],
    high: Float[np.ndarray, "2"],
    paths: Sequence[Float[np.ndarray, "_ 2"]],
    goal: Float[np.ndarray, "2"],
    near: float,
) -> Chunk:
    """What does not move: a grid of 1 m, the vehicle's goal and shortest way, and the paths of all agents.

    Args:
        low: Smallest x and y of the grid in metres.
        high: Largest x and y of the grid in metres.
        paths: The vehicle's start, its waypoints and its goal, and the paths, in metres.
        goal: The vehicle's, in metres.
        near: Distance in metres to its goal below which the vehicle has arrived: the ring around the goal.
    """
    # Two lines that turn at the rim, because a line for each metre would take longer to write than all else.
    grid = [_back_and_forth(low, high), _back_and_forth(low[::-1], high[::-1])[:, ::-1]]
    lines = [*grid, *paths, goal + near * CIRCLE]
    colors = [GRID] * len(grid) + [FAINT] * len(paths) + [VEHICLE]
    widths = rr.Radius.ui_points([0.5] * (len(lines) - 1) + [1.5])
    return still("world/ground", rr.LineStrips2D(lines, colors=colors, radii=widths, draw_order=1))


def _back_and_forth(low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> Float[np.ndarray, "corner 2"]:
    """A line up and down through a rectangle, at every metre of its width."""
    x = np.arange(low[0], high[0] + 1).repeat(2)
    y = np.resize([low[1], high[1], high[1], low[1]], len(x))
    return np.stack([x, y], axis=1)


def _paths(position: Float[np.ndarray, "time 2"], same: Bool[np.ndarray, "step"]) -> list[Float[np.ndarray, "_ 2"]]:
    """The paths in metres of all who had the place of one agent, each in a line; `same` tells who stayed in a step."""
    parts = np.split(position, np.flatnonzero(~same) + 1)
    return [part[np.isfinite(part[:, 0])] for part in parts if np.isfinite(part[:, 0]).sum() > 1]


def _goals(timelines: Sequence[rr.TimeColumn], goal: Float[np.ndarray, "agent time 2"]) -> Iterator[Chunk]:
    """The goals as dots, once where they do not change.

    Args:
        timelines: Times of the states.
        goal: In metres, NaN while the agent is not there.
    """
    agents, states = goal.shape[:2]
    colors = _each(VEHICLE, PEDESTRIAN, agents)
    if (goal == goal[:, :1]).all():
        yield still("world/goals", rr.Points2D(goal[:, 0], radii=rr.Radius.ui_points(3), colors=colors))
        return
    yield still("world/goals", rr.Points2D.from_fields(radii=rr.Radius.ui_points(3), colors=colors))
    columns = rr.Points2D.columns(positions=goal.swapaxes(0, 1).reshape(-1, 2))
    yield Chunk.from_columns("world/goals", timelines, columns.partition([agents] * states))


def _each(vehicle: Color, pedestrian: Color, agents: int) -> list[Color]:
    """A colour per agent, the vehicle first."""
    return [vehicle] + [pedestrian] * (agents - 1)


def _trails(
    position: Float[np.ndarray, "agent time 2"],
    same: Bool[np.ndarray, "agent step"],
    timelines: Sequence[rr.TimeColumn],
) -> Iterator[Chunk]:
    """One stroke per agent and step. The blueprint shows all strokes up to the current time, which makes a trail.

    Args:
        position: In metres.
        same: Whether the agent is still the same one after each step; else the stroke is a dot.
        timelines: Times of all states but the first.
    """
    agents, states = position.shape[:2]
    colors = _each(VEHICLE, WALKED, agents)
    yield still("world/trails", rr.LineStrips2D.from_fields(colors=colors, radii=rr.Radius.ui_points(2)))
    before = np.where(same[..., None], position[:, :-1], position[:, 1:])
    strokes = np.stack([before, position[:, 1:]], axis=2).swapaxes(0, 1).reshape(-1, 2, 2)
    columns = rr.LineStrips2D.columns(strips=strokes)
    yield Chunk.from_columns("world/trails", timelines, columns.partition([agents] * (states - 1)))


def _discs(
    timelines: Sequence[rr.TimeColumn],
    position: Float[np.ndarray, "agent time 2"],
    velocity: Float[np.ndarray, "agent time 2"],
    radius: Float[np.ndarray, "agent time"],
    seen: Bool[np.ndarray, "pedestrian time"] | None,
) -> Iterator[Chunk]:
    """Agents as discs of their true size, with an arrow as long as the way of one second.

    Args:
        timelines: Times of the states.
        position: In metres.
        velocity: In m/s.
        radius: In metres.
        seen: Whether the vehicle sees each pedestrian; None where it sees everybody.
    """
    agents, states = position.shape[:2]
    always: dict[str, Any] = {"colors": _each(VEHICLE, PEDESTRIAN, agents)} if seen is None else {}
    changing: dict[str, Any] = {} if seen is None else {"colors": sight.colors(seen.T)}
    if (radius == radius[:, :1]).all():
        always["radii"] = radius[:, 0]
    else:
        changing["radii"] = radius.T.ravel()
    yield still(
        "world/agents",
        rr.Points2D.from_fields(**always),
        rr.Arrows2D.from_fields(colors=[ARROW], radii=rr.Radius.ui_points(1.5), draw_order=40),
    )
    flat, arrow = position.swapaxes(0, 1).reshape(-1, 2), velocity.swapaxes(0, 1).reshape(-1, 2)
    columns = [*rr.Points2D.columns(positions=flat, **changing), *rr.Arrows2D.columns(origins=flat, vectors=arrow)]
    yield Chunk.from_columns("world/agents", timelines, [column.partition([agents] * states) for column in columns])


def _body(trace: Trace, row: int, timelines: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """The rim of a vehicle on wheels, with a line that shows where it faces.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        timelines: Times of the states.
    """
    states = int(trace.steps[row]) + 1
    place = trace.rules.body, trace.position[row, :states, 0], trace.heading[row, :states]
    radius = float(trace.radius[row, 0, 0])
    strips = [line for pair in zip(outline(*place, radius), nose(*place, radius), strict=True) for line in pair]
    yield still("world/body", rr.LineStrips2D.from_fields(colors=[ARROW], radii=rr.Radius.ui_points(2), draw_order=35))
    yield Chunk.from_columns("world/body", timelines, rr.LineStrips2D.columns(strips=strips).partition([2] * states))


def _names(
    timelines: Sequence[rr.TimeColumn],
    position: Float[np.ndarray, "agent time 2"],
    goal: Float[np.ndarray, "2"],
    radius: Float[np.ndarray, "agent time"],
    number: Int[np.ndarray, "agent"],
    label: float,
    colors: Sequence[Color],
) -> Iterator[Chunk]:
    """A name under each disc, and one over the vehicle's goal. At its centre Rerun would write across the disc.

    Args:
        timelines: Times of the states.
        position: In metres.
        goal: The vehicle's goal in metres.
        radius: In metres.
        number: Index of each agent in the trace.
        label: Height of a line of text in metres.
        colors: A colour per name.
    """
    agents, states = position.shape[:2]
    anchors = np.empty((states, agents + 1, 2))
    anchors[:, :-1] = position.swapaxes(0, 1)
    anchors[:, :-1, 1] -= radius.T
    anchors[:, -1] = _above_goal(goal, radius[0, 0], label)
    names = ["vehicle", *(str(agent - 1) for agent in number[1:]), "goal"]
    style = rr.Points2D.from_fields(labels=names, colors=colors, radii=rr.Radius.ui_points(0))
    yield still("world/names", style)
    columns = rr.Points2D.columns(positions=anchors.reshape(-1, 2))
    yield Chunk.from_columns("world/names", timelines, columns.partition([agents + 1] * states))


def _above_goal(goal: Float[np.ndarray, "2"], radius: float, label: float) -> Float[np.ndarray, "2"]:
    """Where the name of the vehicle's goal stands, in metres.

    Args:
        goal: In metres.
        radius: The vehicle's, in metres.
        label: Height of a line of text in metres.
    """
    return goal + np.array([0.0, radius + label])


def _name_colors(trace: Trace, number: Int[np.ndarray, "agent"]) -> list[Color]:
    """The colours of the names: those of the pedestrians' curves where the planner logged a curve of each.

    Args:
        trace: The trace.
        number: Index of each agent in it.
    """
    pedestrians = trace.position.shape[2] - 1
    has_curves = any(is_curve(logged) and logged[0, 0].size == pedestrians > 1 for logged in trace.logs.values())
    each = [CURVES[(agent - 1) % len(CURVES)] if has_curves else PEDESTRIAN for agent in number[1:].tolist()]
    return [VEHICLE, *each, VEHICLE]


def _ending(trace: Trace, row: int, label: float) -> tuple[str, Chunk]:
    """How the episode ended, and its mark in the last state: green or red rims and a ring.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        label: Height of a line of text in metres.

    Returns:
        A sentence, and the mark.
    """
    steps, dt, outcome = int(trace.steps[row]), trace.rules.dt, Outcome(int(trace.outcome[row]))
    sentence, involved = "reaches its goal", [0]
    if outcome is Outcome.TIMEOUT:
        sentence = "runs out of time"
    elif outcome is Outcome.COLLISION:
        hit = pedestrian_hit(trace, row)
        sentence, involved = f"hits pedestrian {hit}", [0, hit + 1]
    elif outcome is Outcome.WALL_COLLISION:
        sentence = "hits an obstacle"
    centers = trace.position[row, steps, involved]
    middle, ring = centers.mean(0), 3.0 * trace.radius[row, 0, 0]
    color = SUCCESS if outcome is Outcome.SUCCESS else FAILURE
    sizes = [*trace.radius[row, steps, involved], ring]
    rims = rr.LineStrips2D.columns(
        strips=[center + size * CIRCLE for center, size in zip([*centers, middle], sizes, strict=True)],
        colors=[color] * len(sizes),
    )
    above, name = (
        middle + np.array([0.0, ring + label]),
        _above_goal(trace.goal[row, 0, 0], trace.radius[row, 0, 0], label),
    )
    if abs(above[0] - name[0]) < 6.0 * label and abs(above[1] - name[1]) < 1.5 * label:
        above[1] = name[1] + 1.5 * label  # as both could not be read
    text = rr.Points2D.columns(positions=[above], labels=[sentence], colors=[color], radii=[rr.Radius.ui_points(0)])
    columns = [column.partition([len(sizes)]) for column in rims] + [column.partition([1]) for column in text]
    return f"{sentence} after {steps * dt:g} s", Chunk.from_columns(
        "world/ending", times(steps, steps + 1, dt), columns
    )


def _text(entity: str, text: str) -> Chunk:
    """A text in Markdown."""
    return still(entity, rr.TextDocument(text, media_type="text/markdown"))


def _summary(trace: Trace, row: int, title: str, sentence: str) -> str:
    """The text beside the picture.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        title: Which run it belongs to.
        sentence: How it ended.
    """
    lines = [f"# {Outcome(int(trace.outcome[row])).label.capitalize().replace('_', ' ')}: {sentence}"]
    keys = [KEY, approach.KEY, *([] if trace.perceived is None else [sight.KEY]), decisions.key(trace)]
    lines += [f"{trace.split} case {trace.case[row]} · {title}", "", " · ".join(filter(None, keys))]
    return "\n".join(lines)


def _metrics(values: Mapping[str, float | bool]) -> str:
    """The metrics of an episode as a table in two columns; those that are undefined are left out.

    Args:
        values: By name, with units.
    """
    defined = {name: value for name, value in values.items() if np.isfinite(value)}
    cells = [f"{name} | {_value(value)}" for name, value in defined.items()]
    cells += [" | "] * (len(cells) % 2)
    half = len(cells) // 2
    lines = ["| metric | value | metric | value |", "|---|---:|---|---:|"]
    lines += [f"| {left} | {right} |" for left, right in zip(cells[:half], cells[half:], strict=True)]
    return "\n".join(lines)


def _value(value: float | bool) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else f"{value:.4g}"
