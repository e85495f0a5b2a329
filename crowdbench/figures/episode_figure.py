"""Episodes seen from above: as a figure, as moments side by side, or as a film."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import shutil
import subprocess
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import PIPE
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Outcome, Trace, World
from crowdbench.drawing import (
    CROWD,
    LIGHT,
    MEASURED,
    Color,
    Disc,
    Line,
    Moment,
    Shape,
    Text,
    agent_name,
    draw_bands,
    draw_moment,
    extent,
    measured_rings,
)
from crowdbench.envs.render import rasterize
from crowdbench.figures.style import SUFFIXES, canvas, check_file, draw_panel
from crowdbench.figures.time_marks import mark_times
from crowdbench.record.decisions import PlannedPaths
from crowdbench.record.explanation import describe_failure
from crowdbench.record.recorded_cases import read_recorded
from crowdbench.results.episodes import RECORDING
from crowdbench.results.run_result import RunResult
from crowdbench.runs.replay import Loader, stored_case
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image

Picture = tuple[list[Shape], Float[np.ndarray, "2 2"], float]
"""The shapes of a picture, the smallest and the largest x and y in metres, and the metres per inch."""

SIDE = 3.5
"""Length in inches of the longer side of a picture of the plane."""

WHOLE = 7.0
"""Width in inches of both columns of a paper, the largest width of pictures side by side."""

FILMS = {".gif": 144, ".webp": 144, ".mp4": 288}
"""The endings of films, and the dots per inch of their pictures. With more, a .gif file would be too large."""

WIDE = 3.0
"""Smallest length in inches of a side with room for a title and a key."""

RATE = 20
"""Pictures of a film per second."""

HOLD = 3 * RATE
"""Number of pictures that show the end of a film."""

LINE = 0.15
"""Height in inches of a line of a verdict below a film."""


@dataclass(frozen=True)
class Episode:
    """An episode of a trace, and the part of the plane that its pictures show.

    Attributes:
        trace: The trace.
        row: The row of the episode.
        zoom: Size in metres of the shown part around the vehicle, which is the centre of pictures of a moment; None for
            the whole scene.
        paths: Paths that the planner predicted, considered and planned, by the number of the state.
        title: A title of its pictures; empty for none.
        side: Length in inches of the longer side of its pictures.
        has_key: True if its pictures have a key of the marks of measured positions. A narrow picture with a title has
            no room for it.
    """

    trace: Trace
    row: int
    zoom: float | None = None
    paths: Mapping[int, PlannedPaths] = field(default_factory=dict)
    title: str = ""
    side: float = SIDE
    has_key: bool = True

    @functools.cached_property
    def key(self) -> str:
        """The key of its pictures; empty if the vehicle measures all pedestrians where they are."""
        states = range(self.end + 1)
        has_marks = self.trace.perceived is not None and any(
            measured_rings(moment.measured, moment.position[-1, 1:], moment.radius[1:], moment.rules.sensor.detector)
            for moment in (Moment.of_trace(self.trace, self.row, state) for state in states)
        )
        return MEASURED if has_marks else ""

    @property
    def end(self) -> int:
        """The number of the last state."""
        return int(self.trace.steps[self.row])

    @property
    def outcome(self) -> tuple[str, Color]:
        """The outcome in short, and its colour; in a narrow picture there is no room to name the failure."""
        outcome = Outcome(int(self.trace.outcome[self.row]))
        seconds = f"{self.end * self.trace.rules.dt:g} s"
        if outcome is Outcome.SUCCESS:
            return f"\N{CHECK MARK} {seconds}", LIGHT.success
        if self.side <= 2.0:
            return f"\N{BALLOT X} {seconds}", LIGHT.contact
        moment = Moment.of_trace(self.trace, self.row, self.end)
        hit = [agent_name(agent, moment.rules) for agent in moment.hit]
        failure = " and ".join(hit) or outcome.label.replace("_", " ")
        return f"\N{BALLOT X} {failure}, {seconds}", LIGHT.contact

    @functools.cached_property
    def verdict(self) -> list[str]:
        """The first sentence of the verdict on a failure, as lines that are as wide as the picture."""
        (low, high), inch = self.picture(0.0)[1:]
        sentences = describe_failure(self.trace, self.row)
        return textwrap.wrap(sentences[0], int(17.0 * (high - low)[0] / inch)) if sentences else []

    def bounds(self, centre: Float[np.ndarray, "2"] | None = None) -> Float[np.ndarray, "2 2"]:
        """Return the smallest and the largest x and y of the shown part of the plane.

        Args:
            centre: Position in metres of the vehicle, the centre of a zoomed picture; None for the whole episode.
        """
        trace, row, states = self.trace, self.row, slice(self.end + 1)
        if self.zoom is None:  # the pedestrians' goals may be outside
            return extent(trace.position[row, states], trace.goal[row, states, 0], trace.obstacles[row], 0.7)
        path = trace.position[row, states, 0] if centre is None else centre[None]
        return np.stack([path.min(axis=0) - self.zoom / 2, path.max(axis=0) + self.zoom / 2])

    def picture(self, step: float | None = None) -> Picture:
        """Return a picture of a time, or of the whole episode.

        Args:
            step: A time in steps, which may be between two states; None for the whole episode with marks of the time.
        """
        trace, row = self.trace, self.row
        at = float(self.end) if step is None else min(step, float(self.end))
        state = math.floor(at)
        moment = Moment.of_trace(trace, row, state, at - state)
        plane = self.bounds(None if step is None else moment.position[-1, 0])
        note = self.outcome if at == self.end else (f"{at * trace.rules.dt:.2f} s", LIGHT.text)
        has_room = self.has_key and (not self.title or self.side >= WIDE)
        title = "   ".join(filter(None, [self.title, self.key if has_room else ""]))
        bands, bounds, inch = draw_bands(plane, self.side, note, title)
        shapes = [*self.paths.get(state, PlannedPaths()).shapes(), *draw_moment(moment)]
        if step is None:
            shapes += mark_times(trace, row, plane, inch)
        return [*shapes, *bands], bounds, inch


def stored_episodes(runs: Sequence[RunResult], case: int, load: Loader, zoom: float | None = None) -> list[Episode]:
    """Return one case of stored runs for pictures side by side, with the planners' paths where it was recorded.

    Args:
        runs: The stored runs.
        case: The number of the case.
        load: Loads the scenario of a simulated run.
        zoom: See `Episode`.

    Raises:
        InputError: The case cannot be simulated again, or its starting states differ between the runs.
    """
    alone = len(runs) == 1
    side = SIDE if alone else WHOLE / count_columns(len(runs))
    episodes = []
    for run in runs:
        trace, row = stored_case(run, load, case)
        recorded = read_recorded(run.directory / RECORDING, case)
        paths = {} if recorded is None else recorded.paths(trace.rules.dt)
        episodes.append(Episode(trace, row, zoom, paths, "" if alone else run.label, side))
    starts = [(each.trace.split, each.trace.rules.dt, each.trace.position[each.row, 0]) for each in episodes]
    for run, (split, dt, position) in zip(runs, starts, strict=True):
        same_start = np.array_equal(position, starts[0][2], equal_nan=True)
        if not same_start or (split, dt) != starts[0][:2]:
            both = f"{run.directory} and {runs[0].directory}"
            raise InputError(f"case {case} starts differently in {both}: give runs of one scenario")
    return episodes


def draw_episodes(episodes: Sequence[Episode], out: Path, moments: int | None = None) -> None:
    """Draw an episode, or several side by side, as a film or a figure.

    Args:
        episodes: The episodes.
        out: A file of `FILMS`, or a figure.
        moments: Number of moments of one episode that a figure shows side by side; None for the whole episode.

    Raises:
        InputError: The file cannot be written.
    """
    check_file(out, [*SUFFIXES, *FILMS])
    if out.suffix in FILMS:
        film(episodes, out)
    elif moments is not None:
        draw_strip(episodes[0], moments, out)
    else:
        draw_pictures([episode.picture() for episode in episodes], count_columns(len(episodes)), out)


def count_columns(number: int) -> int:
    """Return the number of pictures side by side: up to three in one row, more in two rows."""
    return number if number < 4 else math.ceil(number / 2)


def draw_pictures(pictures: Sequence[Picture], columns: int, out: Path) -> None:
    """Draw pictures of `Episode.picture` in rows, as one figure.

    Args:
        columns: Number of pictures side by side.
        out: The figure's file.

    Raises:
        InputError: The file cannot be written.
    """
    rows = math.ceil(len(pictures) / columns)
    width, height = np.max([(high - low) / inch for _, (low, high), inch in pictures], axis=0).tolist()
    with canvas(out, width * columns, height * rows) as figure:
        for number, (shapes, bounds, _) in enumerate(pictures, 1):
            draw_panel(figure, (rows, columns, number), bounds, shapes)


def draw_start(scenario: Scenario, split: str, number: int, out: Path) -> None:
    """Draw a case at its start: the positions and the routes of all agents.

    Args:
        out: The figure's file.

    Raises:
        InputError: The case cannot be started, or the file cannot be written.
    """
    world = scenario.draw(split, np.array([number]))
    present = np.flatnonzero(world.present[0])
    routes = [_route(world, agent) for agent in present[:CROWD]]
    plane = extent(np.concatenate(routes), world.goal[0, :1], world.obstacles[0], 0.7)
    colors = [LIGHT.vehicle if agent == 0 else LIGHT.walked for agent in present]
    lines = [Line(route, color, 0.8) for route, color in zip(routes, colors, strict=False)]
    goals = [Disc(route[-1], 0.12, LIGHT.background, LIGHT.walked, 0.8) for route in routes[1:]]
    bands, bounds, inch = draw_bands(plane, SIDE)
    shapes = [*lines, *goals, *draw_moment(Moment.of_worlds([world])), *bands]
    draw_pictures([(shapes, bounds, inch)], 1, out)


def _route(world: World, agent: int) -> Float[np.ndarray, "point 2"]:
    """Return the route of an agent: from its start over the waypoints to its goal."""
    waypoints = world.route[0, agent]
    waypoints = waypoints[np.isfinite(waypoints[:, 0])]
    return np.concatenate([world.position[0, agent, None], waypoints, world.goal[0, agent, None]])


def draw_strip(episode: Episode, moments: int, out: Path) -> None:
    """Draw moments of an episode side by side, equally far apart in time, the last one at its end.

    Args:
        out: The figure's file.

    Raises:
        InputError: The file cannot be written.
    """
    states = np.linspace(0, episode.end, moments + 1).round().astype(int)[1:]
    width, height = np.ptp(episode.bounds(np.zeros(2)), axis=0).tolist()
    strip = dataclasses.replace(episode, side=WHOLE / moments * max(1.0, height / width))
    # The other panels have an empty band above, so that the key of the first one has room.
    others = dataclasses.replace(strip, has_key=False, title=" " if strip.key else "")
    panels = [strip, *[others] * (moments - 1)]
    pictures = [panel.picture(float(state)) for panel, state in zip(panels, states.tolist(), strict=True)]
    draw_pictures(pictures, moments, out)


def film(episodes: Sequence[Episode], out: Path, speed: float = 1.0) -> None:
    """Make a film of an episode, or of several side by side. Shorter episodes stop at their end.

    Args:
        episodes: The episodes, whose steps are equally long.
        out: A .gif, .webp or .mp4 file; for the latter the program ffmpeg is needed.
        speed: Seconds of the episode per second of the film.

    Raises:
        InputError: The file cannot be written, or ffmpeg is missing.
    """
    from PIL import Image as Images

    check_file(out, [*FILMS])
    if out.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(f"a film {out.name} needs the program ffmpeg (Debian: ffmpeg); a .gif file does not")
    with files.write_whole(out) as partial:
        dpi = FILMS[out.suffix]
        frames = _frames(episodes, dpi, speed)
        last = _frame(episodes, max(episode.end for episode in episodes), dpi)
        if out.suffix != ".mp4":
            # Pillow stores all pictures in memory: with the palette of the last one, a pixel needs one byte.
            palette = last.quantize()
            # Keep the background white: its mean with the smooth edges of shapes would be grey.
            palette.putpalette([255 if channel > 249 else channel for channel in palette.getpalette() or ()])
            few = (frame.quantize(palette=palette, dither=Images.Dither.NONE) for frame in frames)
            options: dict[str, Any] = {"save_all": True, "append_images": few, "duration": 1000 // RATE, "loop": 0}
            next(few).save(partial, format=out.suffix[1:], lossless=True, method=2, **options)  # lossless, method: webp
            return
        size = "x".join(map(str, last.size))
        command = f"ffmpeg -loglevel error -y -f rawvideo -pixel_format rgb24 -video_size {size} -framerate {RATE} -i -"
        # Players assume BT.709, and need even sizes.
        command += " -vf pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white,scale=out_color_matrix=bt709 -colorspace bt709"
        command += " -pix_fmt yuv420p -movflags +faststart -f mp4"
        with subprocess.Popen([*command.split(), str(partial)], stdin=PIPE, stderr=PIPE) as process:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):
                for frame in frames:
                    process.stdin.write(frame.tobytes())
            _, said = process.communicate()
        if process.returncode:
            raise InputError(f"ffmpeg could not make {out}: {said.decode(errors='replace').strip()[-200:]}")


def _frames(episodes: Sequence[Episode], dpi: int, speed: float) -> Iterator[Image]:
    """Yield the pictures of a film, the last one for a while, so that the outcome can be read."""
    longest = max(episode.end for episode in episodes)
    steps = np.arange(0.0, longest, speed / (RATE * episodes[0].trace.rules.dt))
    for step in [*steps.tolist(), *[longest] * HOLD]:
        yield _frame(episodes, step, dpi)


def _add_verdict(episode: Episode, step: float, lines: int) -> Picture:
    """Return a picture of a time with room for some lines below, where the verdict on a failure follows at its end."""
    shapes, (low, high), inch = episode.picture(step)
    line = np.array([0.0, LINE * inch])
    if step >= episode.end:
        start = low + np.array([0.06 * inch, 0.0])
        shapes += [Text(start - (k + 0.5) * line, text, LIGHT.contact, "l") for k, text in enumerate(episode.verdict)]
    return shapes, np.stack([low - lines * line, high]), inch


def _frame(episodes: Sequence[Episode], step: float, dpi: int) -> Image:
    """Return a picture of a film, at a time in steps: a panel for each episode."""
    from PIL import Image as Images

    lines = max(len(episode.verdict) for episode in episodes)
    panels = [rasterize(*_add_verdict(episode, step, lines), dpi) for episode in episodes]
    columns = count_columns(len(episodes))
    width, height = (np.max([panel.size for panel in panels], axis=0) + dpi // 18).tolist()  # apart from each other
    frame = Images.new("RGB", (width * columns, height * math.ceil(len(panels) / columns)), LIGHT.background)
    for number, panel in enumerate(panels):
        frame.paste(panel, (number % columns * width, number // columns * height))
    return frame
