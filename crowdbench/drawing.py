"""The top view of an episode: the palette, and shapes in metres that any library can draw.

`envs.render` draws the shapes as an image, for environments and films; `figures.style` draws them with Matplotlib, for
figures and the pages of boards. A recording holds all states at once: `record.entities` has the same paths, colours,
marks and extent.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from crowdbench.core.arrays import Polygons
from crowdbench.core.dynamics import Holonomic, nose, outline
from crowdbench.core.dynamics.kernels import signed_speed
from crowdbench.core.geometry import Discs, nearest_in_step, polygons, turn
from crowdbench.core.types import Detector, Outcome, Rules, Trace, World
from crowdbench.sim.episode import fill_motion, gaps_on_arc

CROWD = 100
"""Largest number of agents whose paths are drawn. More paths would cover the picture."""

Points = Float[np.ndarray, "*_ 2"]
Color = tuple[int, int, int]


class Palette(NamedTuple):
    """Colours by role.

    Marks have a contrast of 3:1 or more against the background, texts of 4.5:1. Under simulated deuteranopia, two
    roles differ by 15 or more in CIEDE2000. A pedestrian that the vehicle does not see is marked by a dashed outline,
    and a contact by the shape of `burst`, instead of a colour.
    """

    vehicle: Color
    pedestrian: Color
    contact: Color
    success: Color
    predicted: Color
    considered: Color
    attention: Color
    walked: Color
    wall: Color
    faint: Color
    text: Color
    background: Color


def _colors(digits: str) -> list[Color]:
    """Return colours from their hexadecimal digits."""
    return [cast(Color, tuple(bytes.fromhex(color))) for color in digits.split()]


LIGHT = Palette(*_colors("e87000 0050b9 7a0028 007668 88908c 985818 c364d7 7098ce 80807a e4e4de 3c3c3c ffffff"))
"""The palette for paper, windows and light pages."""

DARK = Palette(*_colors("ffb428 5587ff ff326e 96f5c8 787e8a 8c641e e1b9ff 3860b0 969ca8 484e5a ffffff 111318"))
"""The palette for recordings and dark pages."""

ROLES = Palette._fields[:7]
"""The roles that a reader must be able to distinguish."""

GRID: Color = (33, 36, 43)
"""Colour of the ground lines of a recording: visible only where nothing else is drawn."""

SERIES = _colors("0072b2 e69f00 009e73 cc79a7 56b4e9 d55e00 f0e442 000000")
"""Colours of curves, which colour-blind readers can distinguish (Okabe and Ito 2008), in their order in figures."""

CURVES = [SERIES[number] for number in (4, 2, 3, 6, 0, 5)]
"""Colours of a planner's curves in a recording. The first ones are no colour of a role."""

_TURN = np.linspace(0.0, 2.0 * np.pi, 49)
CIRCLE: Float[np.ndarray, "49 2"] = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)

DASHES = CIRCLE[:-1].reshape(8, 6, 2)[:, :4]
"""The outline of a pedestrian that is not seen, for a radius of 1: eight dashes of four points."""

MEASURED = "\N{WHITE CIRCLE} measured or remembered"
"""The key of the rings of `measured_rings`."""

APART = 0.05
"""Smallest distance in metres between a pedestrian and its measured position that is marked."""

BAND = 0.2
"""Height in inches of the bands of a picture, which hold the scale and texts, so that nothing covers them."""

FONT_SIZE = 8.0
"""The smallest size of a text in points, in a picture as wide as a column of a paper."""


class Line(NamedTuple):
    """A line through points in metres. Its width is in typographic points (1/72 inch)."""

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
    face: Color | None
    edge: Color
    width: float


class Text(NamedTuple):
    """A text at a point in metres, of a size in points. `anchor` is "m" (middle), "l" (left end) or "r" (right end).

    `halo` is the colour around or behind the letters, so that they can be read over lines.
    """

    at: Float[np.ndarray, "2"]
    text: str
    color: Color
    anchor: str = "m"
    halo: Color | None = None
    size: float = FONT_SIZE


Shape = Line | Disc | Polygon | Text


