"""Success against time, drawn by Matplotlib as SVG in the colours of the page, light or dark."""

from __future__ import annotations

import contextlib
import html
import io
import re
from collections.abc import Iterator, Sequence

import matplotlib.style
import numpy as np
import shapely
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crowdbench.metrics import info_of
from crowdbench_leaderboards.pages.standings import Standing, Standings
from crowdbench_leaderboards.pages.texts import shorten

COLOURS = {name: f"#0102{number:02x}" for number, name in enumerate(("muted", "accent", "ink", "line", "page"))}
"""Placeholder colours for variables of `style.css`, by name. They are replaced after Matplotlib has drawn."""

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
"""Least success rate of entries that are also shown in a separate close-up, if other entries are below."""

LETTER = 6.0
"""Approximate width of a letter, in units of the SVG."""

_OFFSETS = np.array(
    [
        offset
        for distance in (1.0, 2.2, 3.6, 5.0)
        for offset in (
            *((side * 8.0, y) for side in (1, -1) for y in (6.0 * distance, -4.0 - 9.0 * distance)),
            *((side * 12.0 * distance, -3.0) for side in (1, -1)),
        )
    ]
)
"""Offsets of a name from its point, in order of preference, in units of the SVG."""

_SHORTENED = (
    (r"<metadata>.*?</metadata>", ""),
    (r'<g id="[^"]*"', "<g"),  # several figures of a page would have the same ids; only ids of <defs> are needed
    (r"<!--.*?-->\s*", ""),
    (r'font: ([\d.]+px)[^;"]*', r"font-size: \1"),
)
"""Parts of an SVG that pages do not need, as patterns with their replacements."""


@contextlib.contextmanager
def _axes(width: float, height: float) -> Iterator[tuple[Figure, Axes]]:
    """Yield a figure with axes, in the style of the pages; width and height in inches, of 72 units of the SVG."""
    with matplotlib.style.context(["default", _STYLE]):
        # Fixed margins: to fit them, Matplotlib would draw every figure several times.
        left, bottom, rest = 0.72, 0.55, 0.1
        inside = (width - left - rest) / width, (height - bottom - rest) / height
        figure = Figure(figsize=(width, height))
        yield figure, figure.add_axes((left / width, bottom / height, *inside))


def _to_svg(figure: Figure, label: str) -> Markup:
    """Return a figure as an SVG element, with a label for screen readers. Call it inside `with _axes(...)`."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    for pattern, replacement in _SHORTENED:
        text = re.sub(pattern, replacement, text, flags=re.DOTALL)
    for name, colour in COLOURS.items():
        text = text.replace(colour, f"var(--{name})")
    view_box = re.search(r'viewBox="[^"]*"', text)
    assert view_box is not None
    space = 'xmlns:xlink="http://www.w3.org/1999/xlink"'
    head = f'<svg {space} {view_box[0]} role="img" aria-label="{html.escape(label)}">'
    return Markup(head + text[text.index(">") + 1 :].strip())


def success_against_time(table: Standings) -> list[Markup]:
    """Draw success against time of all entries measured on the same cases, and a close-up of the best ones.

    Return no figure if no entry was measured, and no close-up if it would add nothing.
    """
    entries = [one for one in table.entries if one.is_measured and np.isfinite(_point(one)).all()]
    near = [one for one in entries if one.figures["success_rate"].mean >= CLOSE]
    if not entries:
        return []
    if not 3 <= len(near) < len(entries):
        return [_scatter(entries, entries, "")]
    far = [one for one in entries if one not in near]
    return [_scatter(entries, far, ""), _scatter(near, near, f" that succeed in {CLOSE:.0%} of the cases or more")]


def _scatter(entries: Sequence[Standing], with_names: Sequence[Standing], which: str) -> Markup:
    """Draw entries with their intervals, the step line of the Pareto set, and the names of some."""
    with _axes(9.6, 5.2) as (figure, axes):
        front = np.array(sorted(_point(one) for one in entries if one.is_pareto)).reshape(-1, 2)
        axes.step(*front.T, where="post", color=COLOURS["muted"], lw=1, linestyle=(0, (2, 3)))
        for one in entries:
            low, mean, high = np.array(_ends(one))
            errors = np.maximum([mean - low, high - mean], 0.0)
            axes.errorbar(
                mean[0],
                mean[1],
                xerr=errors[:, :1],
                yerr=errors[:, 1:],
                fmt="o" if one.rank else "x",
                markersize=7 if one.is_pareto else 6,
                markerfacecolor=COLOURS["accent"] if one.is_pareto else COLOURS["page"],
                color=COLOURS["accent"] if one.is_pareto else COLOURS["ink"] if one.rank else COLOURS["muted"],
                elinewidth=1,
                alpha=1.0 if one.rank else 0.8,
            )
        axes.set_xlabel(info_of("navigation_time").heading)
        axes.set_ylabel(info_of("success_rate").heading)
        axes.set_ylim(top=min(axes.get_ylim()[1], 101.0))
        _write_names(axes, figure.dpi / 72.0, entries, with_names)
        return _to_svg(figure, f"Success against time of {len(entries)} entries{which}; the table has the same figures")


def _point(one: Standing) -> tuple[float, float]:
    """Return the mean time in seconds and the mean success in per cent."""
    return _ends(one)[1]


def _ends(one: Standing) -> list[tuple[float, float]]:
    """Return time and success at the lower ends of their intervals, at their means, and at the upper ends."""
    time, success = one.figures["navigation_time"], one.figures["success_rate"]
    return [(getattr(time, end), 100.0 * getattr(success, end)) for end in ("low", "mean", "high")]


def _write_names(axes: Axes, scale: float, entries: Sequence[Standing], with_names: Sequence[Standing]) -> None:
    """Write names where they cover few points, intervals and other names; `scale` is pixels per unit of the SVG."""
    frame = shapely.box(*np.asarray(axes.get_window_extent().extents) / scale)
    taken = [box for one in entries for box in _covered(axes, one, scale)]
    for one in with_names:
        name = shorten(one.entry.name, 30).encode("ascii", "replace").decode()
        corner = np.asarray(axes.transData.transform(_point(one))) / scale + _OFFSETS
        width = len(name) * LETTER
        left = np.where(_OFFSETS[:, 0] > 0, corner[:, 0], corner[:, 0] - width)
        boxes = shapely.box(left, corner[:, 1], left + width, corner[:, 1] + 10.0)
        covered = shapely.area(shapely.intersection(boxes[:, None], taken)).sum(axis=1)
        outside = shapely.area(shapely.difference(boxes, frame))
        best = int(np.argmin(covered + 100.0 * outside))
        taken.append(boxes[best])
        offset = _OFFSETS[best]
        axes.annotate(
            name,
            _point(one),
            tuple(offset),
            textcoords="offset points",
            ha="left" if offset[0] > 0 else "right",
            color=COLOURS["ink"] if one.rank else COLOURS["muted"],
            fontweight="bold" if one.is_pareto else "normal",
            arrowprops={"arrowstyle": "-", "color": COLOURS["muted"], "lw": 0.6} if abs(offset).max() > 14 else None,
        )


def _covered(axes: Axes, one: Standing, scale: float) -> list[shapely.Polygon]:
    """Return the areas that the point of an entry and its intervals cover."""
    (left, low), (x, y), (right, high) = np.asarray(axes.transData.transform(_ends(one))) / scale
    edges = [(x - 5, y - 5, x + 5, y + 5), (left, y - 1, right, y + 1), (x - 1, low, x + 1, high)]
    return [shapely.box(*each) for each in edges]
