"""Make a film of a recorded window beside rollouts of pedestrian policies, in an order that the film does not say."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from jaxtyping import Float

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import announce_compilation, help_from_docstring, main, say
from crowdbench.figures import COLOURS
from crowdbench.utils import write_whole

if TYPE_CHECKING:
    from PIL import Image

    from studies.people.windows import Window

    Picture = Image.Image

Paths = Float[np.ndarray, "time person 2"]

RECORDING = "the recording"
LETTERS = "ABCDEFGH"
COLUMNS = 2

WIDTH, GAP, CORNER, MARGIN = 480, 12, 10, 0.5
"""Width of a panel, gap between panels, and radius of their corners in pixels; margin around all paths in metres."""

RATE, PAUSE, TRAIL, QUALITY = 15, 1.5, 1.6, 60
"""Frames per second, duration of the last one in seconds, length of the line behind a person in seconds, and quality of
WebP, of 100."""

FINE = 3
"""Factor by which pictures are drawn larger, for smooth edges."""

CARD, GROUND, INK = (250, 250, 247, 255), (0, 0, 0, 0), (60, 60, 60, 255)
"""Colours of panels, of the transparent space between them, and of letters."""

RADIUS, SCALE = 0.2, 2.0
"""Radius of a drawn person, as simulated, and length of the scale, in metres."""


@help_from_docstring
def film(
    data: Annotated[Path, typer.Option()],
    out: Annotated[Path, typer.Option()],
    policy: list[str] | None = None,
    recording: str = "crowds_zara03",
    window: int = 10,
) -> None:
    """Make a film of a recorded window and of rollouts of policies, and print what its panels show.

    Args:
        data: The folder with the tracks of ETH/UCY.
        out: The film, a .webp file.
        policy: A name, ./mine.py or ./mine.py:function; orca, orca_people and learned_people if not given. Repeat it
            for several.
        recording: The name of a recording, such as crowds_zara03.
        window: The number of a window in this recording.
    """
    from studies.people.simulate import simulate

    announce_compilation()
    chosen = find_window(data, recording, window)
    shown = {RECORDING: chosen.future}
    for name in policy or ("orca", "orca_people", "learned_people"):
        shown[name] = simulate(name, [chosen], rollouts=1)[0][0]
    order = shuffled(list(shown))
    pictures = list(draw([shown[name] for name in order]))
    duration = [1000 // RATE] * (len(pictures) - 1) + [round(1000 * PAUSE)]
    with write_whole(out) as partial:
        options = {"duration": duration, "loop": 0, "quality": QUALITY, "alpha_quality": QUALITY, "method": 4}
        pictures[0].save(partial, format="webp", save_all=True, append_images=pictures[1:], **options)
    for letter, name in zip(LETTERS, order, strict=False):
        say(f"{letter}: {name}")


def find_window(data: Path, recording: str, number: int) -> Window:
    """Return a window by its recording and its number. Raises InputError if there is no such window."""
    from studies.people.windows import LOCATIONS, read_windows

    for location, recordings in LOCATIONS.items():
        if recording in recordings:
            windows = read_windows(data, [location])[location]
            for window in windows:
                if (window.name, window.number) == (recording, number):
                    return window
            raise InputError(f"--window is {number}, but {recording} has no such window with a scored person")
    names = ", ".join(name for names in LOCATIONS.values() for name in names)
    raise InputError(f"--recording is {recording!r}, but must be one of {names}")


def shuffled(names: Sequence[str]) -> list[str]:
    """Return names in the order of the panels, always the same one."""
    return [names[i] for i in np.random.default_rng(len(names)).permutation(len(names))]


def draw(paths: Sequence[Paths]) -> Iterator[Picture]:
    """Yield the pictures of the film, with a panel for each of some paths."""
    from PIL import Image

    low, high = bounds(paths)
    scale = WIDTH / (high - low)[0]
    height = round((high - low)[1] * scale)
    rows = -(-len(paths) // COLUMNS)
    size = COLUMNS * (WIDTH + GAP) - GAP, rows * (height + GAP) - GAP
    smooth = [smoothed(path) for path in paths]
    for frame in range(len(smooth[0])):
        picture = Image.new("RGBA", (FINE * size[0], FINE * size[1]), GROUND)
        for number, path in enumerate(smooth):
            panel = Image.new("RGBA", (FINE * WIDTH, FINE * height), CARD)
            _draw_people(panel, path[: frame + 1], low, FINE * scale)
            _draw_signs(panel, LETTERS[number], FINE * scale)
            row, column = divmod(number, COLUMNS)
            picture.paste(panel, (FINE * column * (WIDTH + GAP), FINE * row * (height + GAP)), _corners(panel.size))
        yield picture.resize(size, Image.Resampling.LANCZOS)


def _draw_signs(panel: Picture, letter: str, scale: float) -> None:
    """Draw a letter and, in the first panel, the scale."""
    from PIL import ImageDraw, ImageFont

    pen = ImageDraw.Draw(panel)
    pen.text((FINE * 8, FINE * 5), letter, INK, ImageFont.load_default(size=FINE * 16))
    if letter == LETTERS[0]:
        left, low = FINE * 10, panel.height - FINE * 10
        pen.line((left, low, left + SCALE * scale, low), INK, FINE)
        pen.text((left, low - FINE * 15), f"{SCALE:g} m", INK, ImageFont.load_default(size=FINE * 11))


def _corners(size: tuple[int, int]) -> Picture:
    """Return the mask of a panel with round corners."""
    from PIL import Image, ImageDraw

    mask = Image.new("L", size, 0)
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, size[0] - 1, size[1] - 1), CORNER * FINE, 255)
    return mask


def bounds(paths: Sequence[Paths]) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of a rectangle in metres around all positions."""
    points = np.concatenate([path.reshape(-1, 2) for path in paths])
    return np.nanmin(points, axis=0) - MARGIN, np.nanmax(points, axis=0) + MARGIN


