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

from crowdbench.core.dynamics import Holonomic, nose, outline, reach
from crowdbench.core.geometry import polygons
from crowdbench.core.types import Outcome, Trace
from crowdbench.drawing import moment
from crowdbench.drawing.palette import CURVES, DARK, GRID, SUCCESS, Color
from crowdbench.record.decisions import draw_decisions
from crowdbench.record.marks import draw_approach, draw_sensor
from crowdbench.record.plots import draw_logs, draw_plots, is_curve, metrics_text, summary_text
from crowdbench.record.rrd import moments, moving, still

HATCHING = 0.25
"""Distance in metres between the lines that fill an obstacle."""

_ANGLE = np.linspace(0.0, 2.0 * np.pi, 49)
CIRCLE: Float[np.ndarray, "49 2"] = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], axis=1)


def draw_episode(trace: Trace, row: int, title: str, values: Mapping[str, float | bool]) -> Iterator[Chunk]:
    """All that is shown of one episode.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        title: Which run it belongs to.
        values: Its metrics by name, with units.
    """
    states, dt = int(trace.steps[row]) + 1, trace.rules.dt
    number = np.flatnonzero(trace.present[row, :states].any(axis=0))
    position, velocity = trace.position[row, :states][:, number], trace.velocity[row, :states][:, number]
    goal, radius = trace.goal[row, :states][:, number], trace.radius[row, :states][:, number]
    same = np.ones((states - 1, len(number)), bool)
    same[:, 1:] = np.diff(trace.person[row, :states], axis=0)[:, number[1:] - 1] == 0
    low, high = extent(trace, row)
    label = 0.035 * float((high - low).max())  # height of a line of text in the viewer, in metres
    yield still("world", rr.Transform3D(scale=[1.0, -1.0, 1.0]))
    way = np.concatenate([position[:1, 0], trace.route[row][~np.isnan(trace.route[row][:, 0])], goal[:1, 0]])
    paths = [path for agent in range(len(number)) for path in moment.paths(position[:, agent], same[:, agent])]
    near = trace.rules.goal_tolerance
    yield _draw_ground(low, high, [way, *paths], goal[0, 0], float(radius[0, 0] if near is None else near))
    if len(walls := polygons(trace.obstacles[row])):
        yield _draw_walls(walls)
    timeline = moments(np.arange(states), dt)
    yield from _draw_trails(position, same, moments(np.arange(1, states), dt))
    yield from _draw_goals(timeline, np.where(np.isnan(position), np.nan, goal))
    seen = None if trace.perceived is None else trace.seen[row, :states][:, number[1:] - 1]
    yield from _draw_discs(timeline, position, velocity, radius, seen)
    yield from draw_sensor(trace, row, timeline)
    if not isinstance(trace.rules.dynamics, Holonomic):
        yield from _draw_body(trace, row, timeline)
    yield from _draw_names(timeline, position, goal[0, 0], radius, number, label, _name_colors(trace, number))
    sentence, mark = _draw_ending(trace, row, label)
    yield mark
    yield from draw_plots(trace, row)
    yield from draw_logs(trace, row)
    yield from draw_decisions(trace, row)
    yield from draw_approach(trace, row, label)
    for entity, text in (("summary", summary_text(trace, row, title, sentence)), ("metrics", metrics_text(values))):
        yield still(entity, rr.TextDocument(text, media_type="text/markdown"))


def extent(trace: Trace, row: int) -> Float[np.ndarray, "2 2"]:
    """The smallest and the largest x and y that an episode needs with a margin, in whole metres."""
    states = slice(trace.steps[row] + 1)
    present = trace.present[row, states]
    agents = trace.position[row, states][present], trace.goal[row, states][present]
    low, high = moment.extent(*agents, trace.obstacles[row], 0.5 + reach(trace.rules.body))
    return np.stack([np.floor(low), np.ceil(high)])


def _draw_ground(
    low: Float[np.ndarray, "2"],
    high: Float[np.ndarray, "2"],
    paths: Sequence[Float[np.ndarray, "_ 2"]],
    goal: Float[np.ndarray, "2"],
    near: float,
) -> Chunk:
    """What does not move: a grid of 1 m, paths, and a ring around the vehicle's goal, inside which it has arrived."""
    # Two lines that turn at the rim, because a line for each metre would take longer to write than all else.
    grid = [_back_and_forth(low, high), _back_and_forth(low[::-1], high[::-1])[:, ::-1]]
    lines = [*grid, *paths, goal + near * CIRCLE]
    colors = [GRID] * len(grid) + [DARK.faint] * len(paths) + [DARK.vehicle]
    widths = rr.Radius.ui_points([0.5] * (len(lines) - 1) + [1.5])
    return still("world/ground", rr.LineStrips2D(lines, colors=colors, radii=widths, draw_order=1))


