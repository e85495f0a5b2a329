"""What a recording shows: the entities of an episode and the layout in which the Rerun viewer opens them.

Everything in the plane lies under `/world`, whose transform turns y upwards (Rerun's points down), so the
numbers one hovers over are the simulator's. Yellow drives, blue walks, red is where it went wrong: told
apart by colour-blind readers too.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int
from rerun.chunk import Chunk

from crowdbench.geometry import nearest_in_step, norm
from crowdbench.sim.episode import swept_motion
from crowdbench.types import DISCOMFORT_GAP, Outcome, Trace

Color = tuple[int, int, int]

VEHICLE: Color = (255, 194, 10)
PEDESTRIAN: Color = (94, 169, 255)
WALKED: Color = (43, 84, 136)
FAILURE: Color = (255, 77, 84)
SUCCESS: Color = (70, 210, 140)
ARROW: Color = (255, 255, 255)
MUTED: Color = (140, 146, 158)
FAINT: Color = (72, 78, 90)
GRID: Color = (33, 36, 43)
BACKGROUND: Color = (17, 19, 24)

CURVES: tuple[Color, ...] = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0))
"""Colours of a planner's own curves, told apart by colour-blind readers (Okabe and Ito 2008)."""

PLANNER_PLOTS = "plots/planner"
"""Where the planner's own curves lie, apart from those of the collision check."""

KEY = "*yellow drives, blue walks, small dots are their goals · arrow: the way of 1 s · grid: 1 m*"


_ANGLE = np.linspace(0.0, 2.0 * np.pi, 49)
CIRCLE: Float[np.ndarray, "49 2"] = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], axis=1)


def times(start: int, stop: int, dt: float) -> list[rr.TimeColumn]:
    """The two timelines of states `start` to `stop` - 1: seconds since the start, and the step's number."""
    return _moments(np.arange(start, stop), dt)


def _moments(steps: Int[np.ndarray, "time"], dt: float) -> list[rr.TimeColumn]:
    return [rr.TimeColumn("time", duration=steps * dt), rr.TimeColumn("step", sequence=steps)]


def episode(trace: Trace, row: int, title: str, values: Mapping[str, float]) -> Iterator[Chunk]:
    """All that is shown of one episode of a trace; `values` are its metrics, `title` says whose run it is."""
    states, dt = int(trace.steps[row]) + 1, trace.rules.dt
    present = trace.present[row, 0]
    position, velocity = trace.position[row, :states, present], trace.velocity[row, :states, present]
    goal, radius = trace.goal[row, 0, present], trace.radius[row, 0, present]
    low, high = extent(trace, row)
    label = 0.035 * float((high - low).max())  # the height of a line of text, in metres, as the layout shows it
    yield still("world", rr.Transform3D(scale=[1.0, -1.0, 1.0]))
    yield _ground(low, high, position, goal, float(radius[0]))
    yield from _trails(position, times(1, states, dt))
    moments = times(0, states, dt)
    yield from _discs(moments, position, velocity, radius)
    yield from _names(moments, position, goal[0], radius, np.flatnonzero(present), label)
    sentence, mark = _ending(trace, row, label)
    yield mark
    yield from _plots(trace, row)
    yield from _logs(trace, row)
    yield still("summary", rr.TextDocument(_summary(trace, row, title, sentence, values), media_type="text/markdown"))


def extent(trace: Trace, row: int) -> Float[np.ndarray, "2 2"]:
    """The least and the greatest x and y, in whole metres, that hold an episode with a margin."""
    present = trace.present[row, 0]
    path = trace.position[row, : trace.steps[row] + 1, present].reshape(-1, 2)
    points = np.concatenate([path, trace.goal[row, 0, present]])
    return np.stack([np.floor(points.min(0) - 0.5), np.ceil(points.max(0) + 0.5)])


