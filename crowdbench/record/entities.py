"""An episode in the plane of a recording.

Paths, colours and marks come from `crowdbench.drawing`. All entities are under `/world`. Its transform turns y upwards,
because Rerun's y points down: numbers in the viewer's tooltips are the simulator's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import shapely
from jaxtyping import Float
from rerun.chunk import Chunk

from crowdbench import drawing
from crowdbench.core.dynamics import Holonomic, nose, outline, reach
from crowdbench.core.geometry import polygons
from crowdbench.core.types import Outcome, Trace
from crowdbench.drawing import CIRCLE, DARK, DASHES, GRID, Color
from crowdbench.metrics.contacts import contacts_of
from crowdbench.record.blueprint import draw_logs, draw_plots
from crowdbench.record.decisions import draw_decisions
from crowdbench.record.explanation import legend_text, metrics_text, summary_text
from crowdbench.record.marks import draw_approach, draw_sensor
from crowdbench.record.rrd import moments, moving, still, width

HATCHING = 0.4
"""Distance in metres between the lines that fill an obstacle."""


class _Agents:
    """The agents that are present at any time of an episode, in all its states.

    Attributes:
        trace: The trace with the episode.
        row: Its row in the trace.
        number: Index of each of the agents in the trace.
        position: `[time, agent, 2]`, in metres; NaN if an agent is absent.
        velocity: `[time, agent, 2]`, in m/s.
        goal: `[time, agent, 2]`, in metres.
        radius: `[time, agent]`, in metres.
        stayed: `[step, agent]`, True if the agent is the same one after the step.
        timeline: Times of the states.
        low: The smallest x and y to show, in metres.
        high: The largest ones.
        label: Height of a line of text in the viewer, in metres.
    """

    def __init__(self, trace: Trace, row: int) -> None:
        states = slice(int(trace.steps[row]) + 1)
        self.trace, self.row = trace, row
        self.number = np.flatnonzero(trace.present[row, states].any(axis=0))
        arrays = (trace.position, trace.velocity, trace.goal, trace.radius)
        self.position, self.velocity, self.goal, self.radius = (array[row, states][:, self.number] for array in arrays)
        self.stayed = drawing.same_agents(trace.person[row, states])[:, self.number]
        self.timeline = moments(np.arange(states.stop), trace.rules.dt)
        self.low, self.high = extent(trace, row)
        self.label = 0.035 * float((self.high - self.low).max())

    def moving(self, entity: str, *columns: rr.ComponentColumnList, number: int | None = None) -> Chunk:
        """Return the chunk of an entity with `number` elements in each state, or one element per agent if None."""
        states, agents = self.radius.shape
        return moving(entity, self.timeline, [number or agents] * states, *columns)

    def colors(self, vehicle: Color, pedestrian: Color) -> list[Color]:
        """Return a colour per agent, the vehicles first."""
        return [vehicle if agent < self.trace.rules.vehicles else pedestrian for agent in self.number]


def draw_episode(trace: Trace, row: int, title: str, values: Mapping[str, str]) -> Iterator[Chunk]:
    """Draw all of one episode.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        title: Planner and scenario of the run.
        values: Its metrics as texts, by title.
    """
    agents = _Agents(trace, row)
    yield still("world", rr.Transform3D(scale=[1.0, -1.0, 1.0]))
    yield _draw_ground(agents)
    if len(walls := polygons(trace.obstacles[row])):
        yield _draw_walls(walls)
    yield from _draw_trails(agents)
    yield from _draw_goals(agents)
    yield from _draw_discs(agents)
    yield from draw_sensor(trace, row, agents.timeline)
    if not isinstance(trace.rules.dynamics, Holonomic):
        yield from _draw_body(agents)
    yield from _draw_names(agents)
    yield _draw_ending(agents)
    yield from draw_plots(trace, row)
    yield from draw_logs(trace, row)
    yield from draw_decisions(trace, row)
    yield from draw_approach(trace, row, agents.label)
    texts = {"summary": summary_text(trace, row, title), "legend": legend_text(trace, row)}
    for entity, text in (texts | {"metrics": metrics_text(values)}).items():
        yield still(entity, rr.TextDocument(text, media_type="text/markdown"))


def extent(trace: Trace, row: int) -> Float[np.ndarray, "2 2"]:
    """Return the smallest and the largest x and y of an episode, with a margin, in whole metres."""
    states = slice(trace.steps[row] + 1)
    present = trace.present[row, states]
    agents = trace.position[row, states][present], trace.goal[row, states][present]
    low, high = drawing.extent(*agents, trace.obstacles[row], 0.5 + reach(trace.rules.body))
    return np.stack([np.floor(low), np.ceil(high)])


def _draw_ground(agents: _Agents) -> Chunk:
    """Return the static marks: a grid of 1 m, paths, and the ring around the vehicle's goal that counts as arrival."""
    trace, row, position, goal = agents.trace, agents.row, agents.position, agents.goal[0, 0]
    low, high = agents.low, agents.high
    # Two lines that turn at the rim, because writing a line per metre would take longer than all other marks.
    grid = [_back_and_forth(low, high), _back_and_forth(low[::-1], high[::-1])[:, ::-1]]
    route = trace.route[row][~np.isnan(trace.route[row][:, 0])]
    paths = [np.concatenate([position[:1, 0], route, goal[None]])]
    paths += [path for agent, same in enumerate(agents.stayed.T) for path in drawing.paths(position[:, agent], same)]
    near = trace.rules.goal_tolerance
    lines = [*grid, *paths, goal + float(agents.radius[0, 0] if near is None else near) * CIRCLE]
    colors = [GRID] * len(grid) + [DARK.faint] * len(paths) + [DARK.vehicle]
    widths = width([0.5] * (len(lines) - 1) + [1.5])
    return still("world/ground", rr.LineStrips2D(lines, colors=colors, radii=widths, draw_order=1))


