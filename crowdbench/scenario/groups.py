"""People who belong together: the sizes of groups, and where their members are."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.scenario.placement import PerAgent, Placement, Position, Way, check_finite, check_shape
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
    """The number of each one's group, -1 for who is alone, by the first one in the group of each."""
    return np.where(np.bincount(leader, minlength=1)[leader] > 1, leader, -1)


def group_reach(radius: Float[np.ndarray, "member"]) -> float:
    """Radius in metres of a disc that holds a group, whether it walks or stands."""
    return float(radius.max()) + _spacing(radius) * (len(radius) - 1) / 2


def spread(ahead: Position, radius: Float[np.ndarray, "member"], stands: bool) -> Float[np.ndarray, "member 2"]:
    """Where the members of a group are, from its middle: side by side if it walks, in a circle if it stands.

    Args:
        ahead: The direction in which it walks, of any length.
        radius: Radii in metres.
        stands: Whether it stands.

    Returns:
        In metres.
    """
    n, spacing, heading = len(radius), _spacing(radius), math.atan2(ahead[1], ahead[0])
    place = np.arange(n)
    if stands and n > 1:
        angle = heading + 2 * np.pi * place / n
        return spacing / (2 * math.sin(math.pi / n)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    aside = spacing * (place - (n - 1) / 2)
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
        leader: The first one in the group of each pedestrian.
        radius: Radii in metres, the vehicle first.
        preferred_speed: In m/s.
        stands: Which pedestrians stand.
        stream: The random stream for the places of those who stand.

    Raises:
        InputError: What the layout returns is no placement.
    """
    everybody = [np.zeros(1, np.int64), *(np.flatnonzero(leader == first) + 1 for first in np.unique(leader))]
    leaders = [members[0] for members in everybody]
    reach = np.array([group_reach(radius[each]) for each in everybody])
    placement = check_finite(check_shape(layout(reach, preferred_speed[leaders]), len(leaders)))
    start, goal = (np.empty((len(radius), 2)) for _ in range(2))
    route = None if placement.route is None else np.empty((len(radius), *placement.route.shape[1:]))
    for number, members in enumerate(everybody):
        offsets = spread(placement.goal[number] - placement.start[number], radius[members], False)
        start[members], goal[members] = placement.start[number] + offsets, placement.goal[number] + offsets
        if route is not None and placement.route is not None:
            route[members] = placement.route[number]
    obstacles = np.empty((0, 0, 2)) if placement.obstacles is None else placement.obstacles
    for number, members in enumerate(everybody[1:], 1):
        if stands[members[0] - 1]:
            others = np.setdiff1d(np.arange(len(radius)), members)
            room = Room(start[others], goal[others], radius[others], preferred_speed[others], obstacles)
            way = placement.start[number], placement.goal[number]
            middle, ahead = _draw_on_way(way, group_reach(radius[members]), room, stream), way[1] - way[0]
            start[members] = goal[members] = middle + spread(ahead, radius[members], True)
            if route is not None:
                route[members] = np.nan
    return Placement(start, goal, route, placement.obstacles)


def _draw_on_way(way: Way, radius: float, room: Room, stream: np.random.Generator) -> Position:
    """A clear point in metres between start and goal; the start where none is found."""
    start, goal = way
    for share in stream.random(TRIES):
        point = start + share * (goal - start)
        if room.is_clear(point, radius):
            return point
    return start


def _spacing(radius: Float[np.ndarray, "member"]) -> float:
    """Distance in metres between the centres of neighbours."""
    return 2 * float(radius.max()) + GAP
