"""The figures of the pages, drawn by Matplotlib as SVG: success against time, and the trajectories of an episode.

Their colours are those of the page, light or dark.
"""

from __future__ import annotations

import contextlib
import html
import io
import re
from collections.abc import Iterator, Sequence

import matplotlib.style
import numpy as np
from jaxtyping import Float
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crowdbench.boards.site.texts import shorten
from crowdbench.boards.standings import Standing, Standings
from crowdbench.core.types import Trace
from crowdbench.drawing import Color, Disc, Moment, Palette, Shape, draw_moment, extent
from crowdbench.figures.episode import draw

_RGB: dict[str, Color] = {
    name: (1, 2, number) for number, name in enumerate(("ink", "muted", "line", "page", "accent", "bad"))
}
COLOURS = {name: f"#{bytes(color).hex()}" for name, color in _RGB.items()}
"""By the name of a variable of `style.css`, the colour that stands for it while Matplotlib draws."""

PALETTE = Palette(
    vehicle=_RGB["accent"],
    pedestrian=_RGB["muted"],
    walked=_RGB["muted"],
    hidden=_RGB["muted"],
    failure=_RGB["bad"],
    faint=_RGB["line"],
    wall=_RGB["ink"],
    text=_RGB["ink"],
    background=_RGB["page"],
)
"""The colours of an episode."""

_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "crowdbench",
    "font.size": 10,
    "text.parse_math": False,
    "text.color": COLOURS["ink"],
    "axes.edgecolor": COLOURS["line"],
    "axes.labelcolor": COLOURS["ink"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "figure.facecolor": "none",
    "grid.color": COLOURS["line"],
    "grid.linewidth": 0.6,
    "xtick.color": COLOURS["line"],
    "ytick.color": COLOURS["line"],
    "xtick.labelcolor": COLOURS["muted"],
    "ytick.labelcolor": COLOURS["muted"],
}

CLOSE = 0.9
"""Entries that succeed at least so often are also shown in a figure of their own, where others are far from them."""

LETTER = 6.0
"""About the width of a letter, in units of the SVG."""

_OFFSETS = np.array(
    [
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
)
"""Where a name may stand beside its point, the best place first, in units of the SVG."""

EVERY = 1.0
"""Seconds between the discs that show where the vehicle, and whom it ran into, was."""

_Boxes = Float[np.ndarray, "box 4"]
"""Left, lower, right and upper edges, in units of the SVG."""


@contextlib.contextmanager
def _axes(width: float, height: float) -> Iterator[Axes]:
    """Axes to draw on, in the style of the pages; width and height in inches, of 72 units of the SVG."""
    with matplotlib.style.context(["default", _STYLE]):
        # Fixed margins: to fit them, Matplotlib would draw every figure several times.
        left, bottom, rest = 0.72, 0.55, 0.1
        inside = (width - left - rest) / width, (height - bottom - rest) / height
        yield Figure(figsize=(width, height)).add_axes((left / width, bottom / height, *inside))


def _to_svg(drawn: Axes, label: str) -> Markup:
    """A figure as an element of a page, with a label for those who cannot see it. Call it inside `with _axes(...)`."""
    file = io.StringIO()
    _figure_of(drawn).savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Several figures of a page would have the same ids; only those of <defs> are needed.
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'font: ([\d.]+px)[^;"]*', r"font-size: \1", text)
    for name, colour in COLOURS.items():
        text = text.replace(colour, f"var(--{name})")
    view_box = re.search(r'viewBox="[^"]*"', text)
    assert view_box is not None
    space = 'xmlns:xlink="http://www.w3.org/1999/xlink"'
    head = f'<svg {space} {view_box[0]} role="img" aria-label="{html.escape(label)}">'
    return Markup(head + text[text.index(">") + 1 :].strip())


def _figure_of(drawn: Axes) -> Figure:
    figure = drawn.get_figure(root=True)
    assert figure is not None
    return figure


def success_against_time(found: Standings) -> list[Markup]:
    """Success against time of all entries that were measured on the same cases, and a close-up of the best of them.

    Nothing where nobody was measured, and no close-up where it would show nothing more.
    """
    shown = [one for one in found.entries if one.is_measured and np.isfinite(_point(one)).all()]
    near = [one for one in shown if one.figures["success_rate"].mean >= CLOSE]
    if not shown:
        return []
    if not 3 <= len(near) < len(shown):
        return [_scatter(shown, shown, "")]
    far = [one for one in shown if one not in near]
    return [_scatter(shown, far, ""), _scatter(near, near, f" that succeed in {CLOSE:.0%} of the cases or more")]


def _scatter(shown: Sequence[Standing], named: Sequence[Standing], which: str) -> Markup:
    """A figure of entries with their intervals, and with the step line of the Pareto set; some have their names."""
    with _axes(9.6, 5.2) as drawn:
        front = np.array(sorted(_point(one) for one in shown if one.is_pareto)).reshape(-1, 2)
        drawn.step(*front.T, where="post", color=COLOURS["muted"], lw=1, linestyle=(0, (2, 3)))
        for one in shown:
            low, mean, high = _ends(one)
            drawn.errorbar(
                *mean,
                xerr=np.maximum([[mean[0] - low[0]], [high[0] - mean[0]]], 0.0),
                yerr=np.maximum([[mean[1] - low[1]], [high[1] - mean[1]]], 0.0),
                fmt="o" if one.rank else "x",
                markersize=7 if one.is_pareto else 6,
                markerfacecolor=COLOURS["accent"] if one.is_pareto else COLOURS["page"],
                color=COLOURS["accent"] if one.is_pareto else COLOURS["ink"] if one.rank else COLOURS["muted"],
                elinewidth=1,
                alpha=1.0 if one.rank else 0.8,
            )
        drawn.set_xlabel("time to the goal, over successes (s)")
        drawn.set_ylabel("success (%)")
        drawn.set_ylim(top=min(drawn.get_ylim()[1], 101.0))
        _write_names(drawn, shown, named)
        return _to_svg(drawn, f"Success against time of {len(shown)} entries{which}; the table has the same figures")


