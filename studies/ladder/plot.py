"""The figure of ladders: for each scenario, the mean score with increasing knowledge as points on a line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import help_from_docstring, main, say
from crowdbench.figures import COLOURS, MARKERS, axes
from studies.pages import read_kept

FIRST = "#888888"
"""The colour of lines, and of the score of the lowest rung."""

KNOWLEDGE = dict(
    zip(
        ("perception", "inference", "goals", "policies", "attention", "chance", "search"),
        zip(MARKERS[1:], (*COLOURS[:6], "#444444"), strict=True),
        strict=True,
    )
)
"""The marker and the colour of a rung, by its additional knowledge over the rung before it."""

COMMAND = "python studies/ladder/run.py"
"""The command that writes the files."""


@help_from_docstring
def plot(files: list[Path], out: Path = Path("ladders.pdf")) -> None:
    """Draw a line for each scenario: from the score of the lowest rung to that of the others, each with a mark.

    A rung that changes nothing has no mark, and neither have best known scores of a part of the cases.

    Args:
        files: Files written by `python studies/ladder/run.py`.
        out: The figure: a .pdf, .svg or .png file.
    """
    found = [
        read_kept(path, COMMAND, ("score", "P0", "mean"), ("best_score", "mean"), ("steps", 0, "knowledge"))
        for path in files
    ]
    lowest, shown = 1.0, set[str]()
    with axes(out, height=1.2 + 0.22 * len(found)) as ax:
        for place, each in enumerate(reversed(found)):
            rungs, best = each["score"], each["best_score"]["mean"]
            means = [rung["mean"] for rung in rungs.values() if rung["n"] == rungs["P0"]["n"]]
            ax.plot([min(means), max(means)], [place, place], color=FIRST, lw=1.6, zorder=2)
            _mark(ax, means[0], place, "o", FIRST, fillstyle="none")
            for step, before, after in zip(each["steps"], means, means[1:], strict=False):
                if after != before:
                    shown.add(step["knowledge"])
                    _mark(ax, after, place, *KNOWLEDGE[step["knowledge"]])
            _mark(ax, best, place + 0.28, 7, "#000000")
            lowest = min(lowest, *means, best)
        ax.set_yticks(range(len(found)), [each["scenario"] for each in reversed(found)])
        ax.set(xlabel="score", xlim=(max(0.0, lowest - lowest % 0.1), 1.015), ylim=(-0.6, len(found) - 0.2))
        _mark(ax, [], [], "o", FIRST, fillstyle="none", label="as sensed")
        for name in filter(shown.__contains__, KNOWLEDGE):
            _mark(ax, [], [], *KNOWLEDGE[name], label="best known" if name == "search" else f"+ {name}")
        _mark(ax, [], [], 7, "#000000", label="best planner")
        ax.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.2, 1.0), columnspacing=1.0, handletextpad=0.2)
    say(f"wrote {out}")


def _mark(ax: Axes, score: Any, place: Any, marker: str | int, colour: str, **options: Any) -> None:
    """Draw the mark of a rung, or of the best planner, at a mean score."""
    ax.plot(score, place, ls="", marker=marker, color=colour, ms=5.5, zorder=4, clip_on="label" in options, **options)


if __name__ == "__main__":
    main(plot)
