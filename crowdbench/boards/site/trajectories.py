"""The picture of an episode: the ways of the vehicle and the pedestrians, and how it ended."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from crowdbench.boards.site.svg import COLOURS, axes, to_svg
from crowdbench.geometry import polygons
from crowdbench.record.hit import pedestrian_hit
from crowdbench.types import Outcome, Trace

EVERY = 1.0
"""Seconds between the discs that show where the vehicle, and whom it ran into, was."""


def picture(trace: Trace, row: int, label: str) -> Markup:
    """The trajectories of an episode up to its end.

    Args:
        trace: The trace with the episode.
        row: Its row.
        label: What it shows, for those who cannot see it.
    """
    last = int(trace.steps[row])
    position, radius = trace.position[row, : last + 1], trace.radius[row, last]
    present = [agent for agent in range(position.shape[1]) if trace.present[row, : last + 1, agent].any()]
    hit = 1 + pedestrian_hit(trace, row) if trace.outcome[row] == Outcome.COLLISION else None
    with axes(4.4, 4.4) as drawn:
        for agent in sorted(present, key=lambda agent: (agent == 0, agent == hit, agent)):
            every = round(EVERY / trace.rules.dt) if agent in (0, hit) else 0
            way = position[:, agent].copy()
            if agent > 0:  # no line leads from one person to another who has taken its place
                way[1:][np.diff(trace.person[row, : last + 1, agent - 1]) != 0] = np.nan
            _way(drawn, way, radius[agent], every, *_style(agent, hit))
        for corners in polygons(trace.obstacles[row]):
            drawn.add_patch(Polygon(corners, closed=True, facecolor=COLOURS["line"], edgecolor=COLOURS["ink"], lw=1.2))
        goal = trace.goal[row, last, 0]
        drawn.plot(*goal, marker="*", markersize=13, color=COLOURS["accent"], markeredgecolor=COLOURS["page"])
        if hit is not None:
            ring = Circle(tuple(position[last, [0, hit]].mean(axis=0)), 0.75, fill=False, color=COLOURS["bad"], lw=1.2)
            drawn.add_patch(ring)
        _limit(drawn, np.concatenate([position[:, present].reshape(-1, 2), goal[None]]))
        return to_svg(drawn, label)


def _style(agent: int, hit: int | None) -> tuple[str, float]:
    """Colour and line width of an agent."""
    if agent == 0:
        return COLOURS["accent"], 2.4
    return (COLOURS["bad"], 1.8) if agent == hit else (COLOURS["muted"], 1.0)


def _way(
    drawn: Axes, position: Float[np.ndarray, "time 2"], radius: float, every: int, colour: str, width: float
) -> None:
    """A way with a disc at the end, and others every so many steps, unless that is 0."""
    drawn.plot(position[:, 0], position[:, 1], color=colour, lw=width, solid_capstyle="round")
    there = position[np.isfinite(position).all(axis=1)]
    for centre in there[: -1 : max(every, 1)] if every else []:
        drawn.add_patch(Circle((centre[0], centre[1]), radius, fill=False, color=colour, alpha=0.45, lw=0.7))
    end = Circle((there[-1, 0], there[-1, 1]), radius, facecolor=colour, edgecolor=COLOURS["page"], lw=0.8, zorder=3)
    drawn.add_patch(end)


def _limit(drawn: Axes, points: Float[np.ndarray, "point 2"]) -> None:
    """Show all points, a metre of space around them, and one scale for both axes."""
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    middle, half = (low + high) / 2, (high - low).max() / 2 + 0.6
    drawn.set_xlim(middle[0] - half, middle[0] + half)
    drawn.set_ylim(middle[1] - half, middle[1] + half)
    drawn.set_aspect("equal")
    drawn.grid(True)
    drawn.set_axisbelow(True)
    drawn.spines[:].set_visible(False)
    drawn.tick_params(length=0)
    drawn.set_xlabel("x (m)")
    drawn.set_ylabel("y (m)")
