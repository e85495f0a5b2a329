"""The style of figures for a column of a paper, and functions that draw shapes and write figures."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from crowdbench.drawing import FONT_SIZE, SERIES, Color, Disc, Line, Polygon, Shape, Text
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = tuple(f"#{bytes(color).hex()}" for color in SERIES)
"""Colours in the order of the series."""

DASHES = ("-", "--", "-.", ":")
"""Line styles in the order of the series, so that they can be told apart without colour."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

SUFFIXES = (".pdf", ".png", ".svg")

WIDTH, FIGURE_HEIGHT = 3.5, 2.5
"""Size of a figure in inches: one column of a paper with two columns."""

STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "crowdbench",
    "pdf.fonttype": 42,
    **dict.fromkeys(("font.size", "axes.titlesize", "legend.fontsize"), FONT_SIZE),
    "text.parse_math": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
}


@contextlib.contextmanager
def axes(out: Path, height: float = FIGURE_HEIGHT, caption: str = "") -> Iterator[Axes]:
    """Yield axes to draw on. The figure is written when the `with` statement ends without an error.

    Args:
        out: The file, whose ending determines its format.
        height: In inches.
        caption: The title, which states the cases of the figure.

    Raises:
        InputError: The ending is not supported, or the folder does not exist.
    """
    with canvas(out, WIDTH, height) as figure:
        figure.add_subplot().set_title(caption, loc="right", pad=2)
        yield figure.axes[0]


@contextlib.contextmanager
def canvas(out: Path, width: float, height: float) -> Iterator[Figure]:
    """Yield a figure, which is written when the `with` statement ends without an error.

    Args:
        out: The file, whose ending determines its format.
        width: In inches.
        height: In inches.

    Raises:
        InputError: The ending is not supported, or the folder does not exist.
    """
    check_file(out, SUFFIXES)
    import matplotlib.figure
    import matplotlib.style

    with matplotlib.style.context(["default", STYLE]):
        figure = matplotlib.figure.Figure(figsize=(width, height), layout="constrained")
        yield figure
        # Without the time of creation, so that the same figure has the same bytes.
        metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(out.suffix)
        with files.write_whole(out) as partial:
            figure.savefig(partial, format=out.suffix[1:], metadata=metadata, dpi=300.0)


def check_file(out: Path, endings: Sequence[str]) -> None:
    """Raise InputError unless a figure or a film can be written to a file.

    Args:
        endings: The endings that it may have.

    Raises:
        InputError: It has another ending, or its folder does not exist.
    """
    if out.suffix not in endings or not out.parent.is_dir():
        listed = f"{', '.join(endings[:-1])} or {endings[-1]}"
        raise InputError(f"a picture is written to a file in an existing folder, with the ending {listed}, not {out}")


def draw_panel(
    figure: Figure, place: tuple[int, int, int], bounds: Float[np.ndarray, "2 2"], shapes: Iterable[Shape]
) -> None:
    """Draw shapes, each over the previous ones, in a panel of a figure that shows a part of the plane, without axes.

    Args:
        place: Numbers of rows, of columns, and of the panel, from 1 on.
        bounds: The smallest and the largest x and y in metres.
    """
    from matplotlib.patches import Circle
    from matplotlib.patches import Polygon as Patch

    axes = figure.add_subplot(*place)
    axes.set(xlim=bounds[:, 0], ylim=bounds[:, 1], aspect="equal")
    axes.axis("off")
    for order, shape in enumerate(shapes):
        match shape:
            case Line(points, color, width):
                axes.plot(*points.T, color=_rgb(color), lw=width, zorder=order, solid_capstyle="butt")
            case Disc(centre, radius, face, edge, width):
                colors = {"facecolor": _rgb(face), "edgecolor": _rgb(edge or face)}
                axes.add_patch(Circle(tuple(centre), radius, **colors, lw=width, zorder=order))
            case Polygon(corners, face, edge, width):
                axes.add_patch(Patch(corners, facecolor=_rgb(face), edgecolor=_rgb(edge), lw=width, zorder=order))
            case Text(at, text, color, anchor, halo, size):
                side = {"l": "left", "m": "center", "r": "right"}[anchor]
                written = axes.text(
                    at[0], at[1], text, color=_rgb(color), fontsize=size, ha=side, va="center", zorder=order
                )
                if halo:
                    written.set(bbox={"facecolor": _rgb(halo), "edgecolor": "none", "alpha": 0.75, "pad": 0.5})


def _rgb(color: Color | None) -> tuple[float, ...] | str:
    """Return a colour in Matplotlib's format."""
    return "none" if color is None else tuple(channel / 255.0 for channel in color)
