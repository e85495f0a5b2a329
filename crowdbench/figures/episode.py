"""An episode seen from above: as a figure, as moments side by side, or as a film."""

from __future__ import annotations

import io
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from crowdbench import files
from crowdbench.dynamics import Holonomic, nose, outline
from crowdbench.errors import InputError
from crowdbench.figures.style import canvas, check_file, write
from crowdbench.geometry import polygons
from crowdbench.record.hit import pedestrian_hit
from crowdbench.types import Outcome, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

VEHICLE, PEDESTRIAN, HIT, WALL, MUTED = "#de7a00", "#2668b2", "#d62728", "#9a9a94", "#707070"

SIDE = 3.5
"""Length in inches of the longer side of a picture of the plane."""

MARKED = 2.0
"""Seconds between the discs along the vehicle's way in a figure of a whole episode."""

FILMS = {".gif": 160, ".mp4": 320}
"""The endings of films, and how many dots per inch their pictures have: a .gif would be too large with more."""


def trajectories(trace: Trace, row: int, out: Path) -> None:
    """Draw a whole episode: all ways, discs at the end, and the vehicle every `MARKED` seconds with the time.

    Args:
        trace: The trace with the episode.
        row: Its row.
        out: The figure's file.

    Raises:
        InputError: The file cannot be written.
    """
    end, dt = int(trace.steps[row]), trace.rules.dt
    with canvas(out, *_size(trace, row)) as figure:
        axes = figure.add_subplot()
        _plane(axes, trace, row)
        _state(axes, trace, row, end)
        every = max(round(MARKED / dt), 1)
        for state in range(0, end, every):
            place, radius = trace.position[row, state, 0], float(trace.radius[row, state, 0])
            _disc(axes, place, radius, VEHICLE, filled=False)
            axes.annotate(
                f"{state * dt:g} s", (place[0] + 1.2 * radius, place[1]), color=VEHICLE, fontsize=6, va="center"
            )


def strip(trace: Trace, row: int, moments: int, out: Path) -> None:
    """Draw moments of an episode side by side, equally far apart in time, the last one at its end.

    Args:
        trace: The trace with the episode.
        row: Its row.
        moments: How many.
        out: The figure's file.

    Raises:
        InputError: The file cannot be written.
    """
    states = np.linspace(0, int(trace.steps[row]), moments + 1).round().astype(int)[1:]
    width, height = _size(trace, row)
    scale = 7.0 / (width * moments)  # as wide as both columns of a paper
    with canvas(out, 7.0, height * scale + 0.2) as figure:
        for place, state in enumerate(states.tolist()):
            axes = figure.add_subplot(1, moments, place + 1)
            _plane(axes, trace, row)
            _state(axes, trace, row, state)
            axes.set_title(f"{state * trace.rules.dt:g} s", fontsize=7, pad=2)


def film(trace: Trace, row: int, out: Path) -> None:
    """Make a film of an episode.

    Args:
        trace: The trace with the episode.
        row: Its row.
        out: A .gif or .mp4 file; for the latter the program ffmpeg is needed.

    Raises:
        InputError: The file cannot be written, or ffmpeg is missing.
    """
    check_file(out, [*FILMS])
    if out.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(f"a film {out.name} needs the program ffmpeg (Debian: ffmpeg); a .gif file does not")
    seconds = trace.rules.dt
    with files.whole(out) as partial:
        if out.suffix == ".gif":
            first, *others = _frames(trace, row, FILMS[out.suffix])
            first.save(
                partial, format="GIF", save_all=True, append_images=others, duration=round(1000 * seconds), loop=0
            )
            return
        command = [
            "ffmpeg",
            "-loglevel",
            "error",
            "-y",
            "-f",
            "image2pipe",
            "-framerate",
            f"{1 / seconds:g}",
            "-i",
            "-",
        ]
        command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-f", "mp4", str(partial)]
        pictures = io.BytesIO()
        for frame in _frames(trace, row, FILMS[out.suffix]):
            frame.save(pictures, format="PNG")
        ended = subprocess.run(command, input=pictures.getvalue(), capture_output=True)
        if ended.returncode:
            raise InputError(f"ffmpeg could not make {out}: {ended.stderr.decode(errors='replace').strip()[-200:]}")