@dataclass(frozen=True)
class Moment:
    """One moment of an episode, the last of some states.

    Attributes:
        step: Numbers of the states; the last one may be between two states.
        position: Position of each agent in each state, in metres; NaN if the agent is absent.
        velocity: Velocity of each agent in m/s, in the step before each state.
        heading: Heading of the vehicle in each state, in radians.
        person: Number of each pedestrian in each state: it changes if another pedestrian takes the same index.
        goal: Goal of each agent in metres. This and all attributes below are for the last state.
        radius: Radius of each agent, in metres.
        seen: True if the vehicle sees the pedestrian.
        measured: Position in metres at which the vehicle measures or remembers the pedestrian; NaN for neither. With a
            detector, that of each track.
        obstacles: Polygons in metres, NaN after the last corner.
        rules: The rules of the scenario.
        hits_obstacle: True if the vehicle has hit an obstacle in the last step, which ended the episode.
    """

    step: Shaped[np.ndarray, "time"]
    position: Float[np.ndarray, "time agent 2"]
    velocity: Float[np.ndarray, "time agent 2"]
    heading: Float[np.ndarray, "time"]
    person: Int[np.ndarray, "time pedestrian"]
    goal: Float[np.ndarray, "agent 2"]
    radius: Float[np.ndarray, "agent"]
    seen: Bool[np.ndarray, "pedestrian"]
    measured: Float[np.ndarray, "track 2"]
    obstacles: Polygons
    rules: Rules
    hits_obstacle: bool = False

    @classmethod
    def of_trace(cls, trace: Trace, row: int, state: int, share: float = 0.0) -> Moment:
        """Return a state of the episode in a row of a trace, or a moment between it and the next state.

        Args:
            share: Fraction of the next step that has passed; positions are interpolated linearly.
        """
        states = np.arange(state + 1 + (share > 0.0))
        position, heading = trace.position[row, states], trace.heading[row, states]
        if share > 0.0:
            stays = same_agents(trace.person[row, states[-2:]])[0, :, None]
            between = (1.0 - share) * position[-2] + share * position[-1]
            position[-1] = np.where(stays, between, position[-2])
            heading[-1] = heading[-2] + share * turn(*heading[-2:])
        return cls(
            step=np.minimum(states, state + share),
            position=position,
            velocity=trace.velocity[row, states],
            heading=heading,
            person=trace.person[row, np.minimum(states, state)],
            goal=trace.goal[row, state],
            radius=trace.radius[row, state],
            seen=trace.seen[row, state],
            measured=position[-1, 1:] if trace.perceived is None else trace.perceived[row, state],
            obstacles=trace.obstacles[row],
            rules=trace.rules,
            hits_obstacle=bool(state == trace.steps[row] and trace.outcome[row] == Outcome.WALL_COLLISION),
        )

    @classmethod
    def of_worlds(cls, worlds: Sequence[World]) -> Moment:
        """Return the moment of the last of several worlds: states of one episode, each a batch of one."""
        now = worlds[-1]
        position = np.concatenate([np.where(world.present[..., None], world.position, np.nan) for world in worlds])
        measured, seen = position[-1, 1:], now.present[0, 1:]
        if now.sight:
            seen = now.sight["detected"][0] if now.rules.sensor.detector else now.sight["unseen"][0] == 0
            is_known = now.sight["unseen"][0, :, None] >= 0
            measured = np.where(is_known, now.sight["state"][0, :, :2], np.nan)
        return cls(
            step=np.concatenate([world.step for world in worlds]),
            position=position,
            velocity=np.concatenate([world.velocity for world in worlds]),
            heading=np.concatenate([world.heading for world in worlds]),
            person=np.concatenate([world.person for world in worlds]),
            goal=now.goal[0],
            radius=now.radius[0],
            seen=seen,
            measured=measured,
            obstacles=now.obstacles[0],
            rules=now.rules,
        )

    @functools.cached_property
    def hit(self) -> list[int]:
        """The agents that the vehicle has hit in the last step, by the rule of the collision check."""
        if len(self.step) < 2 or self.step[-1] - self.step[-2] != 1:
            return []
        before, now = self.position[-2:]
        rules = self.rules
        motion = np.empty(now.shape)
        fill_motion(before, now, self.velocity[-2], rules.numbers.collision, rules.dt, motion)
        speed = signed_speed(*self.velocity[-1, 0], self.heading[-1])
        turn_rate = turn(*self.heading[-2:]) / rules.dt
        stays = np.isfinite((before + now)[:, 0]) & same_agents(self.person[-2:])[0]  # the same pedestrians as before
        hit = []
        for agent in np.flatnonzero(stays).tolist()[1:]:
            pair = [0, agent]
            discs = Discs(before[pair], motion[pair], self.radius[pair], np.ones(2, bool))
            if isinstance(rules.dynamics, Holonomic):
                gap, _ = nearest_in_step(0, discs)
            else:
                no_walls = np.empty((0, 0, 2))
                gap, _ = gaps_on_arc(rules.numbers.body, self.heading[-2], speed, turn_rate, rules.dt, discs, no_walls)
            if gap < 0.0:
                hit.append(agent)
        return hit