def _point(one: Standing) -> tuple[float, float]:
    """The mean time in seconds and the mean success in per cent."""
    return _ends(one)[1]


def _ends(one: Standing) -> list[tuple[float, float]]:
    """Time and success at the lower ends of their intervals, in the mean, and at the upper ends."""
    time, success = one.figures["navigation_time"], one.figures["success_rate"]
    return [(getattr(time, end), 100.0 * getattr(success, end)) for end in ("low", "mean", "high")]


def _write_names(drawn: Axes, shown: Sequence[Standing], named: Sequence[Standing]) -> None:
    """Write names where they cover few points, intervals and other names."""
    scale = _figure_of(drawn).dpi / 72.0
    frame = np.asarray(drawn.get_window_extent().extents) / scale
    taken = np.concatenate([_covered(drawn, one, scale) for one in shown])
    for one in named:
        name = shorten(one.entry.name, 30).encode("ascii", "replace").decode()
        corner = np.asarray(drawn.transData.transform(_point(one))) / scale + _OFFSETS
        width = len(name) * LETTER
        left = np.where(_OFFSETS[:, 0] > 0, corner[:, 0], corner[:, 0] - width)
        boxes = np.stack([left, corner[:, 1], left + width, corner[:, 1] + 10.0], axis=1)
        best = int(np.argmin(_shared_area(boxes, taken) + 100.0 * _outside(boxes, frame)))
        taken = np.concatenate([taken, boxes[best : best + 1]])
        offset = _OFFSETS[best]
        drawn.annotate(
            name,
            _point(one),
            tuple(offset),
            textcoords="offset points",
            ha="left" if offset[0] > 0 else "right",
            color=COLOURS["ink"] if one.rank else COLOURS["muted"],
            fontweight="bold" if one.is_pareto else "normal",
            arrowprops={"arrowstyle": "-", "color": COLOURS["muted"], "lw": 0.6} if abs(offset).max() > 14 else None,
        )


def _covered(drawn: Axes, one: Standing, scale: float) -> _Boxes:
    """What the point of an entry and its intervals cover."""
    (left, low), (x, y), (right, high) = np.asarray(drawn.transData.transform(_ends(one))) / scale
    return np.array([(x - 5, y - 5, x + 5, y + 5), (left, y - 1, right, y + 1), (x - 1, low, x + 1, high)])


def _shared_area(boxes: _Boxes, others: _Boxes) -> Float[np.ndarray, "box"]:
    """The area that each box shares with others, summed over these."""
    one = boxes[:, None]
    sides = np.minimum(one[..., 2:], others[:, 2:]) - np.maximum(one[..., :2], others[:, :2])
    return np.asarray(np.maximum(sides, 0.0).prod(axis=2).sum(axis=1))


def _outside(boxes: _Boxes, frame: Float[np.ndarray, "4"]) -> Float[np.ndarray, "box"]:
    """How far each box sticks out of the frame."""
    beyond = np.concatenate([frame[:2] - boxes[:, :2], boxes[:, 2:] - frame[2:]], axis=1)
    return np.asarray(np.maximum(beyond, 0.0).sum(axis=1))


def trajectories(trace: Trace, row: int, label: str) -> Markup:
    """An episode at its end, with the ways to it and discs at every full second of the vehicle and of whom it hit.

    Args:
        trace: The trace with the episode.
        row: Its row.
        label: What it shows, for those who cannot see it.
    """
    last = int(trace.steps[row])
    position = trace.position[row, : last + 1]
    moment = Moment.of_trace(trace, row, last)
    marks: list[Shape] = []
    for agent in (0, *moment.hit):
        color = PALETTE.failure if agent in moment.hit else PALETTE.vehicle
        earlier = position[: -1 : max(round(EVERY / trace.rules.dt), 1), agent]
        there = earlier[np.isfinite(earlier).all(axis=1)]
        marks += [Disc(centre, float(moment.radius[agent]), None, color, 0.7) for centre in there]
    if moment.hit:
        marks.append(Disc(position[last, [0, *moment.hit]].mean(axis=0), 0.75, None, PALETTE.failure, 1.2))
    low, high = extent(position, trace.goal[row, last, 0], trace.obstacles[row], 0.6)
    middle, half = (low + high) / 2, (high - low).max() / 2
    (left, bottom), (right, top) = middle - half, middle + half
    with _axes(4.4, 4.4) as drawn:
        drawn.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="x (m)", ylabel="y (m)")
        drawn.spines[:].set_visible(False)
        drawn.tick_params(length=0)
        draw(drawn, [*marks, *draw_moment(moment, middle - half, PALETTE)])
        return _to_svg(drawn, label)
