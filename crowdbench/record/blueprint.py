"""The curves of a recording, and its layout in the Rerun viewer, which Rerun calls a blueprint."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float
from rerun.chunk import Chunk

from crowdbench.core.geometry import norm
from crowdbench.core.types import DISCOMFORT_GAP, Trace
from crowdbench.drawing import CURVES, DARK, Color
from crowdbench.record import decisions
from crowdbench.record.rrd import moments, moving

PLANNER_PLOTS = "plots/planner"
"""Path of the curves that the planner logs."""


_TEXTS = {"episode": "summary", "legend": "legend", "metrics": "metrics"}
"""The texts beside the plane, by the names of their tabs."""


def blueprint(extents: Sequence[Float[np.ndarray, "2 2"]], plotted: Mapping[str, int], fastest: float) -> rrb.Blueprint:
    """Return the viewer's layout: the plane on the left, text and plots on the right.

    Args:
        extents: Extent of each episode, see `drawing.extent`.
        plotted: Logs that are shown as curves, and their number of curves.
        fastest: The largest speed in m/s at which a vehicle of these episodes may drive.
    """
    plots = [*_plots(fastest), *(_plot_of_planner(name, count) for name, count in plotted.items())]
    texts = rrb.Tabs(*(rrb.TextDocumentView(name=name, origin=f"/{origin}") for name, origin in _TEXTS.items()))
    side = rrb.Vertical(texts, *plots, row_shares=[2.0] + [1.0] * len(plots))
    return rrb.Blueprint(
        rrb.Horizontal(_plane(extents), side, column_shares=[3.0, 2.0]),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="playing"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TopPanel(state="expanded"),
        # The panel that lists the recordings.
        rrb.BlueprintPanel(state="expanded" if len(extents) > 1 else "collapsed"),
    )


def _plane(extents: Sequence[Float[np.ndarray, "2 2"]]) -> rrb.Spatial2DView:
    """Return the view of the plane, as large as the extents of all episodes."""
    low, high = np.min(extents, axis=0)[0], np.max(extents, axis=0)[1]
    start, now = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    return rrb.Spatial2DView(
        name="top view",
        contents="/world/**",
        background=[*DARK.background],
        visual_bounds=rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[-high[1], -low[1]]),
        overrides={"/world/trails": rrb.VisibleTimeRanges([rrb.VisibleTimeRange("time", start=start, end=now)])},
    )


def _plots(fastest: float) -> list[rrb.TimeSeriesView]:
    """Return the views of the gap and the speed."""
    gap = _style(["gap", "discomfort", "contact"], [DARK.vehicle, DARK.wall, DARK.contact])
    speed = _style(["speed", "preferred"], [DARK.vehicle, DARK.wall])
    title = f"gap, m (grey: discomfort under {DISCOMFORT_GAP} m, red: contact)"
    speeds = -0.1 * fastest, 1.5 * fastest
    return [
        _plot(title, "/plots/gap", gap, (-0.2, 2.0)),
        _plot("speed, m/s (grey: preferred)", "/plots/speed", speed, speeds),
    ]


def _plot_of_planner(name: str, count: int) -> rrb.TimeSeriesView:
    """Return a view of the values that the planner logged under a name. A value holds until the next one is logged."""
    lines = rr.SeriesLines(
        names=[f"{name} {n}" if count > 1 else name for n in range(count)],
        colors=list(itertools.islice(itertools.cycle(CURVES), count)),
        interpolation_mode=rr.components.InterpolationMode.StepAfter,
    )
    return _plot(name.replace("_", " "), f"/{PLANNER_PLOTS}/{name}", lines)


def _style(names: Sequence[str], colors: Sequence[Color]) -> rr.SeriesLines:
    """Return the style of the curves of an entity, the first one wide."""
    return rr.SeriesLines(names=names, colors=colors, widths=[2.5] + [1.0] * (len(names) - 1))


def _plot(
    title: str, entity: str, style: rr.AsComponents, values: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    """Return a view with the curves of an entity.

    Args:
        title: Description of the curves, because a legend would cover them.
        entity: Path of the entity.
        style: Style of its curves.
        values: The range of values that is shown; all if None.
    """
    return rrb.TimeSeriesView(
        name=title,
        origin=entity,
        axis_y=None if values is None else rrb.ScalarAxis(range=values),
        plot_legend=rrb.PlotLegend(visible=False),
        overrides={entity: style},
    )


def draw_plots(trace: Trace, row: int) -> Iterator[Chunk]:
    """Yield gap and speed over time, with reference values. Their style is in the blueprint."""
    steps, dt = int(trace.steps[row]), trace.rules.dt
    gap = trace.gap[row, :steps]
    somebody = np.isfinite(gap)
    if somebody.any():
        curves = np.stack([gap, np.full(steps, DISCOMFORT_GAP), np.zeros(steps)], axis=1)
        yield _draw_curves("plots/gap", moments(np.flatnonzero(somebody) + 1, dt), curves[somebody])
    speed = norm(trace.velocity[row, : steps + 1, 0])
    preferred = np.full(steps + 1, trace.preferred_speed[row, 0])
    yield _draw_curves("plots/speed", moments(np.arange(steps + 1), dt), np.stack([speed, preferred], axis=1))


def draw_logs(trace: Trace, row: int) -> Iterator[Chunk]:
    """Yield the logs of the planner that are curves, see `Observation.log`. Their style is in the blueprint."""
    for name, array in trace.logs.items():
        # Steps without a value are left out, because Rerun draws no curve between values separated by NaN.
        logged_at = decisions.steps_logged(trace, row, name)
        if array.ndim <= 3 and len(logged_at):
            curves = array[row, logged_at].reshape(len(logged_at), -1)
            yield _draw_curves(f"{PLANNER_PLOTS}/{name}", moments(logged_at, trace.rules.dt), curves)


def _draw_curves(entity: str, timeline: Sequence[rr.TimeColumn], values: Float[np.ndarray, "time curve"]) -> Chunk:
    """Return curves of one entity over time."""
    return moving(entity, timeline, [values.shape[1]] * len(values), rr.Scalars.columns(scalars=values.ravel()))


def logged_curves(chunks: Iterable[Chunk]) -> dict[str, int]:
    """Return the number of curves of each log of `draw_logs` in the chunks of a recording, sorted by name."""
    curves = {}
    for chunk in chunks:
        name = chunk.entity_path.removeprefix(f"/{PLANNER_PLOTS}/")
        if name != chunk.entity_path and not chunk.is_static and chunk.num_rows:
            curves[name] = len(chunk.to_record_batch().column("Scalars:scalars")[0])
    return dict(sorted(curves.items()))
