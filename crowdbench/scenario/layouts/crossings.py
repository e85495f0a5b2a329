"""Crossings on an empty plane.

They draw the same random numbers in the same order as CrowdNav (Chen et al. 2019) and CrowdNav++ (Liu et al. 2023):
with the same seeds they return the same cases.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from crowdbench.scenario.layouts.placer import MAX_DRAWS, Placer, Point
from crowdbench.scenario.placement import PerAgent, Placement
from crowdbench.utils.errors import InputError

CIRCLE_RADIUS = 6.0 * math.sqrt(2.0)
"""Radius of the circle of CrowdNav++ in metres."""

PLUS_CLEARANCE = 0.25
"""In CrowdNav++, smallest distance in metres between the rims of two agents at the start, and to goals of others."""

NOISE = 2.0
"""In CrowdNav++, largest offset in metres of pedestrians' starts from the circle, towards positive x and y."""

MIN_TRIP = 8.0
"""In CrowdNav++, smallest distance in metres from the vehicle's start to its goal."""

Draw = Callable[[], float]
"""Function that draws a number uniformly from 0 to 1."""


def circle_crossing(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    circle_radius: float = 4.0,
    perturbation: float = 0.0,
    goal_angle: float = 0.0,
) -> Placement:
    """Let all agents walk from a point near a circle to the opposite side, the vehicle from bottom to top.

    Args:
        circle_radius: Radius of the circle [m].
        perturbation: Standard deviation of Gaussian noise on each coordinate of the vehicle's start and of all goals;
            noise of more than two standard deviations is drawn again. The starts of pedestrians always have CrowdNav's
            uniform noise [m].
        goal_angle: Largest angle around the centre between the goal of a pedestrian and the point opposite its start,
            drawn uniformly [deg]. If it is 0, all cross in the centre.

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """

    def perturb(x: float, y: float) -> tuple[float, float]:
        if perturbation == 0.0:
            return x, y
        while True:
            dx, dy = rng.normal(0.0, perturbation, 2)
            if max(abs(dx), abs(dy)) <= 2 * perturbation:
                return x + dx, y + dy

    placer = Placer(radius)
    placer.add(perturb(0.0, -circle_radius), perturb(0.0, circle_radius))
    speeds = preferred_speed.tolist()

    def place_next() -> bool:
        speed = speeds[len(placer.start)]
        for _ in range(MAX_DRAWS):
            angle = rng.random() * np.pi * 2
            x = circle_radius * math.cos(angle) + (rng.random() - 0.5) * speed
            y = circle_radius * math.sin(angle) + (rng.random() - 0.5) * speed
            goal = perturb(-x, -y)
            if not (placer.start.is_clear(x, y) and placer.goal.is_clear(x, y)):
                continue
            if goal_angle > 0.0:  # goals opposite to clear starts are clear too
                angle = math.radians(goal_angle * (2.0 * rng.random() - 1.0))
                cos, sin = math.cos(angle), math.sin(angle)
                goal = goal[0] * cos - goal[1] * sin, goal[0] * sin + goal[1] * cos
            if goal_angle == 0.0 or placer.goal.is_clear(*goal):
                placer.add((x, y), goal)
                return True
        return False

    return placer.fill(place_next, f"a circle of {circle_radius:g} m radius", "layout.circle_radius")


def square_crossing(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    square_width: float = 10.0,
    circle_radius: float = 4.0,
) -> Placement:
    """Let pedestrians walk from one half of a square to the other, and the vehicle upwards through its middle.

    Args:
        square_width: Width of the square [m].
        circle_radius: The vehicle goes from (0, -circle_radius) to (0, circle_radius) [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """
    placer = Placer(radius)
    placer.add((0.0, -circle_radius), (0.0, circle_radius))

    def place_next() -> bool:
        side = -1.0 if rng.random() > 0.5 else 1.0
        start = _draw_clear(rng, square_width, side, placer.start.is_clear)
        goal = start and _draw_clear(rng, square_width, -side, placer.goal.is_clear)
        if start is None or goal is None:
            return False
        placer.add(start, goal)
        return True

    return placer.fill(place_next, f"a square of {square_width:g} m", "layout.square_width")


def _draw_clear(
    rng: np.random.Generator, width: float, side: float, clear: Callable[[float, float], bool]
) -> tuple[float, float] | None:
    """Return the first drawn position that is clear, in the left half (-1) or the right half (1) of a square; None
    without one."""
    for _ in range(MAX_DRAWS):
        x = rng.random() * width * 0.5 * side
        y = (rng.random() - 0.5) * width
        if clear(x, y):
            return x, y
    return None


def crowdnav_plus(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    circle_radius: float = CIRCLE_RADIUS,
    half_width: float = 6.0,
) -> Placement:
    """Let pedestrians walk from a point beside a circle to the opposite point, and the vehicle at least 8 m through a
    square.

    Args:
        circle_radius: Radius of the circle [m].
        half_width: Start and goal of the vehicle lie in the square from -half_width to half_width [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """
    if 2.0 * math.sqrt(2.0) * half_width <= MIN_TRIP:
        raise InputError(f"a square of {2.0 * half_width:g} m has no way of {MIN_TRIP:g} m: raise layout.half_width")
    placer = Placer(radius, clearance=PLUS_CLEARANCE)
    placer.add(*draw_vehicle_trip(rng.random, half_width))

    def is_clear(point: Point) -> bool:
        return placer.start.is_clear(*point) and placer.goal.is_clear(*point)

    def place_next() -> bool:
        start = draw_beside(rng.random, circle_radius, 0.0, NOISE, is_clear)
        if start is None:
            return False
        placer.add(start, (-start[0], -start[1]))
        return True

    return placer.fill(place_next, f"a circle of {circle_radius:g} m radius", "layout.circle_radius")


def draw_vehicle_trip(draw: Draw, half_width: float) -> tuple[Point, Point]:
    """Draw the vehicle's start and goal in the square from -half_width to half_width, in metres."""
    while True:
        x, y, goal_x, goal_y = (-half_width + 2.0 * half_width * draw() for _ in range(4))
        if math.hypot(x - goal_x, y - goal_y) >= MIN_TRIP:
            return (x, y), (goal_x, goal_y)


def draw_beside(
    draw: Draw, circle_radius: float, low: float, noise: float, clear: Callable[[Point], bool]
) -> Point | None:
    """Draw a point beside a circle; return None if there is no room.

    Args:
        draw: The random stream.
        circle_radius: In metres.
        low: The noise is drawn from -low to 1 - low. 0 for a start, 0.5 for the new goal of a walking pedestrian.
        noise: Factor of this noise in metres: `NOISE` for a start, the preferred speed in m/s for a new goal.
        clear: True if a point in metres has room.
    """
    for _ in range(MAX_DRAWS):
        angle = draw() * np.pi * 2
        noise_x, noise_y = (draw() - low) * noise, (draw() - low) * noise
        point = circle_radius * np.cos(angle) + noise_x, circle_radius * np.sin(angle) + noise_y
        if clear(point):
            return point
    return None
