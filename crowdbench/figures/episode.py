"""An episode seen from above: as a figure, as moments side by side, or as a film."""

from __future__ import annotations

import io
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Trace, World
from crowdbench.drawing import (
    CONSIDERED,
    CROWD,
    FORESEEN,
    LIGHT,
    Color,
    Disc,
    Line,
    Moment,
    Polygon,
    Shape,
    Text,
    draw_moment,
    extent,
)
from crowdbench.figures.style import canvas, check_file, write
from crowdbench.figures.time_marks import mark_times
from crowdbench.record.cases import read_case
from crowdbench.record.decisions import PlannedPaths, read_paths
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

SIDE = 3.5
"""Length in inches of the longer side of a picture of the plane."""

FILMS = {".gif": 160, ".mp4": 320}
"""The endings of films, and how many dots per inch their pictures have: a .gif would be too large with more."""


@dataclass(frozen=True)
class Episode:
    """An episode of a trace, and the part of the plane that its pictures show.

    Attributes:
        trace: The trace.
        row: The row of the episode.
        zoom: How many metres around the vehicle are shown, which pictures of a moment follow; None for all that
            matters.
        paths: Predicted and considered paths, by the number of the state.
    """

    trace: Trace
    row: int
    zoom: float | None = None
    paths: Mapping[int, PlannedPaths] = field(default_factory=dict)

    @property
    def end(self) -> int:
        """The last state."""
        return int(self.trace.steps[self.row])

    def bounds(self, state: int | None = None) -> Float[np.ndarray, "2 2"]:
        """The smallest and the largest x and y in metres that are shown of a state, or of the whole episode."""
        trace, row, states = self.trace, self.row, slice(self.end + 1)
        if self.zoom is None:  # the pedestrians' goals may be outside
            return extent(trace.position[row, states], trace.goal[row, states, 0], trace.obstacles[row], 1.1)
        path = trace.position[row, states if state is None else slice(state, state + 1), 0]
        half = self.zoom / 2
        return np.stack([path.min(axis=0) - half, path.max(axis=0) + half])


def trajectories(episode: Episode, out: Path) -> None:
    """Draw a whole episode: all paths, discs at the end, and where the vehicle was when.

    Args:
        episode: The episode.
        out: The figure's file.

    Raises:
        InputError: The file cannot be written.
    """
    bounds = episode.bounds()
    marks = mark_times(episode.trace, episode.row, bounds, float((bounds[1] - bounds[0]).max()) / SIDE)
    with canvas(out, *_fit(*bounds)) as figure:
        _draw_state(figure.add_subplot(), episode, None, marks)


def draw_case(recording: Path, case: int, out: Path, moments: int | None = None, zoom: float | None = None) -> None:
    """Draw a recorded case, as a film where the file is one.

    Args:
        recording: The recording.
        case: The number of the case.
        out: A file of `FILMS`, or a figure.
        moments: How many moments a figure shows side by side; None for the whole path in one.
        zoom: See `Episode`.

    Raises:
        InputError: The case is not recorded.
    """
    recorded = read_case(recording, case)
    episode = Episode(recorded.trace, 0, zoom, read_paths(recorded.chunks, recorded.trace.rules.dt))
    if out.suffix in FILMS:
        film(episode, out)
    elif moments is not None:
        strip(episode, moments, out)
    else:
        trajectories(episode, out)


def draw_start(scenario: Scenario, split: str, number: int, out: Path) -> None:
    """Draw a case before anything has happened: where everybody starts, and which way they want to go.

    Args:
        scenario: The scenario.
        split: The split of the case.
        number: Its number.
        out: The figure's file.

    Raises:
        InputError: The case cannot be started, or the file cannot be written.
    """
    world = scenario.draw(split, np.array([number]))
    present = np.flatnonzero(world.present[0])
    routes = [_route(world, agent) for agent in present[:CROWD]]
    low, high = extent(np.concatenate(routes), world.goal[0, :1], world.obstacles[0], 0.7)
    colors = [LIGHT.vehicle if agent == 0 else LIGHT.walked for agent in present]
    lines = [Line(route, color, 0.8) for route, color in zip(routes, colors, strict=False)]
    goals = [Disc(route[-1], 0.08, LIGHT.walked, None, 0.0) for route in routes[1:]]
    with canvas(out, *_fit(low, high)) as figure:
        shapes = draw_moment(Moment.of_worlds([world]), low)
        draw(_plane(figure.add_subplot(), low, high), [*lines, *goals, *shapes])


def _route(world: World, agent: int) -> Float[np.ndarray, "point 2"]:
    """Return the route of an agent: from its start over the waypoints to its goal."""
    waypoints = world.route[0, agent]
    waypoints = waypoints[np.isfinite(waypoints[:, 0])]
    return np.concatenate([world.position[0, agent, None], waypoints, world.goal[0, agent, None]])


