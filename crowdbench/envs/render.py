"""Draws a world from above, as an array or in a window."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float, UInt8

from crowdbench.core.types import World
from crowdbench.drawing import CROWD, LIGHT, Disc, Line, Moment, Polygon, Shape, Text, draw_moment, extent
from crowdbench.utils.errors import InputError

RENDER_MODES = ["human", "rgb_array"]

SIZE = 600
"""Width and height of the picture in pixels."""

MARGIN = 1.0
"""Margin in metres around all starts, goals and obstacles."""

SMOOTHING = 2
"""The picture is drawn this many times larger and scaled down, so that its edges are smooth."""

POINT = 2.4
"""Pixels per point, in which the widths of lines and the sizes of texts are given."""


class Renderer:
    """Draws one world in a render mode; without a mode it does nothing. It imports pygame when it first draws.

    Args:
        mode: `human`, `rgb_array` or None.

    Raises:
        InputError: There is no such mode.
    """

    def __init__(self, mode: str | None) -> None:
        if mode is not None and mode not in RENDER_MODES:
            raise InputError(f"render_mode is {mode!r}, but must be one of {', '.join(RENDER_MODES)}, or None")
        self.mode = mode
        self._window: Any = None
        self._clock: Any = None
        self._corner, self._width = np.zeros(2), 1.0
        self._states: list[World] = []

    def show(self, world: World, case: str) -> None:
        """In mode `human`, draw the world in a window and wait for the time of a step.

        Args:
            world: One world. The first state of an episode sets the scale of the picture.
            case: The name of the case, shown as text.
        """
        if self.mode is not None:
            self._remember(world)
        if self.mode != "human":
            return
        pygame = importlib.import_module("pygame")
        if self._window is None:
            pygame.display.init()
            self._window = pygame.display.set_mode((SIZE, SIZE))
            pygame.display.set_caption("crowdbench")
            self._clock = pygame.time.Clock()
        self._window.blit(self._draw(case), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(1 / world.rules.dt)

    def frame(self, world: World, case: str) -> UInt8[np.ndarray, "height width 3"] | None:
        """The picture of a world in mode `rgb_array`, None in other modes.

        Args:
            world: One world.
            case: The name of the case, shown as text.
        """
        if self.mode is None:
            gymnasium.logger.warn("render() shows nothing, because the environment was made without a render_mode")
        return self.picture(world, case) if self.mode == "rgb_array" else None

    def picture(self, world: World, case: str) -> UInt8[np.ndarray, "height width 3"]:
        """The picture of a world, see `frame`."""
        self._remember(world)
        pygame = importlib.import_module("pygame")
        return np.ascontiguousarray(pygame.surfarray.array3d(self._draw(case)).swapaxes(0, 1))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            importlib.import_module("pygame").display.quit()
            self._window = None

    def _remember(self, world: World) -> None:
        """Keep the states of an episode; the first one sets the scale."""
        if int(world.step[0]) == 0:
            self._states.clear()
            agents = np.stack([world.position[0], world.goal[0]])[:, world.present[0]]
            low, high = extent(agents, np.zeros((1, 2)), world.obstacles[0], MARGIN)
            self._width = float((high - low).max())
            self._corner = (low + high - self._width) / 2.0
        if not self._states or int(world.step[0]) > int(self._states[-1].step[0]):
            self._states.append(world)

    def _draw(self, case: str) -> Any:
        """The picture of the last state."""
        world = self._states[-1]
        agents = np.flatnonzero(world.present[0])
        pedestrians = agents[1:].tolist() if len(agents) <= CROWD else []
        goals = [Disc(world.goal[0, agent], float(world.radius[0, agent]), None, LIGHT.hidden) for agent in pedestrians]
        numbers = [Text(world.position[0, agent], str(agent - 1), LIGHT.background, 5.0) for agent in pedestrians]
        shapes = [*goals, *draw_moment(Moment.of_worlds(self._states), self._corner), *numbers]
        title = f"{case}   {float(world.step[0]) * world.rules.dt:.2f} s"
        at = self._corner + self._width * np.array([0.02, 0.97])
        shapes.append(Text(at, title, LIGHT.text, 7.0, is_left=True))
        return _draw_shapes(shapes, self._corner, self._width)


def _draw_shapes(shapes: Iterable[Shape], corner: Float[np.ndarray, "2"], width: float) -> Any:
    """A surface of pygame with shapes, each over those before it.

    Args:
        shapes: The shapes, in metres.
        corner: The lower left corner of the picture in metres.
        width: Its width and its height in metres.
    """
    pygame = importlib.import_module("pygame")
    pygame.font.init()
    large = pygame.Surface((SIZE * SMOOTHING, SIZE * SMOOTHING))
    large.fill(LIGHT.background)
    scale = SIZE * SMOOTHING / width

    def pixels(points: Float[np.ndarray, "*_ 2"]) -> Any:
        return ((points - corner) * [scale, -scale] + [0.0, SIZE * SMOOTHING]).tolist()

    def thickness(points: float) -> int:
        return max(1, round(points * POINT * SMOOTHING))

    for shape in shapes:
        match shape:
            case Line(points, color, wide):
                pygame.draw.lines(large, color, False, pixels(points), thickness(wide))
            case Disc(centre, radius, face, edge, wide):
                if face is not None:
                    pygame.draw.circle(large, face, pixels(centre), radius * scale)
                if edge is not None:
                    pygame.draw.circle(large, edge, pixels(centre), radius * scale, thickness(wide))
            case Polygon(corners, face, edge, wide):
                if len(corners) > 2:
                    pygame.draw.polygon(large, face, pixels(corners))
                pygame.draw.lines(large, edge, True, pixels(corners), thickness(wide))
            case Text(at, text, color, size, is_left):
                written = pygame.font.Font(None, thickness(1.5 * size)).render(text, True, color)
                side = "midleft" if is_left else "center"
                large.blit(written, written.get_rect(**{side: pixels(at)}))
    return pygame.transform.smoothscale(large, (SIZE, SIZE))