def _back_and_forth(low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> Float[np.ndarray, "corner 2"]:
    """A line up and down through a rectangle, at every metre of its width."""
    x = np.arange(low[0], high[0] + 1).repeat(2)
    y = np.resize([low[1], high[1], high[1], low[1]], len(x))
    return np.stack([x, y], axis=1)


def _draw_walls(walls: Sequence[Float[np.ndarray, "_ 2"]]) -> Chunk:
    """The outlines of obstacles; those of solid ones are closed and hatched, because the viewer fills none."""
    outlines = [np.concatenate([wall, wall[:1]]) if len(wall) > 2 else wall for wall in walls]
    lines = [*outlines, *(line for wall in walls if len(wall) > 2 for line in _hatch(wall))]
    widths = rr.Radius.ui_points([2.0] * len(outlines) + [0.75] * (len(lines) - len(outlines)))
    return still("world/walls", rr.LineStrips2D(lines, colors=[DARK.wall] * len(lines), radii=widths, draw_order=2))


def _hatch(polygon: Float[np.ndarray, "corner 2"]) -> list[Float[np.ndarray, "2 2"]]:
    """Lines at 45 degrees within a polygon."""
    # Turned by 45 degrees, the lines are horizontal: each crosses the edges where it enters and where it leaves.
    turned = polygon @ np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
    after = np.roll(turned, -1, axis=0)
    low, high = turned[:, 1].min(), turned[:, 1].max()
    lines = []
    for y in np.arange(np.ceil(low / HATCHING) * HATCHING, high, HATCHING):
        crossed = (turned[:, 1] > y) != (after[:, 1] > y)
        a, b = turned[crossed], after[crossed]
        x = np.sort(a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]))
        ends = np.stack([x, np.full(len(x), y)], axis=1) @ np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
        lines += list(ends.reshape(-1, 2, 2))
    return lines


def _draw_goals(timeline: Sequence[rr.TimeColumn], goal: Float[np.ndarray, "time agent 2"]) -> Iterator[Chunk]:
    """The goals as dots, once where they do not change; NaN is the goal of an agent that is not there."""
    states, agents = goal.shape[:2]
    style: dict[str, Any] = {"radii": rr.Radius.ui_points(3), "colors": _each(DARK.vehicle, DARK.pedestrian, agents)}
    if (goal == goal[:1]).all():
        yield still("world/goals", rr.Points2D(goal[0], **style))
        return
    yield still("world/goals", rr.Points2D.from_fields(**style))
    yield moving("world/goals", timeline, [agents] * states, rr.Points2D.columns(positions=goal.reshape(-1, 2)))


def _each(vehicle: Color, pedestrian: Color, agents: int) -> list[Color]:
    """A colour per agent, the vehicle first."""
    return [vehicle] + [pedestrian] * (agents - 1)


def _draw_trails(
    position: Float[np.ndarray, "time agent 2"],
    same: Bool[np.ndarray, "step agent"],
    timeline: Sequence[rr.TimeColumn],
) -> Iterator[Chunk]:
    """One stroke per agent and step. The blueprint shows all strokes up to the current time, which makes a trail.

    The stroke is a dot where the agent is not the same one after the step.
    """
    states, agents = position.shape[:2]
    colors = _each(DARK.vehicle, DARK.walked, agents)
    yield still("world/trails", rr.LineStrips2D.from_fields(colors=colors, radii=rr.Radius.ui_points(2)))
    before = np.where(same[..., None], position[:-1], position[1:])
    strokes = np.stack([before, position[1:]], axis=2).reshape(-1, 2, 2)
    yield moving("world/trails", timeline, [agents] * (states - 1), rr.LineStrips2D.columns(strips=strokes))


def _draw_discs(
    timeline: Sequence[rr.TimeColumn],
    position: Float[np.ndarray, "time agent 2"],
    velocity: Float[np.ndarray, "time agent 2"],
    radius: Float[np.ndarray, "time agent"],
    seen: Bool[np.ndarray, "time pedestrian"] | None,
) -> Iterator[Chunk]:
    """Agents as discs of their true size, darker if the vehicle does not see them, with the way of one second."""
    states, agents = position.shape[:2]
    always: dict[str, Any] = {}
    changing: dict[str, Any] = {}
    if seen is None:
        always["colors"] = _each(DARK.vehicle, DARK.pedestrian, agents)
    else:
        crowds = ([DARK.pedestrian if each else DARK.hidden for each in state] for state in seen.tolist())
        changing["colors"] = [color for crowd in crowds for color in (DARK.vehicle, *crowd)]
    if (radius == radius[:1]).all():
        always["radii"] = radius[0]
    else:
        changing["radii"] = radius.ravel()
    yield still(
        "world/agents",
        rr.Points2D.from_fields(**always),
        rr.Arrows2D.from_fields(colors=[DARK.text], radii=rr.Radius.ui_points(1.5), draw_order=40),
    )
    flat = position.reshape(-1, 2)
    discs = rr.Points2D.columns(positions=flat, **changing)
    arrows = rr.Arrows2D.columns(origins=flat, vectors=velocity.reshape(-1, 2))
    yield moving("world/agents", timeline, [agents] * states, discs, arrows)