def smoothed(path: Paths) -> Paths:
    """Return positions in each frame of the film, on cubic curves through the positions in frames of the recording."""
    from scipy.interpolate import CubicSpline

    from crowdbench.scenario import ETH_UCY_DT

    times = ETH_UCY_DT * np.arange(len(path))
    at = np.arange(0.0, times[-1] + 1e-9, 1.0 / RATE)
    fine = np.full((len(at), *path.shape[1:]), np.nan)
    for person in range(path.shape[1]):
        here = np.isfinite(path[:, person, 0])
        if here.sum() > 1:
            curve = CubicSpline(times[here], path[here, person], extrapolate=False)
            fine[:, person] = curve(at)
    return fine


def _draw_people(panel: Picture, path: Paths, low: np.ndarray, scale: float) -> None:
    """Draw persons at the end of their paths, with a line behind each of them that fades."""
    from PIL import ImageDraw

    pen = ImageDraw.Draw(panel)
    pixels = (path - low) * scale
    pixels[..., 1] = panel.height - pixels[..., 1]
    trail = pixels[-round(TRAIL * RATE) :]
    for person in range(path.shape[1]):
        if not np.isfinite(pixels[-1, person, 0]):
            continue
        colour = np.array(_rgb(person))
        line = trail[np.isfinite(trail[:, person, 0]), person]
        for number, (begin, end) in enumerate(itertools.pairwise(line)):
            share = 0.6 * (number + 1) / len(line)
            faded = np.round(share * colour + (1.0 - share) * np.array(CARD[:3])).astype(int)
            pen.line((*begin, *end), (*faded.tolist(), 255), round(0.12 * scale))
    for person, at in enumerate(pixels[-1]):
        if np.isfinite(at[0]):
            pen.circle(tuple(at), RADIUS * scale, (*_rgb(person), 255), CARD, FINE)


def _rgb(person: int) -> tuple[int, ...]:
    """Return the colour of a person, which is the same one in all panels."""
    return tuple(bytes.fromhex(COLOURS[person % (len(COLOURS) - 2)][1:]))


if __name__ == "__main__":
    main(film)
