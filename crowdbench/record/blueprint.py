"""How the Rerun viewer shows a recording, which Rerun calls a blueprint."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from crowdbench.core.types import DISCOMFORT_GAP
from crowdbench.drawing import CURVES, DARK, MUTED, Color
from crowdbench.record.plots import PLANNER_PLOTS


def blueprint(
    extents: Sequence[Float[np.ndarray, "2 2"]], plotted: Mapping[str, int], fastest: float, *, has_menu: bool = True
) -> rrb.Blueprint:
    """The viewer's layout: the plane on the left, text and plots on the right.

    Args:
        extents: Extent of each episode, see `drawing.extent`.
        plotted: Logs that are shown as curves, and their number of curves.
        fastest: The largest speed in m/s at which a vehicle of these episodes may drive.
        has_menu: True if the viewer's menu is shown.
    """
    plots = [*_plots(fastest), *(_plot_of_planner(name, count) for name, count in plotted.items())]
    texts = rrb.Tabs(
        rrb.TextDocumentView(name="episode", origin="/summary"),
        rrb.TextDocumentView(name="metrics", origin="/metrics"),
    )
    side = rrb.Vertical(texts, *plots, row_shares=[2.0] + [1.0] * len(plots))
    return rrb.Blueprint(
        rrb.Horizontal(_plane("top view", extents), side, column_shares=[3.0, 2.0]),
        *_panels(has_menu=has_menu, lists=len(extents) > 1),
    )


def side_by_side(
    names: Sequence[str], extents: Sequence[Float[np.ndarray, "2 2"]], fastest: float, longest: float, *, has_menu: bool
) -> rrb.Blueprint:
    """The viewer's layout for the same case of several planners, whose entities are under `/0`, `/1`, ...

    Args:
        names: Their names.
        extents: Extent of each episode, see `drawing.extent`.
        fastest: The largest speed in m/s at which a vehicle of these episodes may drive.
        longest: How long the longest of them takes, in seconds: the time that all plots show.
        has_menu: True if the viewer's menu is shown.
    """
    axis = axis_between(rrb.TimeRangeBoundary.absolute(seconds=0.0), rrb.TimeRangeBoundary.absolute(seconds=longest))
    columns = [
        rrb.Vertical(_plane(name, extents, f"/{n}"), *_plots(fastest, f"/{n}", axis), row_shares=[4.0, 1.0, 1.0])
        for n, name in enumerate(names)
    ]
    return rrb.Blueprint(rrb.Horizontal(*columns), *_panels(has_menu=has_menu, lists=False))


def _panels(*, has_menu: bool, lists: bool) -> list[Any]:
    """Which of the viewer's panels are shown; `lists` is whether there are several recordings to list."""
    return [
        # A window plays the episode from its start, a picture shows its end.
        rrb.TimePanel(state="collapsed", timeline="time", play_state="playing" if has_menu else "following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TopPanel(state="expanded" if has_menu else "hidden"),
        # The panel that lists the recordings.
        rrb.BlueprintPanel(state="expanded" if lists else "collapsed"),
    ]


def _plane(name: str, extents: Sequence[Float[np.ndarray, "2 2"]], root: str = "") -> rrb.Spatial2DView:
    """The view of the plane, as large as the extents of all episodes, which are under the entity `root`."""
    low, high = np.min(extents, axis=0)[0], np.max(extents, axis=0)[1]
    start, now = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    return rrb.Spatial2DView(
        name=name,
        contents=f"{root}/world/**",
        background=[*DARK.background],
        visual_bounds=rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[-high[1], -low[1]]),
        overrides={f"{root}/world/trails": rrb.VisibleTimeRanges([rrb.VisibleTimeRange("time", start=start, end=now)])},
    )


def _plots(fastest: float, root: str = "", axis: rrb.TimeAxis | None = None) -> list[rrb.TimeSeriesView]:
    """The views of the gap and the speed, see `side_by_side`; the axis is as long as the episode if None."""
    gap = style_of(["gap", "discomfort", "contact"], [DARK.vehicle, MUTED, DARK.failure])
    speed = style_of(["speed", "preferred"], [DARK.vehicle, MUTED])
    title = f"gap, m (grey: discomfort under {DISCOMFORT_GAP} m, red: contact)"
    speeds = -0.1 * fastest, 1.5 * fastest
    return [
        plot(title, {f"{root}/plots/gap": gap}, (-0.2, 2.0), axis),
        plot("speed, m/s (grey: preferred)", {f"{root}/plots/speed": speed}, speeds, axis),
    ]


def _plot_of_planner(name: str, count: int) -> rrb.TimeSeriesView:
    """A view with what the planner logged by a name. A value holds until the next one is logged."""
    lines = rr.SeriesLines(
        names=[f"{name} {n}" if count > 1 else name for n in range(count)],
        colors=list(itertools.islice(itertools.cycle(CURVES), count)),
        interpolation_mode=rr.components.InterpolationMode.StepAfter,
    )
    return plot(name.replace("_", " "), {f"/{PLANNER_PLOTS}/{name}": lines})


def style_of(names: Sequence[str], colors: Sequence[Color]) -> rr.SeriesLines:
    """The style of the curves of an entity, the first one wide."""
    return rr.SeriesLines(names=names, colors=colors, widths=[2.5] + [1.0] * (len(names) - 1))


def plot(
    title: str,
    styles: Mapping[str, rr.AsComponents],
    values: tuple[float, float] | None = None,
    axis: rrb.TimeAxis | None = None,
) -> rrb.TimeSeriesView:
    """A view with the curves of the first of some entities, in their styles.

    Args:
        title: Describes the curves: a legend would cover them.
        styles: Styles by entity.
        values: The range of values that is shown; all if None.
        axis: The time that is shown; all if None.
    """
    return rrb.TimeSeriesView(
        name=title,
        origin=next(iter(styles)),
        axis_x=axis,
        axis_y=None if values is None else rrb.ScalarAxis(range=values),
        plot_legend=rrb.PlotLegend(visible=False),
        overrides=dict(styles),
    )


def axis_between(start: rrb.TimeRangeBoundary, end: rrb.TimeRangeBoundary) -> rrb.TimeAxis:
    """An axis of time from one time to another."""
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))
