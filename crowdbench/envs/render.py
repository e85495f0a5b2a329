"""Draws a world from above, as an array or in a window."""

from __future__ import annotations

import importlib
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float, UInt8

from crowdbench.dynamics import Holonomic, nose, outline
from crowdbench.errors import InputError
from crowdbench.geometry import polygons
from crowdbench.types import World

RENDER_MODES = ["human", "rgb_array"]

SIZE = 600
"""Width and height of the picture in pixels."""

MARGIN = 1.0
"""Margin in metres around all starts, goals and obstacles."""

SMOOTHING = 2
"""The picture is drawn this many times larger and scaled down, so that its edges are smooth."""

BACKGROUND = (250, 250, 247)
GRID = (228, 228, 222)
TEXT = (70, 70, 70)
WALL = (196, 196, 190)
VEHICLE = (222, 122, 0)
PEDESTRIAN = (38, 104, 178)
HIDDEN = (160, 188, 218)
CONTACT = (208, 32, 32)
NUMBER = (255, 255, 255)

CROWD = 100
"""The trails and numbers of more agents than this would cover the picture: then they are left out."""


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
        self._half_width = 0.0
        self._middle = np.zeros(2)
        self._shown: list[World] = []

    def show(self, world: World, case: str) -> None:
        """In mode `human`, draw the world in a window and wait for the time of a step.

        Args:
            world: One world. The first state of an episode sets the scale of the picture.
            case: The name of the case, shown as text.
        """
        if int(world.step[0]) == 0:
            agents = np.stack([world.position[0], world.goal[0]])[:, world.present[0]].reshape(-1, 2)
            # The origin is the middle of the crossings, whatever the starts of a case.
            walls = np.concatenate([np.zeros((1, 2)), *polygons(world.obstacles[0])])
            self._middle = (walls.min(axis=0) + walls.max(axis=0)) / 2
            self._half_width = float(np.abs(np.concatenate([agents, walls]) - self._middle).max()) + MARGIN
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
        self._window.blit(self._draw(world, case), (0, 0))
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
        if self.mode != "rgb_array":
            return None
        self._remember(world)
        pygame = importlib.import_module("pygame")
        return np.ascontiguousarray(pygame.surfarray.array3d(self._draw(world, case)).swapaxes(0, 1))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            importlib.import_module("pygame").display.quit()
            self._window = None

    def _remember(self, world: World) -> None:
        """Keep the states of an episode that were shown, for trails and for what happened in a step."""
        if int(world.step[0]) == 0:
            self._shown.clear()
        if not self._shown or int(world.step[0]) > int(self._shown[-1].step[0]):
            self._shown.append(world)

    def _trail(self, agent: int) -> Float[np.ndarray, "time 2"]:
        """Where the one who has the place of an agent now has been, in metres."""
        last = self._shown[-1]
        here = [one for one in self._shown if one.present[0, agent]]
        if agent:
            here = [one for one in here if one.person[0, agent - 1] == last.person[0, agent - 1]]
        return np.array([one.position[0, agent] for one in here])

    def _touched(self) -> set[int]:
        """The pedestrians whom the vehicle has hit in the last step, as agents."""
        if len(self._shown) < 2 or int(self._shown[-2].step[0]) + 1 != int(self._shown[-1].step[0]):
            return set()
        before, after = self._shown[-2:]
        both = np.flatnonzero(before.present[0] & after.present[0])[1:]
        found: set[int] = set()
        for offset in before.rules.body:
            parts = [one.position[0, 0] + offset * _direction(float(one.heading[0])) for one in (before, after)]
            start = before.position[0, both] - parts[0]
            motion = after.position[0, both] - parts[1] - start
            squared = np.maximum((motion**2).sum(axis=1), 1e-12)
            when = np.clip(-(start * motion).sum(axis=1) / squared, 0.0, 1.0)
            apart = np.linalg.norm(start + when[:, None] * motion, axis=1)
            found |= set(both[apart < before.radius[0, both] + before.radius[0, 0]].tolist())
        return found

    def _draw(self, world: World, case: str) -> Any:
        pygame = importlib.import_module("pygame")
        large = pygame.Surface((SIZE * SMOOTHING, SIZE * SMOOTHING))
        large.fill(BACKGROUND)
        canvas = _Canvas(pygame, large, self._half_width, self._middle)
        canvas.grid()
        for corners in polygons(world.obstacles[0]):
            canvas.obstacle(corners)
        agents = np.flatnonzero(world.present[0]).tolist()
        seen = world.sight["unseen"][0] == 0 if world.sight else world.present[0, 1:]
        colors = [VEHICLE, *(PEDESTRIAN if seen[agent - 1] else HIDDEN for agent in agents[1:])]
        for agent, color in zip(agents, colors, strict=True):
            near = world.rules.goal_tolerance if agent == 0 else None
            canvas.goal(world.goal[0, agent], near or float(world.radius[0, agent]), color)
        is_clear = len(agents) <= CROWD
        for agent, color in zip(agents, colors, strict=True) if is_clear else ():
            canvas.trail(self._trail(agent), color)
        # The vehicle is drawn last, so that nothing hides it.
        for agent, color in reversed(list(zip(agents, colors, strict=True))):
            canvas.agent(world.position[0, agent], world.velocity[0, agent], float(world.radius[0, agent]), color)
        if not isinstance(world.rules.dynamics, Holonomic):
            place = world.rules.body, world.position[0, 0], world.heading[0, ...], float(world.radius[0, 0])
            canvas.body(outline(*place), nose(*place))
        if touched := self._touched():
            for agent in (0, *touched):
                canvas.rim(world.position[0, agent], float(world.radius[0, agent]))
        pygame.font.init()
        font = pygame.font.Font(None, 20 * SMOOTHING)
        for agent in agents[1:] if is_clear else ():
            canvas.number(world.position[0, agent], font.render(str(agent - 1), True, NUMBER))
        picture = pygame.transform.smoothscale(large, (SIZE, SIZE))
        seconds = float(world.step[0]) * world.rules.dt
        font = pygame.font.Font(None, 24)
        picture.blit(font.render(f"{case}   {seconds:.2f} s", True, TEXT), (12, 10))
        return picture


