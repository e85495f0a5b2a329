"""The figure of ladders: the mean scores with increasing knowledge, in a panel for each rung."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import help_from_docstring, main, say
from crowdbench.figures import COLOURS, axes
from studies.pages import read_kept

FIRST, BEST = "as sensed", "best planner"
"""The titles of the panels of the lowest rung, and of the best planner that ships."""

KNOWLEDGE = ("perception", "inference", "goals", "policies", "attention", "chance", "search")
"""The additional knowledge of each rung over the rung before it."""

COLUMNS = 3
"""Number of panels side by side."""

BAR, OTHERS = COLOURS[0], "#999999"
"""The colours of a rung, and of the rung before it and the best planner."""

COMMAND = "python studies/ladder/run.py"
"""The command that writes the files."""


@help_from_docstring
def plot(files: list[Path], out: Path = Path("ladders.pdf")) -> None:
    """Draw a panel for each rung, with a bar for the mean score in each scenario.

    A tick is the score of the rung before. Scenarios without a rung have no bar in its panel.

    Args:
        files: Files written by `python studies/ladder/run.py`.
        out: The figure: a .pdf, .svg or .png file.
    """
    found = [
        read_kept(path, COMMAND, ("score", "P0", "mean"), ("best_score", "mean"), ("steps", 0, "knowledge"))
        for path in files
    ]
    scenarios = [each["scenario"] for each in found]
    ladders = [scores_of(each) for each in found]
    titles = [BEST, FIRST, *(name for name in KNOWLEDGE if any(name in ladder for ladder in ladders))]
    rows = math.ceil(len(titles) / COLUMNS)
    with axes(out, height=rows * (0.45 + 0.13 * len(found))) as ax:
        figure = ax.figure
        ax.remove()
        panels = figure.subplots(rows, COLUMNS, sharex=True, sharey=True).ravel()
        for panel in panels[len(titles) :]:
            panel.set_axis_off()
        for title, panel in zip(titles, panels, strict=False):
            for place, ladder in enumerate(ladders):
                if title in ladder:
                    score, before = ladder[title]
                    panel.barh(place, score, 0.7, color=OTHERS if title == BEST else BAR)
                    panel.plot([before, before], [place - 0.42, place + 0.42], color="#000000", lw=1.1)
            panel.set(xlim=(0.0, 1.0), ylim=(len(found) - 0.4, -0.6))
            added = title not in (BEST, FIRST, "search")
            panel.set_title("best known" if title == "search" else f"+ {title}" if added else title)
            panel.set_yticks(range(len(found)), scenarios)
        figure.supxlabel("mean score; tick: in the panel before", fontsize="medium")
    say(f"wrote {out}")


def scores_of(ladder: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the mean score of each rung by its knowledge, and that of the rung before it."""
    rungs = [rung["mean"] for rung in ladder["score"].values() if rung["n"] == ladder["score"]["P0"]["n"]]
    best = ladder["best_score"]["mean"]
    names = [step["knowledge"] for step in ladder["steps"]]
    later = {name: (after, before) for name, before, after in zip(names, rungs, rungs[1:], strict=False)}
    return {BEST: (best, best), FIRST: (rungs[0], rungs[0]), **later}


if __name__ == "__main__":
    main(plot)
