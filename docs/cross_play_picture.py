"""The picture of cross-play: scores of vehicles in crowds, from studies/cross_play/README.md."""

from pathlib import Path

import numpy as np
from matplotlib.patches import Rectangle
from tables import split_row

from crowdbench.figures import axes
from studies.cross_play.run import KNOWN

PAGE = Path(__file__).parents[1] / "studies" / "cross_play" / "README.md"

ROW = 0.2
"""Height of a row in inches."""

LARGEST = 0.8
"""The score of the lightest colour: no vehicle has more."""

FRAME = "#c2542d"
"""The colour of frames around crowds that a vehicle knows."""

ON_DARK, ON_LIGHT = "#fefefe", "#10151a"
"""The colours of numbers, which are the same on dark pages."""


def read_scores() -> tuple[list[str], list[str], np.ndarray]:
    """Return the vehicles, the crowds and the mean scores `[vehicle, crowd]`, in the order of the page."""
    section = PAGE.read_text().split("## Score\n")[1]
    head, _, *rows = [split_row(line) for line in section.strip().split("\n\n")[0].splitlines()]
    means = [[float(cell.split(" ")[0].rstrip("†")) for cell in cells] for _, *cells in rows]
    return [row[0] for row in rows], head[1:], np.array(means)


def draw_cross_play(out: Path) -> None:
    """Draw a cell for each score, with a frame around crowds that the vehicle knows."""
    vehicles, crowds, means = read_scores()
    with axes(out, height=1.0 + ROW * len(vehicles)) as ax:
        ax.pcolormesh(means, cmap="cividis", vmin=0.0, vmax=LARGEST, edgecolors="#888888", linewidth=0.3)
        ax.grid(visible=False)
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        ax.set_xticks(np.arange(len(crowds)) + 0.5, crowds, rotation=45, ha="right")
        ax.set_yticks(np.arange(len(vehicles)) + 0.5, vehicles)
        ax.invert_yaxis()
        for (row, column), mean in np.ndenumerate(means):
            color = ON_LIGHT if mean > LARGEST / 2.0 else ON_DARK
            ax.text(column + 0.5, row + 0.5, f"{mean:.2f}", ha="center", va="center", color=color)
            if crowds[column] in KNOWN[vehicles[row]]:
                box = Rectangle((column + 0.06, row + 0.08), 0.88, 0.84, fill=False, edgecolor=FRAME, linewidth=1.4)
                ax.add_patch(box)
