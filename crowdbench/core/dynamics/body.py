"""The body of a vehicle: one disc, or a chain of discs along its heading, all of the vehicle's radius."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from crowdbench.core.arrays import Numbers, Vectors

Body = tuple[float, ...]
"""Offsets of the centres of the discs ahead of the vehicle's position, in metres."""

DISC: Body = (0.0,)
"""The body that is one disc."""

SPACING = 0.5
"""Largest distance between neighbouring centres in radii: the sides are straight to within 3.2 % of a radius."""


def chain(length: float, radius: float, centre: float) -> Body:
    """Return the discs that cover a rectangle, apart from its corners.

    Args:
        length: Length of the rectangle along the heading in metres, at least twice the radius.
        radius: Half its width in metres.
        centre: Offset of its centre ahead of the vehicle's position, in metres.

    Returns:
        The body.
    """
    reach = length / 2.0 - radius
    number = math.ceil(2.0 * reach / (SPACING * radius) - 1e-9) + 1
    return tuple((centre + np.linspace(-reach, reach, number)).tolist())


def reach(body: Body) -> float:
    """Return the largest distance in metres of a disc's centre from the vehicle's position."""
    return max(map(abs, body))


def disc_centres(body: Body, position: Vectors, heading: Numbers) -> Float[np.ndarray, "*batch disc 2"]:
    """Return the centres of the discs of vehicles, from positions in metres and headings in radians."""
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return position[..., None, :] + np.array(body)[:, None] * direction[..., None, :]


def hull(body: Body, position: Vectors, heading: Numbers, radius: Numbers) -> tuple[Vectors, Numbers]:
    """Return the smallest disc around a body, for models in which each agent is one disc.

    Args:
        body: The body.
        position: Positions of vehicles in metres.
        heading: Their headings in radians.
        radius: Their radii in metres.

    Returns:
        The centre and the radius of the disc around each vehicle, in metres.
    """
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return position + (body[0] + body[-1]) / 2.0 * direction, radius + (body[-1] - body[0]) / 2.0


def outline(body: Body, position: Vectors, heading: Numbers, radius: float) -> Float[np.ndarray, "*batch point 2"]:
    """Return the rim of a body, for plots: around its discs, from the right of the first one to the left of the last
    one.

    Args:
        body: The body.
        position: Its position in metres.
        heading: In radians.
        radius: The radius of its discs in metres.

    Returns:
        Points in metres; the last one equals the first one.
    """
    angle = np.linspace(-np.pi / 2.0, np.pi / 2.0, 25)
    front = np.stack([body[-1] + radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    back = np.stack([body[0] - radius * np.cos(angle), -radius * np.sin(angle)], axis=1)
    rim = np.concatenate([front, back, front[:1]])
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    turned = np.stack([cos * rim[:, 0] - sin * rim[:, 1], sin * rim[:, 0] + cos * rim[:, 1]], axis=-1)
    return position[..., None, :] + turned


def nose(body: Body, position: Vectors, heading: Numbers, radius: float) -> Float[np.ndarray, "*batch 2 2"]:
    """Return a line that marks the heading of a body, from the centre of its front disc to the rim.

    Args:
        body: The body.
        position: Its position in metres.
        heading: In radians.
        radius: The radius of its discs in metres.

    Returns:
        The two ends in metres.
    """
    return disc_centres((body[-1], body[-1] + radius), position, heading)