def _direction(heading: float) -> Float[np.ndarray, "2"]:
    return np.array([np.cos(heading), np.sin(heading)])


class _Canvas:
    """Draws in metres, with y upwards.

    Args:
        pygame: The module.
        surface: The surface to draw on.
        half_width: Half the width of what is shown, in metres.
        middle: What is in the middle, in metres.
    """

    def __init__(self, pygame: Any, surface: Any, half_width: float, middle: Float[np.ndarray, "2"]) -> None:
        self.draw = pygame.draw
        self.surface = surface
        self.half_width = half_width
        self.middle = middle
        self.scale = surface.get_width() / (2 * half_width)

    def pixel(self, point: Float[np.ndarray, "2"]) -> tuple[float, float]:
        x, y = point - self.middle
        return (x + self.half_width) * self.scale, (self.half_width - y) * self.scale

    def grid(self) -> None:
        last = int(self.half_width + np.abs(self.middle).max())
        for metre in range(-last, last + 1):
            for one, other in (((metre, -99.0), (metre, 99.0)), ((-99.0, metre), (99.0, metre))):
                self.draw.line(self.surface, GRID, self.pixel(np.array(one)), self.pixel(np.array(other)), SMOOTHING)

    def obstacle(self, corners: Float[np.ndarray, "corner 2"]) -> None:
        """Draw an obstacle, filled if it has more than two corners; these are in metres."""
        pixels = [self.pixel(corner) for corner in corners]
        if len(pixels) > 2:
            self.draw.polygon(self.surface, WALL, pixels)
        self.draw.lines(self.surface, TEXT, True, pixels, 2 * SMOOTHING)

    def body(self, rim: Float[np.ndarray, "point 2"], nose: Float[np.ndarray, "2 2"]) -> None:
        """Draw the rim of the vehicle, and a line that shows where it faces; points are in metres."""
        self.draw.polygon(self.surface, VEHICLE, [self.pixel(point) for point in rim])
        for line in (rim, nose):
            self.draw.lines(self.surface, TEXT, False, [self.pixel(point) for point in line], 2 * SMOOTHING)

    def goal(self, at: Float[np.ndarray, "2"], radius: float, color: tuple[int, int, int]) -> None:
        """Draw a ring: an agent whose centre is inside it has arrived.

        Args:
            at: Its centre in metres.
            radius: Its radius in metres.
            color: Red, green and blue, 0 to 255.
        """
        self.draw.circle(self.surface, color, self.pixel(at), radius * self.scale, 2 * SMOOTHING)

    def trail(self, points: Float[np.ndarray, "time 2"], color: tuple[int, int, int]) -> None:
        """Draw a line through points in metres."""
        if len(points) > 1:
            self.draw.lines(self.surface, color, False, [self.pixel(point) for point in points], 2 * SMOOTHING)

    def rim(self, at: Float[np.ndarray, "2"], radius: float) -> None:
        """Draw a red rim around a disc with this centre and radius in metres."""
        self.draw.circle(self.surface, CONTACT, self.pixel(at), radius * self.scale, 4 * SMOOTHING)

    def number(self, at: Float[np.ndarray, "2"], text: Any) -> None:
        """Put a text, as pygame's fonts render it, on a point in metres."""
        self.surface.blit(text, text.get_rect(center=self.pixel(at)))

    def agent(
        self,
        at: Float[np.ndarray, "2"],
        velocity: Float[np.ndarray, "2"],
        radius: float,
        color: tuple[int, int, int],
    ) -> None:
        """Draw an agent as a disc, with an arrow for its velocity.

        Args:
            at: The disc's centre in metres.
            velocity: The velocity in m/s: the arrow is as long as the way of one second.
            radius: The disc's radius in metres.
            color: Red, green and blue, 0 to 255.
        """
        self.draw.circle(self.surface, color, self.pixel(at), radius * self.scale)
        speed = float(np.hypot(*velocity))
        if speed < 1e-3:
            return
        tip = at + velocity
        along = velocity / speed * 0.15
        across = np.array([-along[1], along[0]]) * 0.6
        self.draw.line(self.surface, TEXT, self.pixel(at), self.pixel(tip - along), 2 * SMOOTHING)
        self.draw.polygon(
            self.surface, TEXT, [self.pixel(corner) for corner in (tip, tip - along + across, tip - along - across)]
        )
