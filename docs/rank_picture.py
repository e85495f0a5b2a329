"""The picture of ranks: mean scores of planners on the suite in both tracks, from studies/suite/README.md."""

import re
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from tables import split_row

PAGE = Path(__file__).parents[1] / "studies" / "suite" / "README.md"

COLOURS = {"A": "#1f6296", "B": "#c2542d"}
TITLES = {"A": "A: seldom at fault", "B": "B: all others"}


class Row(NamedTuple):
    """A planner in a track: its block, its rank in it, and its mean score with the interval."""

    block: str
    planner: str
    rank: str
    mean: float
    low: float
    high: float


def read_rows(track: str) -> list[Row]:
    """Return the planners of a track in the order of the page."""
    section = PAGE.read_text().split(f"## Ranks with {track} sensing\n")[1]
    _, _, *lines = section.strip().split("\n\n")[0].splitlines()
    rows = []
    for line in lines:
        block, planner, rank, score, *_ = split_row(line)
        rows.append(Row(block, planner, rank, *map(float, re.findall(r"[\d.]+", score))))
    return rows


def draw_ranks(out: Path) -> None:
    """Draw both tracks beside each other."""
    tracks = {track: read_rows(track) for track in ("perfect", "realistic")}
    longest = max(map(len, tracks.values()))
    plt.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "crowdbench"}
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 0.8 + 0.34 * (longest + 2)), sharex=True, layout="constrained")
    for axis, (track, rows) in zip(axes, tracks.items(), strict=True):
        _draw_track(axis, rows)
        axis.set_title(f"{track} sensing", loc="left", fontweight="bold")
    figure.savefig(out, metadata={"Date": None})
    plt.close(figure)


def _draw_track(axis: Axes, rows: list[Row]) -> None:
    """Draw the planners of a track from above, with a title above each block."""
    place, ticks = 0, []
    for block, colour in COLOURS.items():
        members = [row for row in rows if row.block == block]
        title = TITLES[block] if members else f"{TITLES[block]}: none"
        axis.text(0.01, place, title, color=colour, va="center", transform=axis.get_yaxis_transform())
        for row in members:
            place += 1
            ticks.append((place, row.planner))
            axis.plot([row.low, row.high], [place, place], color=colour, linewidth=2.0)
            axis.plot(row.mean, place, "o", color=colour)
            axis.text(row.high + 0.012, place, f"rank {row.rank}", color=colour, va="center")
        place += 1
    axis.set_yticks(*zip(*ticks, strict=True))
    axis.set_ylim(place - 0.3, -0.7)
    axis.set_xlim(0.0, 0.75)
    axis.set_xlabel("mean score")
    axis.grid(axis="x", alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