def _back_and_forth(low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> Float[np.ndarray, "corner 2"]:
    """Return a line up and down through a rectangle, at every metre of its width."""
    x = np.arange(low[0], high[0] + 1).repeat(2)
    y = np.resize([low[1], high[1], high[1], low[1]], len(x))
    return np.stack([x, y], axis=1)


def _draw_walls(walls: Sequence[Float[np.ndarray, "_ 2"]]) -> Chunk:
    """Draw the outlines of obstacles; solid ones are closed and hatched, because the viewer does not fill polygons."""
    outlines = [np.concatenate([wall, wall[:1]]) if len(wall) > 2 else wall for wall in walls]
    lines = [*outlines, *(line for wall in walls if len(wall) > 2 for line in _hatch(wall))]
    hatches = len(lines) - len(outlines)
    widths = width([2.0] * len(outlines) + [0.75] * hatches)
    colors = [DARK.wall] * len(outlines) + [DARK.faint] * hatches
    return still("world/walls", rr.LineStrips2D(lines, colors=colors, radii=widths, draw_order=2))


def _hatch(polygon: Float[np.ndarray, "corner 2"]) -> list[Float[np.ndarray, "point 2"]]:
    """Return lines at 45 degrees within a polygon."""
    (left, bottom), (right, top) = polygon.min(axis=0), polygon.max(axis=0)
    starts = np.arange(left - (top - bottom), right, HATCHING * np.sqrt(2.0))
    lines = shapely.linestrings([[(x, bottom), (x + top - bottom, top)] for x in starts])
    inside = shapely.get_parts(shapely.intersection(lines, shapely.polygons(polygon)))
    return [shapely.get_coordinates(part) for part in inside[shapely.length(inside) > 0.0]]


def _draw_goals(agents: _Agents) -> Iterator[Chunk]:
    """Draw the goals of the agents that are present as dots."""
    goal = np.where(np.isnan(agents.position), np.nan, agents.goal)
    colors = agents.colors(DARK.vehicle, DARK.pedestrian)
    yield still("world/goals", rr.Points2D.from_fields(radii=width(3), colors=colors))
    yield agents.moving("world/goals", rr.Points2D.columns(positions=goal.reshape(-1, 2)))


def _draw_trails(agents: _Agents) -> Iterator[Chunk]:
    """Draw one stroke per agent and step. The blueprint shows all strokes up to the current time, which makes a trail.

    The stroke is a dot if the agent is not the same one after the step.
    """
    steps, number = agents.stayed.shape
    yield still(
        "world/trails", rr.LineStrips2D.from_fields(colors=agents.colors(DARK.vehicle, DARK.walked), radii=width(2))
    )
    after = agents.position[1:]
    before = np.where(agents.stayed[..., None], agents.position[:-1], after)
    strokes = rr.LineStrips2D.columns(strips=np.stack([before, after], axis=2).reshape(-1, 2, 2))
    timeline = moments(np.arange(1, steps + 1), agents.trace.rules.dt)
    yield moving("world/trails", timeline, [number] * steps, strokes)


def _draw_discs(agents: _Agents) -> Iterator[Chunk]:
    """Draw agents as discs of their true size, or dashed outlines if the vehicle does not see them, with velocities."""
    trace, radius = agents.trace, agents.radius
    always: dict[str, Any] = {"colors": agents.colors(DARK.vehicle, DARK.pedestrian)}
    changing: dict[str, Any] = {}
    if trace.perceived is not None:
        unseen = ~trace.seen[agents.row, : len(radius)][:, agents.number[1:] - 1]
        radius = np.where(np.insert(unseen, 0, False, axis=1), 0.0, radius)
        unseen &= np.isfinite(agents.position[:, 1:, 0])
        centre, reach = agents.position[:, 1:][unseen], agents.radius[:, 1:][unseen]
        dashes = (centre[:, None, None] + reach[:, None, None, None] * DASHES).reshape(-1, *DASHES.shape[1:])
        if len(dashes):
            style = rr.LineStrips2D.from_fields(colors=[DARK.pedestrian], radii=width(1.5), draw_order=30)
            yield still("world/unseen", style)
            counts, strips = len(DASHES) * unseen.sum(axis=1), rr.LineStrips2D.columns(strips=dashes)
            yield moving("world/unseen", agents.timeline, counts, strips)
    if (radius == radius[:1]).all():
        always["radii"] = radius[0]
    else:
        changing["radii"] = radius.ravel()
    arrows = rr.Arrows2D.from_fields(colors=[DARK.text], radii=width(1.5), draw_order=40)
    yield still("world/agents", rr.Points2D.from_fields(**always), arrows)
    flat = agents.position.reshape(-1, 2)
    discs = rr.Points2D.columns(positions=flat, **changing)
    yield agents.moving(
        "world/agents", discs, rr.Arrows2D.columns(origins=flat, vectors=agents.velocity.reshape(-1, 2))
    )


def _draw_body(agents: _Agents) -> Iterator[Chunk]:
    """Draw the rim of a vehicle on wheels, with a line that shows its heading."""
    heading = agents.trace.heading[agents.row, : len(agents.radius)]
    body = agents.trace.rules.body, agents.position[:, 0], heading, float(agents.radius[0, 0])
    strips = [line for pair in zip(outline(*body), nose(*body), strict=True) for line in pair]
    yield still("world/body", rr.LineStrips2D.from_fields(colors=[DARK.text], radii=width(2), draw_order=35))
    yield agents.moving("world/body", rr.LineStrips2D.columns(strips=strips), number=2)


def _draw_names(agents: _Agents) -> Iterator[Chunk]:
    """Draw a name under each disc, and one over the vehicle's goal. A name at its centre would cover the disc."""
    states, number = agents.radius.shape
    anchors = np.empty((states, number + 1, 2))
    anchors[:, :-1] = agents.position
    anchors[:, :-1, 1] -= agents.radius
    anchors[:, -1] = agents.goal[0, 0] + np.array([0.0, agents.radius[0, 0] + agents.label])
    others = (drawing.agent_name(agent, agents.trace.rules) for agent in agents.number[1:].tolist())
    names = ["vehicle", *(name.removeprefix("pedestrian ") for name in others), "goal"]
    colors = [*agents.colors(DARK.vehicle, DARK.pedestrian), DARK.vehicle]
    yield still("world/names", rr.Points2D.from_fields(labels=names, colors=colors, radii=width(0)))
    yield agents.moving("world/names", rr.Points2D.columns(positions=anchors.reshape(-1, 2)), number=number + 1)


def _draw_ending(agents: _Agents) -> Chunk:
    """Draw the outcome of the episode in the last state: rims, and a ring around them, or a star for a contact."""
    trace, row = agents.trace, agents.row
    steps, outcome = int(trace.steps[row]), Outcome(int(trace.outcome[row]))
    involved = [0, *contacts_of(trace).agent[[row]]][: 1 + (outcome is Outcome.COLLISION)]
    position, radius = trace.position[row, steps, involved], trace.radius[row, steps, involved]
    is_contact = outcome in (Outcome.COLLISION, Outcome.WALL_COLLISION)
    around = drawing.burst(position, radius) if is_contact else position.mean(axis=0) + 3.0 * radius[0] * CIRCLE
    strips = [centre + size * CIRCLE for centre, size in zip(position, radius, strict=True)]
    strips.append(np.concatenate([around, around[:2]]))
    color = DARK.success if outcome is Outcome.SUCCESS else DARK.contact
    lines = rr.LineStrips2D.columns(strips=strips, colors=[color] * len(strips))
    return moving("world/ending", moments(np.array([steps]), trace.rules.dt), [len(strips)], lines)
