"""A periodic corridor: agents that leave it on one side enter it on the other.

Each pedestrian has an image, one length of the corridor away, beyond the farther end. Pedestrians see images like other
pedestrians, so that the seam has no effect: each pedestrian sees all others within half a length on both sides. After
every step, pedestrians that have left the corridor are moved by its length, and the images are updated. The velocities
that a policy returns for images are not used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from jaxtyping import Float

from crowdbench import InputError, PedestrianPolicy, World
from crowdbench.scenario import PerAgent, Placement
from crowdbench.sim import crowd_velocities, step_pedestrians

OfPeople = Float[np.ndarray, "world person"]

FAR = 1000.0
"""Distance to goals in metres: no pedestrian arrives, and all walk straight along the corridor."""

BAND = 0.75
"""Two pedestrians are in the same lane if their lateral distance is at most this number of diameters."""

LEAST_DIAMETER = 0.4
"""Least diameter in metres for lanes: otherwise, each of very small pedestrians would have a separate lane."""


def corridor(length: float, width: float, backward: float) -> Callable[..., Placement]:
    """Return a layout of a corridor.

    Args:
        length: Length of the corridor in metres.
        width: Its width in metres.
        backward: Share of the pedestrians that walk towards smaller x.

    Returns:
        The layout. Of the pedestrians, the second half are the images of the first.
    """

    def layout(rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent) -> Placement:
        number = len(radius) // 2
        start = spread(rng, number, radius[1], length, width)
        start = np.concatenate([np.zeros((1, 2)), start, start + _to_image(start, length)])
        ahead = np.where(rng.permutation(number) < round(backward * number), -FAR, FAR)
        goal = start + np.stack([np.concatenate([[FAR], ahead, ahead]), np.zeros(len(start))], axis=1)
        side = width / 2.0
        walls = [[[-length, y], [2.0 * length, y]] for y in (-side, side)]
        return Placement(start, goal, route=np.empty((len(start), 0, 2)), obstacles=np.array(walls))

    return layout


def spread(
    rng: np.random.Generator, number: int, radius: float, length: float, width: float
) -> Float[np.ndarray, "{number} 2"]:
    """Draw positions on a rectangle at which discs do not overlap.

    The rectangle is divided into cells that are as square as possible, at least one per disc. Each disc has a random
    position in a different, random cell.

    Args:
        rng: The random stream to draw from.
        number: Number of discs.
        radius: Their radius in metres.
        length: Extent of the rectangle along x in metres, from 0.
        width: Extent along y in metres, with 0 in the middle.

    Returns:
        Centres in metres.

    Raises:
        InputError: The discs do not fit on the rectangle.
    """
    rows = range(1, int(width / (2.0 * radius) + 1e-9) + 1)
    fits = [(min(length / math.ceil(number / row), width / row), row) for row in rows]
    size, across = max(fits, default=(0.0, 1))
    if size < 2.0 * radius - 1e-9:
        raise InputError(f"{number} people of radius {radius:g} m have no room on {length:g} m x {width:g} m")
    cell = np.array([length / math.ceil(number / across), width / across])
    along = math.ceil(number / across)
    chosen = rng.permutation(along * across)[:number]
    middle = (np.stack([chosen % along, chosen // along], axis=1) + 0.5) * cell
    play = np.maximum(cell / 2.0 - radius, 0.0)
    return middle + rng.uniform(-play, play, (number, 2)) - [0.0, width / 2.0]


def walk(
    world: World, policies: Mapping[str, PedestrianPolicy], length: float, steps: int, single_file: bool = False
) -> Iterator[World]:
    """Simulate pedestrians in a corridor.

    Args:
        world: Their start, see `corridor`.
        policies: The policies that move them.
        length: Length of the corridor in metres.
        steps: Number of steps.
        single_file: True to hold pedestrians in the middle of the corridor: after each step, their lateral motion is
            undone. Otherwise, they would oscillate between near walls under a social force.

    Yields:
        The worlds after each step.
    """
    ahead = world.goal - world.position
    for _ in range(steps):
        velocity = crowd_velocities(world, policies)
        after = step_pedestrians(world, velocity, None)
        world = _closed(_in_the_middle(after) if single_file else after, ahead, length)
        yield world


def people_of(world: World) -> slice:
    """Return the slice of agents that are pedestrians: neither the vehicle nor images."""
    return slice(1, 1 + world.person.shape[1] // 2)


def forward_speed(world: World) -> OfPeople:
    """Return the speed of each pedestrian in the direction of its goal in m/s."""
    who = people_of(world)
    return world.velocity[:, who, 0] * direction(world)


def direction(world: World) -> OfPeople:
    """Return 1 for each pedestrian that walks towards larger x, -1 for the others."""
    who = people_of(world)
    return np.sign(world.goal[:, who, 0] - world.position[:, who, 0])


def lane_order(across: OfPeople, direction: OfPeople, radius: float) -> Float[np.ndarray, "world"]:
    """Return the reduced order parameter of lane formation.

    For each pedestrian, with n pedestrians in its lane in the same direction (itself included) and m in the other one,
    the order is ((n - m) / (n + m))^2 (Rex and Löwen 2007). Its mean over pedestrians, Phi, is 1 if every lane has one
    direction. Phi is not 0 for mixed directions, because lanes have few pedestrians. Nowak and Schadschneider (2012)
    therefore reduce it: (Phi - Phi_0) / (1 - Phi_0), where Phi_0 is its mean over all assignments of the directions to
    the same positions. Here half of the N pedestrians walk in each direction. Then the mean of (n - m)^2 over these
    assignments is k (N - k) / (N - 1) for a lane of k = n + m pedestrians.

    Args:
        across: Lateral position of each pedestrian in metres.
        direction: 1 or -1, each for half of the pedestrians.
        radius: The pedestrians' radius in metres.

    Returns:
        1 if every lane has one direction, on average 0 for mixed directions; NaN if no pedestrians share a lane.
    """
    near = np.abs(across[:, :, None] - across[:, None]) <= BAND * max(2.0 * radius, LEAST_DIAMETER)
    lane = near.sum(axis=2)
    order = ((near @ direction[..., None])[..., 0] / lane) ** 2
    number = across.shape[1]
    mixed = ((number - lane) / (lane * (number - 1))).mean(axis=1)
    found, room = order.mean(axis=1) - mixed, 1.0 - mixed
    return np.divide(found, room, out=np.full(len(found), np.nan), where=room > 0.0)


def _in_the_middle(world: World) -> World:
    """Move all agents to the middle of the corridor, y = 0."""
    along = np.array([1.0, 0.0])
    return world.replace(position=world.position * along, velocity=world.velocity * along)


def _closed(world: World, ahead: Float[np.ndarray, "world agent 2"], length: float) -> World:
    """Move pedestrians back into the corridor, and update their images and the goals of both."""
    position, velocity, history = world.position.copy(), world.velocity.copy(), world.history.copy()
    who = people_of(world)
    number = who.stop - 1
    left = np.zeros_like(position[:, who])
    left[..., 0] = np.floor(position[:, who, 0] / length) * length
    position[:, who] -= left
    history[:, :, :number] -= left[:, None]
    image = _to_image(position[:, who], length)
    position[:, who.stop :] = position[:, who] + image
    velocity[:, who.stop :] = velocity[:, who]
    history[:, :, number:] = history[:, :, :number] + image[:, None]
    return world.replace(position=position, velocity=velocity, history=history, goal=position + ahead)


def _to_image(position: Float[np.ndarray, "*batch 2"], length: float) -> Float[np.ndarray, "*batch 2"]:
    """Return the vector from each pedestrian to its image, in metres."""
    vector = np.zeros_like(position)
    vector[..., 0] = np.where(position[..., 0] < length / 2.0, length, -length)
    return vector