def _frames(trace: Trace, row: int, dpi: int) -> Iterator[Image]:
    """A picture of each state, the last one a few times, so that one sees how the episode ends."""
    from PIL import Image as Images

    width, height = _size(trace, row)
    end = int(trace.steps[row])
    for state in [*range(end + 1), *[end] * 8]:
        page = io.BytesIO()
        with canvas(None, width, height) as figure:
            axes = figure.add_subplot()
            _plane(axes, trace, row)
            _state(axes, trace, row, state)
            axes.text(0.02, 0.98, f"{state * trace.rules.dt:.2f} s", transform=axes.transAxes, va="top", fontsize=8)
            write(figure, page, "png", dpi=dpi)
        yield Images.open(page).convert("RGB")


def _size(trace: Trace, row: int) -> tuple[float, float]:
    """Width and height in inches of a picture of the plane."""
    low, high = _extent(trace, row)
    width, height = high - low
    scale = SIDE / max(width, height)
    return float(width * scale), float(height * scale)


def _extent(trace: Trace, row: int) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The smallest and the largest x and y in metres that an episode needs, with a margin."""
    states = slice(int(trace.steps[row]) + 1)
    present = trace.present[row, states]
    points = [trace.position[row, states][present], trace.goal[row, states, 0], *polygons(trace.obstacles[row])]
    together = np.concatenate(points)
    return together.min(axis=0) - 0.7, together.max(axis=0) + 0.7


def _plane(axes: Axes, trace: Trace, row: int) -> None:
    """What does not move: obstacles, the vehicle's goal, and a bar of 1 m."""
    from matplotlib.patches import Polygon

    low, high = _extent(trace, row)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.axis("off")
    for corners in polygons(trace.obstacles[row]):
        axes.add_patch(Polygon(corners, closed=True, facecolor="#e4e4de", edgecolor=WALL, lw=1.0))
    axes.plot(*trace.goal[row, 0, 0], marker="*", ms=8, color=VEHICLE, mec="white", mew=0.5, zorder=1)
    corner = low + 0.3
    axes.plot([corner[0], corner[0] + 1.0], [corner[1]] * 2, color=MUTED, lw=1.0)
    axes.annotate("1 m", (corner[0] + 0.5, corner[1]), (0, 2), textcoords="offset points", ha="center", fontsize=6)


def _state(axes: Axes, trace: Trace, row: int, state: int) -> None:
    """Everybody in one state, with their ways so far; at the end of a collision, whom the vehicle hits is red."""
    is_hit = trace.outcome[row] == Outcome.COLLISION and state == int(trace.steps[row])
    hit = 1 + pedestrian_hit(trace, row) if is_hit else None
    position, radius = trace.position[row], trace.radius[row, state]
    for agent in reversed(range(position.shape[1])):
        way = position[: state + 1, agent].copy()
        if agent:  # no line leads from one person to another who has taken its place
            way[1:][np.diff(trace.person[row, : state + 1, agent - 1]) != 0] = np.nan
        colour = VEHICLE if agent == 0 else HIT if agent == hit else PEDESTRIAN
        axes.plot(
            *way.T, color=colour, lw=1.6 if agent == 0 else 0.8, alpha=1.0 if agent in (0, hit) else 0.5, zorder=2
        )
        if trace.present[row, state, agent]:
            _disc(axes, position[state, agent], float(radius[agent]), colour, filled=True)
    if not isinstance(trace.rules.dynamics, Holonomic):
        place = trace.rules.body, position[state : state + 1, 0], trace.heading[row, state : state + 1]
        for line in (*outline(*place, float(radius[0])), *nose(*place, float(radius[0]))):
            axes.plot(*line.T, color=VEHICLE, lw=1.0, zorder=4)


def _disc(axes: Axes, place: Float[np.ndarray, "2"], radius: float, colour: str, *, filled: bool) -> None:
    from matplotlib.patches import Circle

    face = colour if filled else "none"
    axes.add_patch(Circle(tuple(place), radius, facecolor=face, edgecolor=colour, lw=0.6, alpha=0.9, zorder=3))
