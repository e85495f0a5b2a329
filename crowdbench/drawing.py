"""The one drawing of an episode seen from above: who is where, as shapes in metres that any library can draw.

`figures.episode` draws the shapes with Matplotlib, for figures, films and the pages of boards; `envs.render` draws them
with pygame. A recording holds all states at once: `record.drawing` has the same ways, bodies, colours and extent.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.arrays import Polygons
from crowdbench.core.dynamics import Holonomic, nose, outline
from crowdbench.core.geometry import Discs, nearest_in_step, polygons, turn
from crowdbench.core.types import Outcome, Rules, Trace, World
from crowdbench.sim.episode import fill_motion, gaps_on_arc

CROWD = 100
"""The ways of more agents than this would cover the picture: then they are left out."""

_ANGLES = np.arange(10) * np.pi / 5.0 + np.pi / 2.0
_STAR = np.resize([0.2, 0.08], 10)[:, None] * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)

Points = Float[np.ndarray, "*_ 2"]
Color = tuple[int, int, int]


class Palette(NamedTuple):
    """The colours of an episode. Vehicle, pedestrians and failures can be told apart by colour-blind readers too."""

    vehicle: Color = (222, 122, 0)
    pedestrian: Color = (38, 104, 178)
    walked: Color = (146, 179, 216)
    hidden: Color = (160, 188, 218)
    failure: Color = (214, 39, 40)
    faint: Color = (228, 228, 222)
    wall: Color = (154, 154, 148)
    text: Color = (70, 70, 70)
    background: Color = (255, 255, 255)


LIGHT = Palette()
"""On paper and in windows."""

FORESEEN: Color = (150, 150, 165)
CONSIDERED: Color = (245, 185, 100)
"""On paper: ways that a planner predicts, and those that it considers."""

DARK = Palette(
    vehicle=(255, 194, 10),
    pedestrian=(94, 169, 255),
    walked=(43, 84, 136),
    hidden=(32, 54, 86),
    failure=(255, 77, 84),
    faint=(72, 78, 90),
    wall=(150, 156, 168),
    text=(255, 255, 255),
    background=(17, 19, 24),
)
"""In recordings, which also have the colours below."""

SUCCESS: Color = (70, 210, 140)
REMEMBERED: Color = (140, 107, 10)
MUTED: Color = (140, 146, 158)
GRID: Color = (33, 36, 43)
ATTENTION: Color = (204, 121, 167)

SCALE: tuple[Color, ...] = ((62, 44, 112), (38, 118, 142), (160, 228, 130))
"""From small to large values, dark to light."""

CURVES: tuple[Color, ...] = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0))
"""Colours of a planner's own curves, which colour-blind readers can tell apart (Okabe and Ito 2008)."""


class Line(NamedTuple):
    """A line through points in metres. Its width is in points, of which an inch has 72."""

    points: Float[np.ndarray, "point 2"]
    color: Color
    width: float


class Disc(NamedTuple):
    """A disc in metres. It is filled, or has a rim whose width is in points, or both."""

    centre: Float[np.ndarray, "2"]
    radius: float
    face: Color | None
    edge: Color | None = None
    width: float = 0.6


class Polygon(NamedTuple):
    """A polygon, with its corners in metres. Two corners are a line."""

    corners: Float[np.ndarray, "corner 2"]
    face: Color
    edge: Color
    width: float


class Text(NamedTuple):
    """A text whose centre, or whose left end, is at a point in metres. Its size is in points."""

    at: Float[np.ndarray, "2"]
    text: str
    color: Color
    size: float = 6.0
    is_left: bool = False


Shape = Line | Disc | Polygon | Text


