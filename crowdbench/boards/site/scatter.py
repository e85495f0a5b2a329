"""The figure of a board: success against time, with intervals, and the entries that no other one beats in both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from crowdbench.boards.site.rows import is_measured
from crowdbench.boards.site.svg import COLOURS, axes, to_svg
from crowdbench.boards.site.texts import shortened
from crowdbench.boards.standings import Standing, Standings

LETTER = 6.0
"""About the width of a letter, in units of the SVG."""

_OFFSETS = [(8, 6), (8, -13), (-8, 6), (-8, -13), (8, 20), (-8, 20), (8, -27), (-8, -27), (0, 34), (0, -41)]
"""Where a name may stand beside its point, the best place first, in units of the SVG."""


def scatter(found: Standings) -> Markup | None:
    """Success against time of all entries that were measured on the same cases; None where there is none.

    Args:
        found: The standings of the board.
    """
    shown = [one for one in (*found.ranked, *found.others) if is_measured(one) and _is_defined(one)]
    if not shown:
        return None
    with axes(9.6, 5.2) as drawn:
        drawn.grid(True)
        drawn.set_axisbelow(True)
        front = sorted((one for one in shown if one.is_pareto), key=_x)
        steps = [_x(one) for one in front], [_y(one) for one in front]
        drawn.step(*steps, where="post", color=COLOURS["muted"], lw=1, linestyle=(0, (2, 3)))
        for one in shown:
            _point(drawn, one)
        drawn.set_xlabel("time to the goal, over successes (s)")
        drawn.set_ylabel("success (%)")
        drawn.set_ylim(top=min(drawn.get_ylim()[1], 101.0))
        _names(drawn, shown)
        return to_svg(drawn, f"Success against time of {len(shown)} entries; the table has the same figures")


def _is_defined(one: Standing) -> bool:
    return bool(np.isfinite([_x(one), _y(one)]).all())


def _x(one: Standing) -> float:
    return one.figures["navigation_time"].mean


def _y(one: Standing) -> float:
    return 100.0 * one.figures["success_rate"].mean


def _point(drawn: Axes, one: Standing) -> None:
    """An entry with its intervals: filled if it is in the Pareto set, a cross if it has no rank."""
    time, success = one.figures["navigation_time"], one.figures["success_rate"]
    colour = COLOURS["accent"] if one.is_pareto else COLOURS["ink"] if one.rank else COLOURS["muted"]
    drawn.errorbar(
        time.mean,
        100.0 * success.mean,
        xerr=np.maximum([[time.mean - time.low], [time.high - time.mean]], 0.0),
        yerr=np.maximum([[100.0 * (success.mean - success.low)], [100.0 * (success.high - success.mean)]], 0.0),
        fmt="o" if one.rank else "x",
        markersize=7 if one.is_pareto else 6,
        markerfacecolor=COLOURS["accent"] if one.is_pareto else COLOURS["page"],
        color=colour,
        elinewidth=1,
        alpha=1.0 if one.rank else 0.8,
    )


def _names(drawn: Axes, shown: Sequence[Standing]) -> None:
    """Write the names where they cover few points and other names."""
    figure = drawn.get_figure(root=True)
    assert figure is not None
    scale = figure.dpi / 72.0
    points = np.asarray(drawn.transData.transform([(_x(one), _y(one)) for one in shown])) / scale
    frame = np.asarray(drawn.get_window_extent().extents) / scale
    taken = [(x - 5, y - 5, x + 5, y + 5) for x, y in points.tolist()]
    for one, (x, y) in zip(shown, points.tolist(), strict=True):
        name = shortened(one.entry.name, 30).encode("ascii", "replace").decode()
        boxes = [_box(x + dx, y + dy, len(name) * LETTER, dx) for dx, dy in _OFFSETS]
        costs = [sum(_shared(box, other) for other in taken) + _outside(box, frame.tolist()) for box in boxes]
        best = int(np.argmin(costs))
        taken.append(boxes[best])
        dx, dy = _OFFSETS[best]
        drawn.annotate(
            name,
            (_x(one), _y(one)),
            (dx, dy),
            textcoords="offset points",
            ha="left" if dx > 0 else "right" if dx < 0 else "center",
            color=COLOURS["ink"] if one.rank else COLOURS["muted"],
            fontweight="bold" if one.is_pareto else "normal",
        )


_Box = tuple[float, float, float, float]


def _box(x: float, y: float, width: float, side: float) -> _Box:
    left = x if side > 0 else x - width if side < 0 else x - width / 2
    return (left, y, left + width, y + 10.0)


def _shared(one: _Box, other: _Box) -> float:
    """The area that two boxes share."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return max(width, 0.0) * max(height, 0.0)


def _outside(box: _Box, frame: Sequence[float]) -> float:
    """How far a box sticks out of the frame, weighed against shared areas."""
    return 100.0 * sum(
        max(each, 0.0) for each in (frame[0] - box[0], frame[1] - box[1], box[2] - frame[2], box[3] - frame[3])
    )
