"""The crossing of CrowdNav++ (Liu et al. 2023): people on a large circle, a vehicle anywhere within it.

It draws the same random numbers in the same order as their code, so that with their seeds it gives their cases.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.scenario.layouts.placed import ATTEMPTS, TRIES, Point, no_room
from crowdbench.scenario.placement import Placement

CIRCLE_RADIUS = 6.0 * math.sqrt(2.0)
"""In metres."""

CLEARANCE = 0.25
"""Smallest distance in metres between the rims of two agents at the start, and to the goals of the others."""

NOISE = 2.0
"""The starts of people lie up to so many metres from the circle, towards positive x and y."""

LEAST_WAY = 8.0
"""Distance in metres from the vehicle's start to its goal, at least."""

Draw = Callable[[], float]
"""Draws a number uniformly from 0 to 1."""


def crowdnav_plus(
    rng: np.random.Generator,
    radius: Float[np.ndarray, "agent"],
    preferred_speed: Float[np.ndarray, "agent"],
    *,
    circle_radius: float = CIRCLE_RADIUS,
    half_width: float = 6.0,
) -> Placement:
    """Pedestrians walk from a point beside a circle to the opposite point, the vehicle at least 8 m through a square.

    Args:
        circle_radius: Radius of the circle [m].
        half_width: Start and goal of the vehicle lie in the square from -half_width to half_width [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """
    if 2.0 * math.sqrt(2.0) * half_width <= LEAST_WAY:
        raise InputError(
            f"a square from {-half_width:g} to {half_width:g} m has no way of {LEAST_WAY:g} m: raise layout.half_width"
        )
    first = vehicle_way(rng.random, half_width)
    for _ in range(ATTEMPTS):
        ways = [first, *_ways(rng.random, radius, circle_radius, first)]
        if len(ways) == len(radius):
            starts, goals = np.array(ways).swapaxes(0, 1)
            return Placement(start=starts, goal=goals)
    area = f"a circle of {circle_radius:g} m radius"
    raise InputError(no_room(len(ways), len(radius), area, "layout.circle_radius"))


def _ways(
    draw: Draw, radius: Float[np.ndarray, "agent"], circle_radius: float, first: tuple[Point, Point]
) -> Iterator[tuple[Point, Point]]:
    """Draw the starts and goals of pedestrians, up to the one who finds no room.

    Args:
        draw: The random stream of the case.
        radius: Radii of all agents, in metres.
        circle_radius: In metres.
        first: Start and goal of the vehicle.
    """
    ways = [first]
    for agent in range(1, len(radius)):
        points, reach = np.array(ways).reshape(-1, 2), np.repeat(radius[:agent] + (radius[agent] + CLEARANCE), 2)
        start = start_beside(draw, circle_radius, functools.partial(is_clear, others=points, reach=reach))
        if start is None:
            return
        ways.append((start, (-start[0], -start[1])))
        yield ways[-1]


def vehicle_way(draw: Draw, half_width: float) -> tuple[Point, Point]:
    """Draw the vehicle's start and goal.

    Args:
        draw: The random stream of the case.
        half_width: They lie in the square from -half_width to half_width, in metres.
    """
    while True:
        x, y, goal_x, goal_y = (-half_width + 2.0 * half_width * draw() for _ in range(4))
        if math.hypot(x - goal_x, y - goal_y) >= LEAST_WAY:
            return (x, y), (goal_x, goal_y)


def start_beside(draw: Draw, circle_radius: float, clear: Callable[[Point], bool]) -> Point | None:
    """Draw a person's start; its goal is the opposite point.

    Args:
        draw: The random stream.
        circle_radius: In metres.
        clear: Whether a point in metres has room.

    Returns:
        A point in metres, None where there is no room.
    """
    for _ in range(TRIES):
        angle = draw() * np.pi * 2
        noise_x, noise_y = draw() * NOISE, draw() * NOISE
        point = circle_radius * np.cos(angle) + noise_x, circle_radius * np.sin(angle) + noise_y
        if clear(point):
            return point
    return None


def goal_on(draw: Draw, circle_radius: float, preferred_speed: float, clear: Callable[[Point], bool]) -> Point | None:
    """Draw another goal for a person on the way.

    Args:
        draw: The random stream.
        circle_radius: In metres.
        preferred_speed: The person's, in m/s.
        clear: Whether a point in metres has room.

    Returns:
        A point in metres, None where there is no room.
    """
    for _ in range(TRIES):
        angle = draw() * np.pi * 2
        noise_x, noise_y = (draw() - 0.5) * preferred_speed, (draw() - 0.5) * preferred_speed
        point = circle_radius * np.cos(angle) + noise_x, circle_radius * np.sin(angle) + noise_y
        if clear(point):
            return point
    return None


def is_clear(point: Point, others: Float[np.ndarray, "other 2"], reach: Float[np.ndarray, "other"]) -> bool:
    """Whether a point keeps its distance from others.

    Args:
        point: In metres.
        others: In metres.
        reach: How far it must be from each, in metres.
    """
    return bool((np.hypot(others[:, 0] - point[0], others[:, 1] - point[1]) >= reach).all())
