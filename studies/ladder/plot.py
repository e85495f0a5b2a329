"""The figure of ladders: a bar for each scenario, whose parts are the gains with ever more knowledge."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import main
from crowdbench.cli.console import say
from crowdbench.cli.options import help_from_docstring
from crowdbench.figures.style import COLOURS, axes
from studies.pages import read_kept

FIRST = "#bbbbbb"
"""The colour of the success of the lowest rung."""

KNOWLEDGE = dict(
    zip(("perception", "inference", "goals", "policies", "attention", "chance", "search"), COLOURS, strict=False)
)
"""The colours of the gains."""

COMMAND = "python studies/ladder/run.py"
"""Writes the files."""


@help_from_docstring
def plot(files: list[Path], out: Path = Path("ladders.pdf")) -> None:
    """Draw a bar for each scenario: the success of the lowest rung, and what each further one adds or takes away.

    Args:
        files: Files that `python studies/ladder/run.py` kept.
        out: The figure: a .pdf, .svg or .png file.
    """
    found = [
        read_kept(path, COMMAND, ("success", "P0", "mean"), ("best_success", "mean"), ("steps", 0, "knowledge"))
        for path in files
    ]
    lowest = 100.0
    with axes(out, height=0.9 + 0.25 * len(found)) as ax:
        for place, each in enumerate(reversed(found)):
            rates = [100.0 * rung["mean"] for rung in each["success"].values()]
            ax.barh(place, rates[0], color=FIRST, height=0.6)
            for step, before, after in zip(each["steps"], rates, rates[1:], strict=False):
                left, width = min(before, after), abs(after - before)
                loses = after < before
                # A loss is narrower, and in front: what a later rung gains lies in the same place.
                height, hatch, order = (0.25, "////", 4) if loses else (0.6, None, 3)
                bar = ax.barh(place, width, left=left, height=height, color=KNOWLEDGE[step["knowledge"]], zorder=order)
                bar.patches[0].set(hatch=hatch, edgecolor="white")
            ax.plot([100.0 * each["best_success"]["mean"]], [place], "k*", ms=5, zorder=5, clip_on=False)
            lowest = min(lowest, *rates, 100.0 * each["best_success"]["mean"])
        names = [each["scenario"] for each in reversed(found)]
        ax.set_yticks(range(len(found)), names, fontsize=6)
        ax.set(xlabel="success, %", xlim=(max(0.0, lowest - lowest % 10.0 - 10.0), 101))
        ax.grid(visible=False, axis="y")
        bars = [ax.barh(0, 0, color=colour, label=name) for name, colour in KNOWLEDGE.items()]
        star = ax.plot([], [], "k*", ms=5, label="best planner")
        ax.legend(
            handles=[*bars, *star],
            ncols=4,
            loc="lower center",
            bbox_to_anchor=(0.3, 1.0),
            fontsize=6,
            columnspacing=0.8,
        )
    say(f"wrote {out}")


if __name__ == "__main__":
    main(plot)
