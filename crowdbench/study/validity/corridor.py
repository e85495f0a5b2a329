"""A corridor whose end is its beginning: whoever leaves it on one side enters it on the other.

Everybody has an image, one length of the corridor away, on the side where the other end is near. People see images as
they see people, so that the seam is not felt: around each person, everybody within half a length is in sight on both
sides. After every step, people who have left the corridor are put back by its length, and the images are put where they
belong; what a policy has answered for an image is not used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from jaxtyping import Float

from crowdbench.scenario.placement import Placement
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.sim.simulator import advance, crowd_velocities
from crowdbench.study.validity.people import spread
from crowdbench.types import World

FAR = 1000.0
"""How far ahead goals are, in metres: nobody arrives, and all walk straight along the corridor."""


def corridor(length: float, width: float, backward: float) -> Callable[..., Placement]:
    """A layout of a corridor.

    Args:
        length: Length of the corridor in metres.
        width: Its width in metres.
        backward: Share of the people who walk towards smaller x.

    Returns:
        The layout. Of the pedestrians, the second half are the images of the first.
    """

    def layout(
        rng: np.random.Generator, radius: Float[np.ndarray, "agent"], preferred_speed: Float[np.ndarray, "agent"]
    ) -> Placement:
        number = len(radius) // 2
        start = spread(rng, number, radius[1], length, width)
        start = np.concatenate([np.zeros((1, 2)), start, start + _to_image(start, length)])
        ahead = np.where(rng.permutation(number) < round(backward * number), -FAR, FAR)
        goal = start + np.stack([np.concatenate([[FAR], ahead, ahead]), np.zeros(len(start))], axis=1)
        side = width / 2.0
        walls = [[[-length, y], [2.0 * length, y]] for y in (-side, side)]
        return Placement(start, goal, route=np.empty((len(start), 0, 2)), obstacles=np.array(walls))

    return layout


def walk(
    world: World, policies: Mapping[str, PedestrianPolicy], length: float, steps: int, single_file: bool = False
) -> Iterator[World]:
    """Let people walk in a corridor.

    Args:
        world: Their start, see `corridor`.
        policies: The policies that move them.
        length: Length of the corridor in metres.
        steps: Number of steps.
        single_file: Whether everybody is held in the middle of the corridor: after each step, what they have moved
            sideways is undone. Without this, a social force swings them between walls that are near.

    Yields:
        The worlds after each step.
    """
    ahead = world.goal - world.position
    for _ in range(steps):
        asked = crowd_velocities(world, policies)
        after = advance(world, np.pad(asked, ((0, 0), (1, 0), (0, 0))))
        world = _closed(_in_the_middle(after) if single_file else after, ahead, length)
        yield world


def people_of(world: World) -> slice:
    """Which agents are people: neither the vehicle nor images."""
    return slice(1, 1 + world.person.shape[1] // 2)


def forward_speed(world: World) -> Float[np.ndarray, "world person"]:
    """How fast each person walks in the direction of its goal, in m/s."""
    who = people_of(world)
    return world.velocity[:, who, 0] * direction(world)


def direction(world: World) -> Float[np.ndarray, "world person"]:
    """1 for each person who walks towards larger x, -1 for those who walk the other way."""
    who = people_of(world)
    return np.sign(world.goal[:, who, 0] - world.position[:, who, 0])


def _in_the_middle(world: World) -> World:
    """Put everybody into the middle of the corridor, y = 0."""
    along = np.array([1.0, 0.0])
    return world.replace(position=world.position * along, velocity=world.velocity * along)


def _closed(world: World, ahead: Float[np.ndarray, "world agent 2"], length: float) -> World:
    """Put people back into the corridor, images where they belong, and goals ahead of both."""
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
    """The vector from each person to its image, in metres."""
    vector = np.zeros_like(position)
    vector[..., 0] = np.where(position[..., 0] < length / 2.0, length, -length)
    return vector