def strip(episode: Episode, moments: int, out: Path) -> None:
    """Draw moments of an episode side by side, equally far apart in time, the last one at its end.

    Args:
        episode: The episode.
        moments: How many.
        out: The figure's file.

    Raises:
        InputError: The file cannot be written.
    """
    states = np.linspace(0, episode.end, moments + 1).round().astype(int)[1:]
    width, height = _fit(*episode.bounds(0))
    scale = 7.0 / (width * moments)  # as wide as both columns of a paper
    with canvas(out, 7.0, height * scale + 0.2) as figure:
        for column, state in enumerate(states.tolist(), 1):
            axes = figure.add_subplot(1, moments, column)
            _draw_state(axes, episode, state)
            axes.set_title(f"{state * episode.trace.rules.dt:g} s", fontsize=7, pad=2)


def film(episode: Episode, out: Path) -> None:
    """Make a film of an episode.

    Args:
        episode: The episode.
        out: A .gif or .mp4 file; for the latter the program ffmpeg is needed.

    Raises:
        InputError: The file cannot be written, or ffmpeg is missing.
    """
    check_file(out, [*FILMS])
    if out.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(f"a film {out.name} needs the program ffmpeg (Debian: ffmpeg); a .gif file does not")
    seconds = episode.trace.rules.dt
    with files.whole(out) as partial:
        if out.suffix == ".gif":
            first, *others = _frames(episode, FILMS[out.suffix])
            first.save(
                partial, format="GIF", save_all=True, append_images=others, duration=round(1000 * seconds), loop=0
            )
            return
        command = f"ffmpeg -loglevel error -y -f image2pipe -framerate {1 / seconds:g} -i -".split()
        command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-f", "mp4", str(partial)]
        pictures = io.BytesIO()
        for frame in _frames(episode, FILMS[out.suffix]):
            frame.save(pictures, format="PNG")
        process = subprocess.run(command, input=pictures.getvalue(), capture_output=True)
        if process.returncode:
            raise InputError(f"ffmpeg could not make {out}: {process.stderr.decode(errors='replace').strip()[-200:]}")


def _frames(episode: Episode, dpi: int) -> Iterator[Image]:
    """A picture of each state, the last one a few times, so that one sees how the episode ends."""
    from PIL import Image as Images

    for state in [*range(episode.end + 1), *[episode.end] * 8]:
        page = io.BytesIO()
        with canvas(None, *_fit(*episode.bounds(0))) as figure:
            axes = figure.add_subplot()
            _draw_state(axes, episode, state)
            axes.text(
                0.02, 0.98, f"{state * episode.trace.rules.dt:.2f} s", transform=axes.transAxes, va="top", fontsize=8
            )
            write(figure, page, "png", dpi=dpi)
        yield Images.open(page).convert("RGB")


def _fit(low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> tuple[float, float]:
    """Width and height in inches of a picture of a part of the plane."""
    width, height = SIDE * (high - low) / (high - low).max()
    return float(width), float(height)


def _draw_state(axes: Axes, episode: Episode, state: int | None, marks: Iterable[Shape] = ()) -> None:
    """Draw a state of an episode, or the last one among all that is shown, with a scale, and marks over it."""
    low, high = episode.bounds(state)
    state = episode.end if state is None else state
    planned = episode.paths.get(state, PlannedPaths([], []))
    lines = [Line(path, FORESEEN, 0.4) for path in planned.predicted]
    lines += [Line(path, CONSIDERED, 0.4) for path in planned.considered]
    shapes = draw_moment(Moment.of_trace(episode.trace, episode.row, state), low)
    draw(_plane(axes, low, high), [*lines, *shapes, *marks])


def _plane(axes: Axes, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> Axes:
    """Axes that show a part of the plane, in metres, and nothing else."""
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.axis("off")
    return axes


def draw(axes: Axes, shapes: Iterable[Shape]) -> None:
    """Draw shapes on axes, which are in metres: each over those before it."""
    from matplotlib.patches import Circle
    from matplotlib.patches import Polygon as Patch

    for order, shape in enumerate(shapes):
        match shape:
            case Line(points, color, width):
                axes.plot(*points.T, color=_rgb(color), lw=width, zorder=order)
            case Disc(centre, radius, face, edge, width):
                colors = {"facecolor": _rgb(face), "edgecolor": _rgb(edge or face)}
                axes.add_patch(Circle(tuple(centre), radius, **colors, lw=width, zorder=order))
            case Polygon(corners, face, edge, width):
                axes.add_patch(Patch(corners, facecolor=_rgb(face), edgecolor=_rgb(edge), lw=width, zorder=order))
            case Text(at, text, color, size, is_left):
                side = "left" if is_left else "center"
                axes.text(at[0], at[1], text, color=_rgb(color), fontsize=size, ha=side, va="center", zorder=order)


def _rgb(color: Color | None) -> tuple[float, ...] | str:
    """A colour as Matplotlib takes it."""
    return "none" if color is None else tuple(channel / 255.0 for channel in color)
