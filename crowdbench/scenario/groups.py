"""People who belong together: the sizes of groups, and where their members are."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.scenario.placement import PerAgent, Placement, Position, check_finite, check_shape
from crowdbench.scenario.respawn import Room

GAP = 0.2
"""Distance in metres between the rims of neighbours in a group at the start."""

LARGEST = 5
"""People in a group, at most."""

TRIES = 100
"""Draws for the place of a group that stands."""


def draw_groups(stream: np.random.Generator, shares: Mapping[int, float], n: int) -> Int[np.ndarray, "{n}"]:
    """Divide pedestrians into groups.

    Args:
        stream: The random stream to draw from.
        shares: By size, the share of the groups that are so large, in any unit; the last group has who is left.
        n: Number of pedestrians.

    Returns:
        The first one in the group of each pedestrian.
    """
    share = np.array(list(shares.values()))
    sizes = stream.choice(list(shares), n, p=share / share.sum())
    return np.repeat(np.cumsum(sizes) - sizes, sizes)[:n]


def group_numbers(leader: Int[np.ndarray, "pedestrian"]) -> Int[np.ndarray, "pedestrian"]:
    """Return the number of each one's group, -1 for who is alone, by the first one in the group of each."""
    return np.where(np.bincount(leader, minlength=1)[leader] > 1, leader, -1)


def group_reach(radius: Float[np.ndarray, "member"]) -> float:
    """Return the radius in metres of a disc that holds a group, whether it walks or stands."""
    return float(radius.max()) + _spacing(radius) * (len(radius) - 1) / 2


def spread(ahead: Position, radius: Float[np.ndarray, "member"], stands: bool) -> Float[np.ndarray, "member 2"]:
    """Return where the members of a group are, from its middle: side by side if it walks, in a circle if it stands.

    Args:
        ahead: The direction in which it walks, of any length.
        radius: Radii in metres.
        stands: True if it stands.

    Returns:
        In metres.
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
    """Have a layout place groups as if each were one large pedestrian, and the members in them.

    A group that stands is then somewhere on its way, clear of all starts and goals, and has arrived.

    Args:
        layout: Places so many agents of these radii in metres and speeds in m/s.
        leader: The first one in the group of each pedestrian; the members of a group follow each other.
        radius: Radii in metres, the vehicle first.
        preferred_speed: In m/s.
        stands: Which pedestrians stand.
        stream: The random stream for the places of those who stand.

    Raises:
        InputError: The layout returns no placement.
    """
    group = np.unique(np.append(0, leader + 1), return_inverse=True)[1]
    groups = [np.flatnonzero(group == number) for number in range(group.max() + 1)]
    reach = np.array([group_reach(radius[members]) for members in groups])
    leaders = [members[0] for members in groups]
    placement = check_finite(check_shape(layout(reach, preferred_speed[leaders]), len(groups)))
    ahead = placement.goal - placement.start
    offset = np.concatenate([spread(ahead[number], radius[members], False) for number, members in enumerate(groups)])
    start, goal = placement.start[group] + offset, placement.goal[group] + offset
    route = None if placement.route is None else placement.route[group]
    obstacles = np.empty((0, 0, 2)) if placement.obstacles is None else placement.obstacles
    for number, members in enumerate(groups[1:], 1):
        if stands[members[0] - 1]:
            others = group != number
            room = Room(start[others], goal[others], radius[others], preferred_speed[others], obstacles)
            points = placement.start[number] + stream.random(TRIES)[:, None] * ahead[number]
            clear = (point for point in points if room.is_clear(point, float(reach[number])))
            middle = next(clear, placement.start[number])
            start[members] = goal[members] = middle + spread(ahead[number], radius[members], True)
            if route is not None:
                route[members] = np.nan
    return Placement(start, goal, route, placement.obstacles)


def _spacing(radius: Float[np.ndarray, "member"]) -> float:
    """Return the distance in metres between the centres of neighbours."""
    return 2 * float(radius.max()) + GAP