def _draw_body(trace: Trace, row: int, timeline: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """The rim of a vehicle on wheels, with a line that shows where it faces."""
    states = int(trace.steps[row]) + 1
    place = trace.rules.body, trace.position[row, :states, 0], trace.heading[row, :states]
    radius = float(trace.radius[row, 0, 0])
    strips = [line for pair in zip(outline(*place, radius), nose(*place, radius), strict=True) for line in pair]
    style = rr.LineStrips2D.from_fields(colors=[DARK.text], radii=rr.Radius.ui_points(2), draw_order=35)
    yield still("world/body", style)
    yield moving("world/body", timeline, [2] * states, rr.LineStrips2D.columns(strips=strips))


def _draw_names(
    timeline: Sequence[rr.TimeColumn],
    position: Float[np.ndarray, "time agent 2"],
    goal: Float[np.ndarray, "2"],
    radius: Float[np.ndarray, "time agent"],
    number: Int[np.ndarray, "agent"],
    label: float,
    colors: Sequence[Color],
) -> Iterator[Chunk]:
    """A name under each disc, and one over the vehicle's goal. At its centre Rerun would write across the disc.

    Args:
        timeline: Times of the states.
        position: In metres.
        goal: The vehicle's goal in metres.
        radius: In metres.
        number: Index of each agent in the trace.
        label: Height of a line of text in metres.
        colors: A colour per name.
    """
    states, agents = position.shape[:2]
    anchors = np.empty((states, agents + 1, 2))
    anchors[:, :-1] = position
    anchors[:, :-1, 1] -= radius
    anchors[:, -1] = _above_goal(goal, radius[0, 0], label)
    names = ["vehicle", *(str(agent - 1) for agent in number[1:]), "goal"]
    yield still("world/names", rr.Points2D.from_fields(labels=names, colors=colors, radii=rr.Radius.ui_points(0)))
    yield moving("world/names", timeline, [agents + 1] * states, rr.Points2D.columns(positions=anchors.reshape(-1, 2)))


def _above_goal(goal: Float[np.ndarray, "2"], radius: float, label: float) -> Float[np.ndarray, "2"]:
    """Where the name of the vehicle's goal stands, in metres; `label` is the height of a line of text."""
    return goal + np.array([0.0, radius + label])


def _name_colors(trace: Trace, number: Int[np.ndarray, "agent"]) -> list[Color]:
    """The colours of the names: those of the pedestrians' curves where the planner logged a curve of each."""
    pedestrians = trace.position.shape[2] - 1
    has_curves = any(is_curve(logged) and logged[0, 0].size == pedestrians > 1 for logged in trace.logs.values())
    each = [CURVES[(agent - 1) % len(CURVES)] if has_curves else DARK.pedestrian for agent in number[1:].tolist()]
    return [DARK.vehicle, *each, DARK.vehicle]


def _draw_ending(trace: Trace, row: int, label: float) -> tuple[str, Chunk]:
    """How the episode ended, as a sentence, and its mark in the last state: green or red rims and a ring."""
    steps, dt, outcome = int(trace.steps[row]), trace.rules.dt, Outcome(int(trace.outcome[row]))
    sentence, involved = "reaches its goal", [0]
    if outcome is Outcome.TIMEOUT:
        sentence = "runs out of time"
    elif outcome is Outcome.COLLISION:
        hit = moment.pedestrian_hit(trace, row)
        sentence, involved = f"hits pedestrian {hit}", [0, hit + 1]
    elif outcome is Outcome.WALL_COLLISION:
        sentence = "hits an obstacle"
    centers, radius = trace.position[row, steps, involved], trace.radius[row, 0, 0]
    middle, ring = centers.mean(0), 3.0 * radius
    color = SUCCESS if outcome is Outcome.SUCCESS else DARK.failure
    sizes = [*trace.radius[row, steps, involved], ring]
    rims = rr.LineStrips2D.columns(
        strips=[center + size * CIRCLE for center, size in zip([*centers, middle], sizes, strict=True)],
        colors=[color] * len(sizes),
    )
    above, name = middle + np.array([0.0, ring + label]), _above_goal(trace.goal[row, 0, 0], radius, label)
    if abs(above[0] - name[0]) < 6.0 * label and abs(above[1] - name[1]) < 1.5 * label:
        above[1] = name[1] + 1.5 * label  # as both could not be read
    text = rr.Points2D.columns(positions=[above], labels=[sentence], colors=[color], radii=[rr.Radius.ui_points(0)])
    columns = [*rims.partition([len(sizes)]), *text.partition([1])]
    timeline = moments(np.array([steps]), dt)
    return f"{sentence} after {steps * dt:g} s", Chunk.from_columns("world/ending", timeline, columns)
