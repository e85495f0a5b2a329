"""Groups of pedestrians: their sizes, and the positions of their members."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.scenario.placement import PerAgent, Placement, Position, check_finite, check_shape
from crowdbench.scenario.respawn import Surroundings

GAP = 0.2
"""Distance in metres between the rims of neighbours in a group at the start."""

TRIES = 100
"""Largest number of draws for the position of a standing group."""


def draw_groups(stream: np.random.Generator, shares: Mapping[int, float], n: int) -> Int[np.ndarray, "{n}"]:
    """Divide pedestrians into groups.

    Args:
        stream: The random stream to draw from.
        shares: Shares of the groups by size, in any unit. The last group consists of the remaining pedestrians.
        n: Number of pedestrians.

    Returns:
        Index of the first member of each pedestrian's group.
    """
    share = np.array(list(shares.values()))
    sizes = stream.choice(list(shares), n, p=share / share.sum())
    return np.repeat(np.cumsum(sizes) - sizes, sizes)[:n]


def group_numbers(leader: Int[np.ndarray, "pedestrian"]) -> Int[np.ndarray, "pedestrian"]:
    """Return each pedestrian's group number, -1 without a group, from the index of the first member of its group."""
    return np.where(np.bincount(leader, minlength=1)[leader] > 1, leader, -1)


def group_reach(radius: Float[np.ndarray, "member"]) -> float:
    """Return the radius in metres of a disc around a group, for walking and standing groups."""
    return float(radius.max()) + _spacing(radius) * (len(radius) - 1) / 2


def member_offsets(ahead: Position, radius: Float[np.ndarray, "member"], stands: bool) -> Float[np.ndarray, "member 2"]:
    """Return the offsets of members from the middle of a group: side by side if it walks, in a circle if it stands.

    Args:
        ahead: Its walking direction, a vector of any length.
        radius: Radii in metres.
        stands: True if it stands.

    Returns:
        Offsets in metres.
    """
    n, spacing, heading = len(radius), _spacing(radius), math.atan2(ahead[1], ahead[0])
    index = np.arange(n)
    if stands and n > 1:
        angle = heading + 2 * np.pi * index / n
        return spacing / (2 * math.sin(math.pi / n)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    aside = spacing * (index - (n - 1) / 2)
    return aside[:, None] * np.array([-math.sin(heading), math.cos(heading)])


def place_groups(
    layout: Callable[[PerAgent, PerAgent], object],
    leader: Int[np.ndarray, "pedestrian"],
    radius: PerAgent,
    preferred_speed: PerAgent,
    stands: Bool[np.ndarray, "pedestrian"],
    stream: np.random.Generator,
) -> Placement:
    """Place groups by a layout, each as one large pedestrian, and the members of each group within it.

    A standing group is placed between its start and its goal, clear of all starts and goals. It has arrived.

    Args:
        layout: Places agents with the given radii in metres and speeds in m/s.
        leader: Index of the first member of each pedestrian's group. Members have consecutive indices.
        radius: Radii in metres, the vehicle first.
        preferred_speed: In m/s.
        stands: True for pedestrians that stand.
        stream: The random stream for the positions of standing groups.

    Raises:
        InputError: The layout does not return a placement.
    """
    group = np.unique(np.append(0, leader + 1), return_inverse=True)[1]
    groups = [np.flatnonzero(group == number) for number in range(group.max() + 1)]
    reach = np.array([group_reach(radius[members]) for members in groups])
    leaders = [members[0] for members in groups]
    placement = check_finite(check_shape(layout(reach, preferred_speed[leaders]), len(groups)))
    ahead = placement.goal - placement.start
    offset = np.concatenate(
        [member_offsets(ahead[number], radius[members], False) for number, members in enumerate(groups)]
    )
    start, goal = placement.start[group] + offset, placement.goal[group] + offset
    route = None if placement.route is None else placement.route[group]
    obstacles = np.empty((0, 0, 2)) if placement.obstacles is None else placement.obstacles
    for number, members in enumerate(groups[1:], 1):
        if stands[members[0] - 1]:
            others = group != number
            surroundings = Surroundings(start[others], goal[others], radius[others], preferred_speed[others], obstacles)
            points = placement.start[number] + stream.random(TRIES)[:, None] * ahead[number]
            clear = (point for point in points if surroundings.is_clear(point, float(reach[number])))
            middle = next(clear, placement.start[number])
            start[members] = goal[members] = middle + member_offsets(ahead[number], radius[members], True)
            if route is not None:
                route[members] = np.nan
    return Placement(start, goal, route, placement.obstacles)


def _spacing(radius: Float[np.ndarray, "member"]) -> float:
    """Return the distance in metres between the centres of neighbours."""
    return 2 * float(radius.max()) + GAP
