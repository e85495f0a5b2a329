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

_OFFSETS = [
    (sign_x * x, y)
    for distance in (1.0, 2.2, 3.6, 5.0)
    for sign_x, x, y in (
        (1, 8.0, 6.0 * distance),
        (1, 8.0, -4.0 - 9.0 * distance),
        (-1, 8.0, 6.0 * distance),
        (-1, 8.0, -4.0 - 9.0 * distance),
        (1, 12.0 * distance, -3.0),
        (-1, 12.0 * distance, -3.0),
    )
]
"""Where a name may stand beside its point, the best place first, in units of the SVG."""

CLOSE = 0.9
"""Entries that succeed at least so often are also shown in a figure of their own, where others are far from them."""


def scatter(found: Standings) -> list[Markup]:
    """Success against time of all entries that were measured on the same cases, and a close-up of the best of them.

    Args:
        found: The standings of the board.

    Returns:
        The figures; none where nobody was measured, and no close-up where it would show nothing more.
    """
    shown = [one for one in (*found.ranked, *found.others) if is_measured(one) and _is_defined(one)]
    near = [one for one in shown if one.figures["success_rate"].mean >= CLOSE]
    if not shown:
        return []
    if not 3 <= len(near) < len(shown):
        return [_figure(shown, shown, "")]
    far = [one for one in shown if one not in near]
    return [_figure(shown, far, ""), _figure(near, near, f" that succeed in {CLOSE:.0%} of the cases or more")]


def _figure(shown: Sequence[Standing], named: Sequence[Standing], which: str) -> Markup:
    """A figure of entries, of which some have their names beside them."""
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
        _names(drawn, shown, named)
        return to_svg(drawn, f"Success against time of {len(shown)} entries{which}; the table has the same figures")


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


def _names(drawn: Axes, shown: Sequence[Standing], named: Sequence[Standing]) -> None:
    """Write names where they cover few points, intervals and other names."""
    figure = drawn.get_figure(root=True)
    assert figure is not None
    scale = figure.dpi / 72.0
    frame = (np.asarray(drawn.get_window_extent().extents) / scale).tolist()
    taken = [box for one in shown for box in _boxes(drawn, one, scale)]
    for one in named:
        x, y = (np.asarray(drawn.transData.transform((_x(one), _y(one)))) / scale).tolist()
        name = shortened(one.entry.name, 30).encode("ascii", "replace").decode()
        boxes = [_box(x + dx, y + dy, len(name) * LETTER, dx) for dx, dy in _OFFSETS]
        costs = [sum(_shared(box, other) for other in taken) + _outside(box, frame) for box in boxes]
        best = int(np.argmin(costs))
        taken.append(boxes[best])
        dx, dy = _OFFSETS[best]
        drawn.annotate(
            name,
            (_x(one), _y(one)),
            (dx, dy),
            textcoords="offset points",
            ha="left" if dx > 0 else "right",
            color=COLOURS["ink"] if one.rank else COLOURS["muted"],
            fontweight="bold" if one.is_pareto else "normal",
            arrowprops={"arrowstyle": "-", "color": COLOURS["muted"], "lw": 0.6}
            if max(abs(dx), abs(dy)) > 14
            else None,
        )


def _boxes(drawn: Axes, one: Standing, scale: float) -> list[_Box]:
    """What the point of an entry and its intervals cover, in units of the SVG."""
    time, success = one.figures["navigation_time"], one.figures["success_rate"]
    ends = [(time.low, 100 * success.low), (time.mean, 100 * success.mean), (time.high, 100 * success.high)]
    (left, low), (x, y), (right, high) = (np.asarray(drawn.transData.transform(ends)) / scale).tolist()
    return [(x - 5, y - 5, x + 5, y + 5), (left, y - 1, right, y + 1), (x - 1, low, x + 1, high)]


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
