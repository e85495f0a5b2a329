"""Figures of Matplotlib as SVG inside a page. Their colours are those of the page, light or dark."""

from __future__ import annotations

import contextlib
import html
import io
import re
from collections.abc import Iterator

import matplotlib.style
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

NAMES = ("ink", "muted", "line", "page", "accent", "bad")
COLOURS = {name: f"#0102{number:02x}" for number, name in enumerate(NAMES)}
"""By the name of a variable of `style.css`, the colour that stands for it while Matplotlib draws."""

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
    "figure.facecolor": "none",
    "grid.color": COLOURS["line"],
    "grid.linewidth": 0.6,
    "xtick.color": COLOURS["line"],
    "ytick.color": COLOURS["line"],
    "xtick.labelcolor": COLOURS["muted"],
    "ytick.labelcolor": COLOURS["muted"],
}


@contextlib.contextmanager
def axes(width: float, height: float) -> Iterator[Axes]:
    """Axes to draw on, in the style of the pages.

    Args:
        width: Width of the figure in inches, of 72 units of the SVG.
        height: Its height.
    """
    with matplotlib.style.context(["default", _STYLE]):
        # Fixed margins: to fit them, Matplotlib would draw every figure several times.
        left, bottom, rest = 0.72, 0.55, 0.1
        inside = (width - left - rest) / width, (height - bottom - rest) / height
        yield Figure(figsize=(width, height)).add_axes((left / width, bottom / height, *inside))


def to_svg(drawn: Axes, label: str) -> Markup:
    """A figure as an element of a page. Call it inside `with axes(...)`.

    Args:
        drawn: The axes of the figure.
        label: What it shows, for those who cannot see it.
    """
    file = io.StringIO()
    figure = drawn.get_figure(root=True)
    assert figure is not None
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
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