@dataclass(frozen=True)
class Moment:
    """One moment of an episode, the last of some states.

    Attributes:
        step: Numbers of the states.
        position: Where the agents were in each state, in metres, NaN where one was not there.
        velocity: In m/s, in the step before each state.
        heading: The vehicle's, in radians.
        person: Number of each pedestrian as a person.
        goal: In metres, now, as is all that follows.
        radius: In metres.
        seen: True if the vehicle sees the pedestrian.
        obstacles: Polygons in metres, NaN after the last corner.
        rules: The rules of the scenario.
        hits_obstacle: True if the vehicle has hit one in the last step, which has ended the episode.
    """

    step: Int[np.ndarray, "time"]
    position: Float[np.ndarray, "time agent 2"]
    velocity: Float[np.ndarray, "time agent 2"]
    heading: Float[np.ndarray, "time"]
    person: Int[np.ndarray, "time pedestrian"]
    goal: Float[np.ndarray, "agent 2"]
    radius: Float[np.ndarray, "agent"]
    seen: Bool[np.ndarray, "pedestrian"]
    obstacles: Polygons
    rules: Rules
    hits_obstacle: bool = False

    @classmethod
    def of_trace(cls, trace: Trace, row: int, state: int) -> Moment:
        """Return a state of the episode in a row of a trace."""
        until, now = (row, slice(state + 1)), (row, state)
        motion = trace.position[until], trace.velocity[until], trace.heading[until], trace.person[until]
        here = trace.goal[now], trace.radius[now], trace.seen[now]
        hits_obstacle = bool(state == trace.steps[row] and trace.outcome[row] == Outcome.WALL_COLLISION)
        return cls(np.arange(state + 1), *motion, *here, trace.obstacles[row], trace.rules, hits_obstacle)

    @classmethod
    def of_worlds(cls, worlds: Sequence[World]) -> Moment:
        """Return the last of several worlds, which are states of one episode, each a batch of one."""
        now = worlds[-1]
        position = np.concatenate([np.where(world.present[..., None], world.position, np.nan) for world in worlds])
        names = ("step", "velocity", "heading", "person")
        step, velocity, heading, person = (np.concatenate([getattr(world, name) for world in worlds]) for name in names)
        seen = now.sight["unseen"][0] == 0 if now.sight else now.present[0, 1:]
        scene = now.goal[0], now.radius[0], seen, now.obstacles[0], now.rules
        return cls(step, position, velocity, heading, person, *scene)

    @functools.cached_property
    def hit(self) -> list[int]:
        """Return the agents that the vehicle has hit in the last step, by the rule of the collision check."""
        if len(self.step) < 2 or self.step[-1] - self.step[-2] != 1:
            return []
        (before, now), rules = self.position[-2:], self.rules
        fill_motion(before, now, self.velocity[-2], rules.numbers.collision, rules.dt, motion := np.empty(now.shape))
        turn_rate = turn(*self.heading[-2:]) / rules.dt
        arc = rules.numbers.body, self.heading[-2], float(np.hypot(*self.velocity[-1, 0])), turn_rate, rules.dt
        is_holonomic, hit = isinstance(rules.dynamics, Holonomic), []
        stays = np.isfinite((before + now)[:, 0]) & same_agents(self.person[-2:])[0]  # nobody has come in their place
        for agent in np.flatnonzero(stays).tolist()[1:]:
            pair = [0, agent]
            discs = Discs(before[pair], motion[pair], self.radius[pair], np.ones(2, bool))
            gap, _ = nearest_in_step(0, discs) if is_holonomic else gaps_on_arc(*arc, discs, np.empty((0, 0, 2)))
            if gap < 0.0:
                hit.append(agent)
        return hit


def extent(position: Points, goal: Points, obstacles: Polygons, margin: float) -> Float[np.ndarray, "2 2"]:
    """The smallest and the largest x and y that an episode needs, in metres.

    Args:
        position: Where agents are, NaN of those who are not there.
        goal: Goals that are shown.
        obstacles: As in a `World`.
        margin: The space around them, in metres.
    """
    points = np.concatenate([position.reshape(-1, 2), goal.reshape(-1, 2), *polygons(obstacles)])
    return np.stack([np.nanmin(points, axis=0) - margin, np.nanmax(points, axis=0) + margin])


