"""Draws a world from above as an array, and shapes as an image."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from jaxtyping import Float, UInt8

from crowdbench.core.types import World
from crowdbench.drawing import (
    CROWD,
    FONT_SIZE,
    LIGHT,
    MEASURED,
    Disc,
    Line,
    Moment,
    Polygon,
    Shape,
    Text,
    draw_bands,
    draw_moment,
    extent,
)
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image

RENDER_MODES = ["human", "rgb_array"]

SIZE = 600
"""Width and height of the picture in pixels."""

POINT = 2.4
"""Pixels per point, the unit of line widths and text sizes."""

MARGIN = 1.0
"""Margin in metres around all starts, goals and obstacles."""

SMOOTHING = 2
"""The picture is drawn this many times larger and scaled down, so that its edges are smooth."""


class Renderer:
    """Renderer of one world in a mode; without a mode it does nothing.

    Args:
        mode: `human`, `rgb_array` or None.

    Raises:
        InputError: There is no such mode.
    """

    def __init__(self, mode: str | None) -> None:
        if mode is not None and mode not in RENDER_MODES:
            raise InputError(f"render_mode is {mode!r}, but must be one of {', '.join(RENDER_MODES)}, or None")
        self.mode = mode
        self._bounds = np.zeros((2, 2))
        self._states: list[World] = []

    def remember(self, world: World) -> None:
        """Keep the states of an episode; the first one sets the scale. Without a mode, keep none."""
        if self.mode is None:
            return
        if int(world.step[0]) == 0:
            self._states.clear()
            agents = np.stack([world.position[0], world.goal[0]])[:, world.present[0]]
            low, high = extent(agents, np.zeros((1, 2)), world.obstacles[0], MARGIN)
            middle, half = (low + high) / 2.0, (high - low).max() / 2.0
            self._bounds = np.stack([middle - half, middle + half])
        if not self._states or int(world.step[0]) > int(self._states[-1].step[0]):
            self._states.append(world)

    def picture(self, case: str) -> UInt8[np.ndarray, "height width 3"] | None:
        """Return the picture of the last state; None without a mode.

        Args:
            case: The name of the case, shown as text.
        """
        if self.mode is None:
            gymnasium.logger.warn("render() shows nothing, because the environment was made without a render_mode")
            return None
        world = self._states[-1]
        agents = np.flatnonzero(world.present[0])
        pedestrians = agents[agents >= world.rules.vehicles].tolist() if len(agents) <= CROWD else []
        goals = [Disc(world.goal[0, agent], float(world.radius[0, agent]), None, LIGHT.walked) for agent in pedestrians]
        moment = Moment.of_worlds(self._states)
        note = f"{float(world.step[0]) * world.rules.dt:.2f} s", LIGHT.text
        title = f"{case}   {MEASURED}" if world.sight else case
        bands, bounds, inch = draw_bands(self._bounds, SIZE / POINT / 72.0, note, title)
        numbers = [_number(moment, agent, inch) for agent in pedestrians]
        shapes = [*goals, *draw_moment(moment), *numbers, *bands]
        return np.asarray(rasterize(shapes, bounds, inch, 72.0 * POINT))


def _number(moment: Moment, agent: int, inch: float) -> Text:
    """Return the number of a pedestrian: on its disc, or beside a disc that is small or an outline."""
    here, radius = moment.position[-1, agent], float(moment.radius[agent])
    if moment.seen[agent - 1] and radius > 0.75 * FONT_SIZE / 72.0 * inch:
        return Text(here, str(agent - moment.rules.vehicles), LIGHT.background)
    return Text(here + radius + 0.04 * inch, str(agent - moment.rules.vehicles), LIGHT.text, halo=LIGHT.background)


def rasterize(shapes: Iterable[Shape], bounds: Float[np.ndarray, "2 2"], inch: float, dpi: float) -> Image:
    """Return an image with shapes, each drawn over the previous ones.

    Args:
        shapes: The shapes, in metres.
        bounds: The smallest and the largest x and y in metres that it shows.
        inch: Metres per inch.
        dpi: Pixels per inch.
    """
    from PIL import Image, ImageDraw

    scale, point = SMOOTHING * dpi / inch, SMOOTHING * dpi / 72.0
    width, height = (SMOOTHING * np.round((bounds[1] - bounds[0]) * dpi / inch).astype(int)).tolist()
    image = Image.new("RGB", (width, height), LIGHT.background)
    pen = ImageDraw.Draw(image)

    def pixels(points: Float[np.ndarray, "*_ 2"]) -> Any:
        return ((points - bounds[0]) * [scale, -scale] + [0.0, height]).ravel().tolist()

    def thickness(points: float) -> int:
        return max(1, round(points * point))

    for shape in shapes:
        match shape:
            case Line(points, color, wide):
                pen.line(pixels(points), color, thickness(wide), joint="curve")
            case Disc(centre, radius, face, edge, wide):
                rim = thickness(wide) if edge else 0
                pen.circle(pixels(centre), radius * scale, face, edge, rim)
            case Polygon(corners, face, edge, wide):
                if face is not None:
                    pen.polygon(pixels(corners), face)
                if wide:
                    pen.line(pixels(np.concatenate([corners, corners[:2]])), edge, thickness(wide), joint="curve")
            case Text(at, text, color, anchor, halo, size):
                around = thickness(1.0) if halo else 0
                font, place = _font(size * point), tuple(pixels(at))
                pen.text(place, text, color, font, anchor + "m", stroke_width=around, stroke_fill=halo)
    return image.reduce(SMOOTHING)


@functools.lru_cache
def _font(pixels: float) -> Any:
    """Return the font of Matplotlib's figures, which contains symbols such as a check mark, in a size in pixels."""
    import matplotlib
    from PIL import ImageFont

    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", pixels)
