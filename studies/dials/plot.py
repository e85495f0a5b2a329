"""The figure of a dial: the mean scores of planners at its levels, and where each crosses 0.3."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import help_from_docstring, main, say
from crowdbench.figures import COLOURS, DASHES, FIGURE_HEIGHT, MARKERS, axes
from studies.dials.estimate import WANTED
from studies.pages import read_kept

RUNG = "#666666"
"""The colour of rungs of the ladder, which are no planners."""

LINE = 0.17
"""Height of a line of the legend, in inches."""

BESIDE = 0.08
"""Horizontal distance between the points of planners, in levels."""

COMMAND = "python studies/dials/run.py"
"""The command that writes the files."""


@help_from_docstring
def plot(files: list[Path], out: Path = Path("dial.pdf")) -> None:
    """Draw the mean scores of planners at the levels of a dial, with 95 % intervals, and the result of each.

    Args:
        files: Files written by `python studies/dials/run.py`.
        out: The figure: a .pdf, .svg or .png file.
    """
    found = [
        read_kept(path, COMMAND, ("dial", "levels"), ("rows", 0, "bounds"), ("rows", 0, "is_rung")) for path in files
    ]
    dial = found[0]["dial"]
    if others := [path for path, each in zip(files, found, strict=True) if each["dial"] != dial]:
        raise InputError(f"{others[0]} is of another dial than {files[0]}: give files of one dial")
    if len(found) > len(COLOURS):
        raise InputError(f"{len(found)} planners cannot be told apart in one figure: give {len(COLOURS)} at most")
    levels = np.array(dial["levels"], float)
    place = np.arange(len(levels))
    columns = min(3, math.ceil(len(found) / 2))
    with axes(out, FIGURE_HEIGHT + LINE * math.ceil(len(found) / columns)) as ax:
        ax.axhline(WANTED, color="#888888", linewidth=0.8)
        for number, each in enumerate(found):
            (row,) = each["rows"]
            colour, label = COLOURS[number], row["planner"]
            if row["is_rung"]:
                colour, label = RUNG, f"{label} of the ladder"
            beside = BESIDE * (number - (len(found) - 1) / 2)
            score, (low, high) = np.array(row["score"]), np.array(row["bounds"])
            ends, dash = np.maximum([score - low, high - score], 0.0), DASHES[number % len(DASHES)]
            ax.errorbar(place + beside, score, yerr=ends, fmt="none", ecolor=colour, elinewidth=0.8, capsize=1.5)
            ax.plot(place + beside, score, dash, color=colour, marker=MARKERS[number], ms=3, label=label)
            if row["wanted"] and row["wanted"]["level"] is not None:
                level = np.interp(row["wanted"]["level"], np.sort(levels), np.argsort(levels))
                ax.plot([level, level], [0.0, WANTED], ":", color=colour, linewidth=0.8)
        ax.set_xticks(place, [f"{level:g}" for level in levels])
        ax.set(xlabel=dial["label"].format("…").removeprefix("… "), ylabel="score", ylim=(0.0, 1.02))
        # Above the axes, because curves fall from one corner to the other.
        ax.legend(ncols=columns, loc="lower center", bbox_to_anchor=(0.45, 1.0), columnspacing=1.0)
    say(f"wrote {out}")


if __name__ == "__main__":
    main(plot)