def extent(position: Points, goal: Points, obstacles: Polygons, margin: float) -> Float[np.ndarray, "2 2"]:
    """Return the smallest and the largest x and y of an episode, in metres.

    Args:
        position: Positions of agents; NaN for absent agents.
        goal: Goals that are shown.
        obstacles: As in a `World`.
        margin: The space around them, in metres.
    """
    points = np.concatenate([position.reshape(-1, 2), goal.reshape(-1, 2), *polygons(obstacles)])
    return np.stack([np.nanmin(points, axis=0) - margin, np.nanmax(points, axis=0) + margin])


def agent_name(agent: int, rules: Rules) -> str:
    """Return the name of an agent that the vehicle sees, such as `pedestrian 3`."""
    return "another vehicle" if agent < rules.vehicles else f"pedestrian {agent - rules.vehicles}"


def same_agents(person: Int[np.ndarray, "time pedestrian"]) -> Bool[np.ndarray, "step agent"]:
    """Return whether each agent is the same one after each step: a new pedestrian can take the index of another."""
    same = np.ones((len(person) - 1, 1 + person.shape[1]), bool)
    same[:, 1:] = np.diff(person, axis=0) == 0
    return same


def paths(position: Float[np.ndarray, "time 2"], same: Bool[np.ndarray, "step"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Return the path in metres of each agent with the same index. `same` is False in steps that change the agent."""
    parts = [part[np.isfinite(part[:, 0])] for part in np.split(position, np.flatnonzero(~same) + 1)]
    return [part for part in parts if len(part) > 1]


def measured_rings(
    measured: Float[np.ndarray, "track 2"],
    position: Float[np.ndarray, "pedestrian 2"],
    radius: Float[np.ndarray, "pedestrian"],
    detector: Detector | None = None,
) -> list[Float[np.ndarray, "49 2"]]:
    """Return rings around the measured positions that differ from the positions of the pedestrians, all in metres.

    A track of a detector belongs to no pedestrian, and has a ring if all pedestrians are elsewhere.
    """
    if detector is None:
        is_there = np.hypot(*(measured - position).T) <= APART
    else:
        is_there = (np.hypot(*(measured[:, None] - position).transpose(2, 0, 1)) <= APART).any(axis=1)
        radius = np.full(len(measured), detector.radius)
    is_apart = np.isfinite(measured[:, 0]) & ~is_there
    return [measured[each] + 0.5 * radius[each] * CIRCLE for each in np.flatnonzero(is_apart)]


def draw_moment(moment: Moment) -> Iterator[Shape]:
    """Yield the shapes of a moment, from back to front. An arrow is the path of the next second."""
    for corners in polygons(moment.obstacles):
        yield Polygon(corners, LIGHT.faint, LIGHT.wall, 1.0)
    tolerance = moment.rules.goal_tolerance or float(moment.radius[0])
    yield Polygon(moment.goal[0] + star(0.2, 0.08, 5), LIGHT.vehicle, LIGHT.vehicle, 0.3)
    yield Disc(moment.goal[0], tolerance, None, LIGHT.vehicle, 1.0)
    if len(moment.radius) <= CROWD:
        yield from _draw_paths(moment)
    contacts = [0, *moment.hit] if moment.hit or moment.hits_obstacle else []
    arrows: list[Shape] = []
    # The vehicle is drawn last, so that nothing hides it.
    for agent in np.flatnonzero(np.isfinite(moment.position[-1, :, 0]))[::-1].tolist():
        here, radius = moment.position[-1, agent], float(moment.radius[agent])
        color = LIGHT.vehicle if agent < moment.rules.vehicles else LIGHT.pedestrian
        if agent == 0 or moment.seen[agent - 1]:
            yield Disc(here, radius, color, LIGHT.background)
        else:
            yield Disc(here, radius, LIGHT.background)
            yield from (Line(here + radius * dash, color, 1.2) for dash in DASHES)
        if agent in contacts:
            yield Disc(here, radius, None, LIGHT.contact, 1.8)
        arrows += _arrow(here, moment.velocity[-1, agent], LIGHT.text)
    if not isinstance(moment.rules.dynamics, Holonomic):
        body = moment.rules.body, moment.position[-1, 0], moment.heading[-1, ...], float(moment.radius[0])
        yield Polygon(outline(*body), LIGHT.vehicle, LIGHT.text, 1.0)
        yield Line(nose(*body), LIGHT.text, 1.0)
    yield from arrows
    for ring in measured_rings(
        moment.measured, moment.position[-1, 1:], moment.radius[1:], moment.rules.sensor.detector
    ):
        yield Line(ring, LIGHT.background, 2.4)
        yield Line(ring, LIGHT.text, 1.0)
    if contacts:
        yield Polygon(burst(moment.position[-1, contacts], moment.radius[contacts]), None, LIGHT.contact, 1.6)


def _draw_paths(moment: Moment) -> Iterator[Shape]:
    """Yield the past path of each agent, with a dot at its start; the vehicle's last, so that nothing hides it."""
    same = same_agents(moment.person)
    for agent in reversed(range(len(moment.radius))):
        color, width = (LIGHT.vehicle, 1.6) if agent == 0 else (LIGHT.walked, 0.8)
        for path in paths(moment.position[:, agent], same[:, agent]):
            yield Line(path, color, width)
            yield Disc(path[0], 0.06, color)


def star(outer: float, inner: float, points: int) -> Float[np.ndarray, "corner 2"]:
    """Return the corners of a star around the origin, with radii in metres, one point upwards."""
    angles = np.pi / 2.0 + np.arange(2 * points) * np.pi / points
    return np.resize([outer, inner], 2 * points)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def burst(position: Float[np.ndarray, "agent 2"], radius: Float[np.ndarray, "agent"]) -> Float[np.ndarray, "corner 2"]:
    """Return the mark of a contact: a star in metres around the agents in it."""
    middle = position.mean(axis=0)
    reach = float((np.hypot(*(position - middle).T) + radius).max())
    small = 2.0 * float(radius.min())
    if reach > 1.5 * small:  # a long vehicle: the star is around the other one
        middle, reach = position[radius.argmin()], small
    return middle + star(1.7 * reach, 1.25 * reach, 12)


def draw_bands(
    bounds: Float[np.ndarray, "2 2"], side: float, note: tuple[str, Color] | None = None, title: str = ""
) -> tuple[list[Shape], Float[np.ndarray, "2 2"], float]:
    """Draw a band below a picture, with the scale at the left and a note at the right, and one above for a title.

    Args:
        bounds: The smallest and the largest x and y in metres that are shown.
        side: Length of the longer side of the plane in the picture, in inches.
        note: A text, such as the time or the outcome, and its colour.
        title: A text above; without one there is no band above.

    Returns:
        The shapes of the bands, the bounds with the bands, and the number of metres per inch.
    """
    inch = float((bounds[1] - bounds[0]).max()) / side
    bounds = bounds + BAND * inch * np.array([[0.0, -1.0], [0.0, float(bool(title))]])
    (left, bottom), (right, top) = bounds
    band = BAND * inch
    shapes: list[Shape] = []
    for y in [bottom, top - band] if title else [bottom]:
        corners = np.array([(left, y), (right, y), (right, y + band), (left, y + band)])
        shapes.append(Polygon(corners, LIGHT.background, LIGHT.background, 0.0))
    middle, pad = bottom + band / 2.0, 0.06 * inch
    length = next((each for each in (1.0, 2.0, 5.0, 10.0, 20.0) if each > 0.15 * inch), 50.0)
    end = np.array([left + pad + length, middle])
    shapes.append(Line(np.stack([end - [length, 0.0], end]), LIGHT.text, 1.6))
    shapes.append(Text(end + np.array([pad, 0.0]), f"{length:g} m", LIGHT.text, "l"))
    if note is not None:
        shapes.append(Text(np.array([right - pad, middle]), *note, "r"))
    if title:
        shapes.append(Text(np.array([left + pad, top - band / 2.0]), title, LIGHT.text, "l"))
    return shapes, bounds, inch


def _arrow(start: Float[np.ndarray, "2"], vector: Float[np.ndarray, "2"], color: Color) -> list[Shape]:
    """Return an arrow from a point in metres; an empty list if the arrow is shorter than its head."""
    length = float(np.hypot(*vector))
    if length < 0.15:
        return []
    tip, along = start + vector, vector / length * 0.15
    across = np.array([-along[1], along[0]]) * 0.6
    head = np.stack([tip, tip - along + across, tip - along - across])
    return [Line(np.stack([start, tip - along]), color, 0.8), Polygon(head, color, color, 0.3)]