def same_agents(person: Int[np.ndarray, "time pedestrian"]) -> Bool[np.ndarray, "step agent"]:
    """Return whether each agent is the same one after each step: somebody else can take the place of a pedestrian."""
    same = np.ones((len(person) - 1, 1 + person.shape[1]), bool)
    same[:, 1:] = np.diff(person, axis=0) == 0
    return same


def paths(position: Float[np.ndarray, "time 2"], same: Bool[np.ndarray, "step"]) -> list[Float[np.ndarray, "_ 2"]]:
    """The paths in metres of all who had the place of one agent, each in a line; `same` tells who stayed in a step."""
    parts = np.split(position, np.flatnonzero(~same) + 1)
    return [part[np.isfinite(part[:, 0])] for part in parts if np.isfinite(part[:, 0]).sum() > 1]


def draw_moment(moment: Moment, corner: Float[np.ndarray, "2"], palette: Palette = LIGHT) -> Iterator[Shape]:
    """Yield the shapes of a picture of a moment, from the ground up. An arrow is the way of the next second.

    Args:
        moment: The moment.
        corner: Lower left corner of the picture in metres.
        palette: Its colours.
    """
    for corners in polygons(moment.obstacles):
        yield Polygon(corners, palette.faint, palette.wall, 1.0)
    bar = corner + 0.3 + np.array([[0.0, 0.0], [1.0, 0.0]])
    yield Line(bar, palette.text, 1.0)
    yield Text(bar.mean(axis=0) + np.array([0.0, 0.25]), "1 m", palette.text)
    tolerance = moment.rules.goal_tolerance or float(moment.radius[0])
    yield Polygon(moment.goal[0] + _STAR, palette.vehicle, palette.vehicle, 0.3)
    yield Disc(moment.goal[0], tolerance, None, palette.vehicle)
    colors = [palette.vehicle, *(palette.pedestrian if seen else palette.hidden for seen in moment.seen.tolist())]
    trails = [palette.vehicle] + [palette.walked] * len(moment.seen)
    for agent in [*moment.hit, *[0] * moment.hits_obstacle]:
        colors[agent] = trails[agent] = palette.failure
    same = same_agents(moment.person)
    # The vehicle is drawn last, so that nothing hides it.
    for agent in reversed(range(len(colors))) if len(colors) <= CROWD else ():
        for path in paths(moment.position[:, agent], same[:, agent]):
            yield Line(path, trails[agent], 1.6 if agent == 0 else 0.8)
    arrows: list[Shape] = []
    for agent in np.flatnonzero(np.isfinite(moment.position[-1, :, 0]))[::-1].tolist():
        here = moment.position[-1, agent]
        yield Disc(here, float(moment.radius[agent]), colors[agent], palette.background)
        arrows += _arrow(here, moment.velocity[-1, agent], palette.text)
    if not isinstance(moment.rules.dynamics, Holonomic):
        body = moment.rules.body, moment.position[-1, 0], moment.heading[-1, ...], float(moment.radius[0])
        yield Polygon(outline(*body), palette.vehicle, palette.text, 1.0)
        yield Line(nose(*body), palette.text, 1.0)
    yield from arrows


def _arrow(start: Float[np.ndarray, "2"], vector: Float[np.ndarray, "2"], color: Color) -> list[Shape]:
    """An arrow from a point in metres; nothing where it has no length."""
    length = float(np.hypot(*vector))
    if length < 1e-3:
        return []
    tip, along = start + vector, vector / length * 0.15
    across = np.array([-along[1], along[0]]) * 0.6
    head = np.stack([tip, tip - along + across, tip - along - across])
    return [Line(np.stack([start, tip - along]), color, 0.8), Polygon(head, color, color, 0.3)]