def layout(extents: Sequence[Float[np.ndarray, "2 2"]], plotted: Sequence[str]) -> rrb.Blueprint:
    """The viewer's layout for episodes of these extents; `plotted` are the planner's own curves."""
    low, high = np.min(extents, axis=0)[0], np.max(extents, axis=0)[1]
    start, end = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    so_far = [rrb.VisibleTimeRange(timeline, start=start, end=end) for timeline in ("time", "step")]
    plane = rrb.Spatial2DView(
        name="top view",
        contents="/world/**",
        background=[*BACKGROUND],
        visual_bounds=rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[-high[1], -low[1]]),
        overrides={"/world/trails": rrb.VisibleTimeRanges(so_far)},
    )
    gap = {"gap": VEHICLE, "discomfort": MUTED, "contact": FAILURE}
    plots = [
        _plot("gap", f"gap, m (grey: discomfort under {DISCOMFORT_GAP} m, red: contact)", gap, (-0.2, 2.0)),
        _plot("speed", "speed, m/s (grey: preferred)", {"speed": VEHICLE, "preferred": MUTED}, (-0.1, 1.5)),
        *(rrb.TimeSeriesView(name=name, origin=f"/{PLANNER_PLOTS}/{name}") for name in plotted),
    ]
    text = rrb.TextDocumentView(name="episode", origin="/summary")
    side = rrb.Vertical(text, *plots, row_shares=[3.0] + [1.0] * len(plots))
    return rrb.Blueprint(
        rrb.Horizontal(plane, side, column_shares=[3.0, 2.0]),
        # "following" opens at the last state: how an episode ends is what one wants to see first.
        rrb.TimePanel(state="collapsed", timeline="time", play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        # The panel that lists the recordings.
        rrb.BlueprintPanel(state="collapsed" if len(extents) == 1 else "expanded"),
    )


def _plot(name: str, title: str, curves: Mapping[str, Color], extent: tuple[float, float]) -> rrb.TimeSeriesView:
    """A plot of named curves, the first one wide. Its title is its legend: a box would cover the curves."""
    widths = [2.5] + [1.0] * (len(curves) - 1)
    return rrb.TimeSeriesView(
        name=title,
        origin=f"/plots/{name}",
        axis_y=rrb.ScalarAxis(range=extent),
        plot_legend=rrb.PlotLegend(visible=False),
        overrides={f"/plots/{name}": rr.SeriesLines(names=list(curves), colors=list(curves.values()), widths=widths)},
    )


def still(entity: str, *archetypes: rr.AsComponents) -> Chunk:
    """A chunk of what does not change with time."""
    batches = [batch for archetype in archetypes for batch in archetype.as_component_batches()]
    return Chunk.from_columns(entity, [], [batch.partition([len(batch.as_arrow_array())]) for batch in batches])


def _ground(
    low: Float[np.ndarray, "2"],
    high: Float[np.ndarray, "2"],
    position: Float[np.ndarray, "agent time 2"],
    goal: Float[np.ndarray, "agent 2"],
    radius: float,
) -> Chunk:
    """What stands still: a grid of one metre, the goals, the vehicle's straight line and everybody's whole path."""
    grid = [np.array([(x, low[1]), (x, high[1])]) for x in np.arange(low[0], high[0] + 1)]
    grid += [np.array([(low[0], y), (high[0], y)]) for y in np.arange(low[1], high[1] + 1)]
    paths = [np.stack([position[0, 0], goal[0]]), *position]
    lines = [*grid, *paths, goal[0] + radius * CIRCLE]
    colors = [GRID] * len(grid) + [FAINT] * len(paths) + [VEHICLE]
    widths = rr.Radius.ui_points([0.5] * (len(lines) - 1) + [1.5])
    dots = rr.Points2D(goal, radii=rr.Radius.ui_points(3), colors=_each(VEHICLE, PEDESTRIAN, len(goal)))
    return still("world/ground", rr.LineStrips2D(lines, colors=colors, radii=widths, draw_order=1), dots)


def _each(vehicle: Color, pedestrian: Color, agents: int) -> list[Color]:
    """A colour for every agent."""
    return [vehicle] + [pedestrian] * (agents - 1)


def _trails(position: Float[np.ndarray, "agent time 2"], moments: Sequence[rr.TimeColumn]) -> Iterator[Chunk]:
    """One stroke per agent and step; the layout shows all strokes up to the present, which makes a trail."""
    agents, states = position.shape[:2]
    colors = _each(VEHICLE, WALKED, agents)
    yield still("world/trails", rr.LineStrips2D.from_fields(colors=colors, radii=rr.Radius.ui_points(2)))
    strokes = np.stack([position[:, :-1], position[:, 1:]], axis=2).swapaxes(0, 1).reshape(-1, 2, 2)
    columns = rr.LineStrips2D.columns(strips=strokes)
    yield Chunk.from_columns("world/trails", moments, columns.partition([agents] * (states - 1)))


def _discs(
    moments: Sequence[rr.TimeColumn],
    position: Float[np.ndarray, "agent time 2"],
    velocity: Float[np.ndarray, "agent time 2"],
    radius: Float[np.ndarray, "agent"],
) -> Iterator[Chunk]:
    """Agents as discs of their true size, with an arrow as long as the way of a second."""
    agents, states = position.shape[:2]
    yield still(
        "world/agents",
        rr.Points2D.from_fields(radii=radius, colors=_each(VEHICLE, PEDESTRIAN, agents)),
        rr.Arrows2D.from_fields(colors=[ARROW], radii=rr.Radius.ui_points(1.5), draw_order=40),
    )
    flat, arrow = position.swapaxes(0, 1).reshape(-1, 2), velocity.swapaxes(0, 1).reshape(-1, 2)
    columns = [*rr.Points2D.columns(positions=flat), *rr.Arrows2D.columns(origins=flat, vectors=arrow)]
    yield Chunk.from_columns("world/agents", moments, [column.partition([agents] * states) for column in columns])


def _names(
    moments: Sequence[rr.TimeColumn],
    position: Float[np.ndarray, "agent time 2"],
    goal: Float[np.ndarray, "2"],
    radius: Float[np.ndarray, "agent"],
    number: np.ndarray,
    label: float,
) -> Iterator[Chunk]:
    """A name under every disc and over the goal. On the disc's own point Rerun would write across it."""
    agents, states = position.shape[:2]
    places = np.empty((states, agents + 1, 2))
    places[:, :-1] = position.swapaxes(0, 1)
    places[:, :-1, 1] -= radius
    places[:, -1] = goal + np.array([0.0, radius[0] + label])
    names = ["vehicle", *(str(agent - 1) for agent in number[1:]), "goal"]
    colors = [*_each(VEHICLE, PEDESTRIAN, agents), VEHICLE]
    style = rr.Points2D.from_fields(labels=names, colors=colors, radii=rr.Radius.ui_points(0))
    yield still("world/names", style)
    columns = rr.Points2D.columns(positions=places.reshape(-1, 2))
    yield Chunk.from_columns("world/names", moments, columns.partition([agents + 1] * states))


def _ending(trace: Trace, row: int, label: float) -> tuple[str, Chunk]:
    """How the episode ended, as a sentence, and its mark in the last state: red or green rims and a ring."""
    steps, dt, outcome = int(trace.steps[row]), trace.rules.dt, Outcome(int(trace.outcome[row]))
    sentence, involved = "reaches its goal", [0]
    if outcome is Outcome.TIMEOUT:
        sentence = "runs out of time"
    elif outcome is Outcome.COLLISION:
        hit = _hit(trace, row)
        sentence, involved = f"hits pedestrian {hit}", [0, hit + 1]
    elif outcome is Outcome.WALL_COLLISION:
        sentence = "hits an obstacle"
    centers = trace.position[row, steps, involved]
    middle, ring = centers.mean(0), 3.0 * trace.radius[row, 0, 0]
    color = SUCCESS if outcome is Outcome.SUCCESS else FAILURE
    sizes = [*trace.radius[row, steps, involved], ring]
    rims = rr.Ellipses2D.columns(
        half_sizes=[(size, size) for size in sizes],
        centers=[*centers, middle],
        colors=[color] * len(sizes),
        line_radii=[rr.Radius.ui_points(2)] * len(sizes),
    )
    place = middle + np.array([0.0, ring + label])
    text = rr.Points2D.columns(positions=[place], labels=[sentence], colors=[color], radii=[rr.Radius.ui_points(0)])
    columns = [column.partition([len(sizes)]) for column in rims] + [column.partition([1]) for column in text]
    return f"{sentence} after {steps * dt:g} s", Chunk.from_columns(
        "world/ending", times(steps, steps + 1, dt), columns
    )


def _hit(trace: Trace, row: int) -> int:
    """The pedestrian (0, 1, ...) that came nearest to the vehicle in the last step, as the collision check sees it."""
    last = slice(row, row + 1), trace.steps[row] - 1
    end = trace.position[row : row + 1, trace.steps[row]]
    motion = swept_motion(trace.position[last], end, trace.velocity[last], trace.rules)[0]
    _, nearest = nearest_in_step(0, trace.position[last][0], motion, trace.radius[last][0], trace.present[last][0])
    return int(nearest) - 1


def _plots(trace: Trace, row: int) -> Iterator[Chunk]:
    """Gap and speed over time, beside the values that they are judged by; the layout has their colours."""
    steps, dt = int(trace.steps[row]), trace.rules.dt
    gap = trace.gap[row, :steps]
    if np.isfinite(gap).all():
        judged = np.stack([gap, np.full(steps, DISCOMFORT_GAP), np.zeros(steps)], axis=1)
        yield _curves("plots/gap", times(1, steps + 1, dt), judged)
    speed = norm(trace.velocity[row, : steps + 1, 0])
    preferred = np.full(steps + 1, trace.preferred_speed[row, 0])
    yield _curves("plots/speed", times(0, steps + 1, dt), np.stack([speed, preferred], axis=1))


def _curves(entity: str, moments: Sequence[rr.TimeColumn], values: Float[np.ndarray, "time curve"]) -> Chunk:
    columns = rr.Scalars.columns(scalars=values.ravel())
    return Chunk.from_columns(entity, moments, columns.partition([values.shape[1]] * len(values)))


def _logs(trace: Trace, row: int) -> Iterator[Chunk]:
    """What the planner logged, of each step: one number or several `[n]` as curves, `[n, xy]` as points, and
    `[..., time, n, xy]` as lines over time. Each is shown until it is logged again.
    """
    end = int(trace.steps[row])
    for name, array in trace.logs.items():
        entity = f"world/planner/{name}"
        # Left out where nothing was logged: Rerun draws no curve through numbers that stand between NaNs.
        told = np.flatnonzero(~np.isnan(array[row, :end].reshape(end, -1)).all(axis=1))
        logged, steps, moments = array[row, told], len(told), _moments(told, trace.rules.dt)
        if steps == 0:
            continue
        if is_curve(array):
            curves = logged.reshape(steps, -1)
            names = [f"{name} {n}" if curves.shape[1] > 1 else name for n in range(curves.shape[1])]
            style = rr.SeriesLines(names=names, colors=list(itertools.islice(itertools.cycle(CURVES), len(names))))
            yield still(f"{PLANNER_PLOTS}/{name}", style)
            yield _curves(f"{PLANNER_PLOTS}/{name}", moments, curves)
        elif logged.shape[-1] == 2 and logged.ndim == 3:
            points = rr.Points2D.columns(positions=logged.reshape(-1, 2))
            yield still(entity, rr.Points2D.from_fields(colors=[MUTED], radii=rr.Radius.ui_points(2)))
            yield Chunk.from_columns(entity, moments, points.partition([logged[0].size // 2] * steps))
        elif logged.shape[-1] == 2:
            strips = logged.swapaxes(-3, -2).reshape(-1, logged.shape[-3], 2)
            lines = rr.LineStrips2D.columns(strips=strips)
            yield still(entity, rr.LineStrips2D.from_fields(colors=[MUTED], radii=rr.Radius.ui_points(0.75)))
            yield Chunk.from_columns(entity, moments, lines.partition([len(strips) // steps] * steps))


def is_curve(logged: np.ndarray) -> bool:
    """Whether something logged, `[world, step, ...]`, is shown as curves over time."""
    return logged.ndim <= 3


def _summary(trace: Trace, row: int, title: str, sentence: str, values: Mapping[str, float]) -> str:
    """The text beside the picture, in Markdown; the metrics in two columns, since a view does not scroll by itself."""
    lines = [f"# {Outcome(int(trace.outcome[row])).label.capitalize()}: {sentence}"]
    lines += [f"{trace.split} case {trace.case[row]} · {title}", "", KEY, ""]
    cells = [f"{name.replace('_', ' ')} | {value:.4g}" for name, value in values.items() if np.isfinite(value)]
    cells += [" | "] * (len(cells) % 2)
    if cells:
        half = len(cells) // 2
        lines += ["| metric | value | metric | value |", "|---|---:|---|---:|"]
        lines += [f"| {left} | {right} |" for left, right in zip(cells[:half], cells[half:], strict=True)]
    return "\n".join(lines)
