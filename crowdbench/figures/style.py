"""The style of figures for a column of a paper, and how a figure is written."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from crowdbench.utils import files
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#000000")
"""Colours that colour-blind readers can tell apart (Okabe and Ito 2008), in the order of the series."""

DASHES = ("-", "--", "-.", ":")
"""Line styles in the order of the series, so that they can be told apart without colour."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

SUFFIXES = (".pdf", ".png", ".svg")

WIDTH, HEIGHT = 3.5, 2.5
"""Size of a figure in inches: a column of a paper of two."""

_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "crowdbench",
    "pdf.fonttype": 42,
    "font.size": 8,
    "text.parse_math": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "lines.linewidth": 1.2,
}


@contextlib.contextmanager
def axes(out: Path, height: float = HEIGHT, caption: str = "") -> Iterator[Axes]:
    """Axes to draw on. The figure is written when the `with` statement ends without an error.

    Args:
        out: The file, whose ending says its format.
        height: In inches.
        caption: Stands above them, small: the cases of the figure.

    Raises:
        InputError: The ending is another one, or the folder does not exist.
    """
    with canvas(out, WIDTH, height) as figure:
        figure.add_subplot().set_title(caption, loc="right", fontsize=6, pad=2)
        yield figure.axes[0]


@contextlib.contextmanager
def canvas(out: Path | None, width: float, height: float) -> Iterator[Figure]:
    """A figure, written when the `with` statement ends without an error.

    Args:
        out: The file, whose ending says its format; None where the figure is not written.
        width: In inches.
        height: In inches.

    Raises:
        InputError: The ending is another one, or the folder does not exist.
    """
    if out is not None:
        check_file(out, SUFFIXES)
    import matplotlib.figure
    import matplotlib.style

    with matplotlib.style.context(["default", _STYLE]):
        figure = matplotlib.figure.Figure(figsize=(width, height), layout="constrained")
        yield figure
        if out is not None:
            with files.whole(out) as partial:
                write(figure, partial, out.suffix[1:])


def write(figure: Figure, file: Path | BinaryIO, kind: str, dpi: float = 300.0) -> None:
    """Write a figure, without the time at which it is made: the same figure has the same bytes.

    Args:
        figure: The figure.
        file: Where to.
        kind: Its format.
        dpi: Pixels per inch.
    """
    stamp = {"Date": None} if kind == "svg" else {"CreationDate": None} if kind == "pdf" else {}
    figure.savefig(file, format=kind, metadata=stamp, dpi=dpi)


def check_file(out: Path, endings: Sequence[str]) -> None:
    """Refuse a file that a figure or a film cannot be written to.

    Args:
        out: The file.
        endings: The endings that it may have.

    Raises:
        InputError: It has another ending, or its folder does not exist.
    """
    if out.suffix not in endings or not out.parent.is_dir():
        listed = f"{', '.join(endings[:-1])} or {endings[-1]}"
        raise InputError(f"a picture goes to a file in a folder that exists, with the ending {listed}, not {out}")
