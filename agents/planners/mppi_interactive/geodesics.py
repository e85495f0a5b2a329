"""Candidate goals on a grid, and for each one the next point on the shortest way to it, from anywhere among walls.

The ways lead over a visibility graph of points beside the corners of obstacles (Lozano-Pérez and Wesley 1979). A table
has the next point for each cell of a fine grid and each candidate.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import dijkstra

CELL = 0.25
"""Side of the cells of the tables, at most, in metres."""

SPACING = 1.25
"""Distance between neighbouring candidates, at most, in metres."""

BESIDE = 0.3
"""Distance of candidates from walls, and of the points of ways from the corners of obstacles, in metres."""

ROOM = 0.2
"""Smallest distance of the points of ways from walls, in metres."""

OPEN = 8.0
"""Without walls, candidates lie up to so many metres beyond the agents and the vehicle's goal."""

REACHED = 0.35
"""At this distance in metres the way leads on from a point."""

AHEAD = 2.0
"""Points on ways are at least so far away, in metres, since walkers slow down in the last metre to theirs."""

DIRECTIONS = 8
"""Number of points of ways around each corner."""

STRAIGHT = -1
"""The entry of a table where the way leads straight to the candidate."""

Points = Float[np.ndarray, "point 2"]


@dataclasses.dataclass(frozen=True)
class Geodesics:
    """Candidates and shortest ways in the worlds of a batch.

    Attributes:
        goal: The candidates in metres; zeros after the last one.
        exists: Which entries of `goal` are candidates.
        corner: The points that ways lead over, in metres; zeros after the last one.
        low: The lowest corner of the grid of cells in metres.
        side: The sides of its cells in metres.
        size: Its number of columns and rows.
        table: For each candidate and cell, the index of the next point in `corner`, or `STRAIGHT`.
        layout: The index in `table` of each world. Worlds with the same walls share a table.
    """

    goal: Float[np.ndarray, "world goal 2"]
    exists: Bool[np.ndarray, "world goal"]
    corner: Float[np.ndarray, "world corner 2"]
    low: Float[np.ndarray, "world 2"]
    side: Float[np.ndarray, "world 2"]
    size: Int[np.ndarray, "world 2"]
    table: Int[np.ndarray, "layout goal cell"]
    layout: Int[np.ndarray, "world"]

    def ahead(
        self,
        row: Int[np.ndarray, "row"],
        position: Float[np.ndarray, "row #goal pedestrian 2"],
        goal: Int[np.ndarray, "row goal #pedestrian"],
    ) -> Float[np.ndarray, "row goal pedestrian 2"]:
        """Return points to walk to from positions, in the direction of the ways to candidates, in metres.

        Args:
            row: The world of each row.
            position: Positions in metres.
            goal: Indices of candidates.
        """
        row = row[:, None, None]
        cell = ((position - self.low[row]) / self.side[row]).astype(np.int64).clip(0, self.size[row] - 1)
        after = self.table[self.layout[row], goal, cell[..., 0] * self.size[row][..., 1] + cell[..., 1]]
        way = self.corner[row, after] - position
        farther = np.maximum(AHEAD / np.maximum(np.hypot(way[..., 0], way[..., 1]), 1e-9), 1.0)
        return np.where((after == STRAIGHT)[..., None], self.goal[row, goal], position + way * farther[..., None])


def find_geodesics(
    obstacles: Float[np.ndarray, "world polygon corner 2"], points: Float[np.ndarray, "world point 2"]
) -> Geodesics:
    """Place candidates in worlds, and find the ways to them.

    Args:
        obstacles: Polygons in metres, NaN after the last corner of each; two corners are a wall.
        points: Where the vehicle is, and any others that limit the grid where there are no walls, in metres; NaN for
            none.
    """
    index: dict[bytes, int] = {}
    found: list[tuple[np.ndarray, ...]] = []
    layout = []
    for walls, agents in zip(obstacles, points, strict=True):
        polygons = [corners[np.isfinite(corners[:, 0])] for corners in walls]
        polygons = [corners for corners in polygons if len(corners)]
        key = b";".join(corners.tobytes() for corners in polygons) if polygons else agents.tobytes()
        if key not in index:
            index[key] = len(found)
            found.append(_among_walls(polygons, agents[0]) if polygons else _in_the_open(agents))
        layout.append(index[key])
    goal, corner, table, low, side, size = map(_pad, zip(*found, strict=True))
    exists = np.arange(goal.shape[1]) < np.array([len(each[0]) for each in found])[:, None]
    goal, exists, corner, low, side, size = (each[layout] for each in (goal, exists, corner, low, side, size))
    return Geodesics(goal, exists, corner, low, side, size, table, np.array(layout))


def _in_the_open(agents: Points) -> tuple[np.ndarray, ...]:
    """Return what `_among_walls` does where all ways are straight."""
    low, high = np.nanmin(agents, axis=0) - OPEN, np.nanmax(agents, axis=0) + OPEN
    goal, _ = _grid(low, high, SPACING)
    return goal, np.zeros((1, 2)), np.full((len(goal), 1), STRAIGHT, np.int16), low, high - low, np.ones(2, np.int64)


def _among_walls(polygons: Sequence[Points], vehicle: Points) -> tuple[np.ndarray, ...]:
    """Return the fields of `Geodesics` of one world: candidates, corners, table, low, side and size."""
    walls = shapely.union_all([shapely.LineString(p) if len(p) == 2 else shapely.Polygon(p) for p in polygons])
    corners = np.unique(np.concatenate(polygons), axis=0)
    low, high = corners.min(axis=0), corners.max(axis=0)
    goal, _ = _grid(low, high, SPACING)
    goal = goal[shapely.distance(shapely.points(goal), walls) > BESIDE]
    angle = (np.arange(DIRECTIONS) + 0.5) * (2.0 * np.pi / DIRECTIONS)
    node = (corners[:, None] + BESIDE * np.stack([np.cos(angle), np.sin(angle)], axis=1)).reshape(-1, 2)
    node = node[shapely.distance(shapely.points(node), walls) > ROOM]
    edges = np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in polygons])
    between, last = _straight(node, node, edges), _straight(node, goal, edges)
    np.fill_diagonal(between, np.inf)
    to_goal = (dijkstra(np.where(np.isfinite(between), between, 0.0))[:, :, None] + last).min(axis=1, initial=np.inf)
    from_vehicle = (_straight(vehicle[None], node, edges)[0][:, None] + to_goal).min(axis=0, initial=np.inf)
    reachable = np.isfinite(np.minimum(from_vehicle, _straight(vehicle[None], goal, edges)[0]))
    goal, to_goal, last = goal[reachable], to_goal[:, reachable], last[:, reachable]
    cell, size = _grid(low, high, CELL)
    to_node, straight = _straight(cell, node, edges), _straight(cell, goal, edges)
    table = np.full((len(goal), len(cell)), STRAIGHT, np.int16)
    for g in range(len(goal)):
        table[g] = _next(to_node, to_goal[:, g], straight[:, g])
        following = _next(between, to_goal[:, g], last[:, g])
        reached = (table[g] != STRAIGHT) & (to_node[np.arange(len(cell)), table[g]] < REACHED)
        table[g] = np.where(reached, following[table[g]], table[g])
    return goal, node, table, low, (high - low) / size, size


def _next(
    to_node: Float[np.ndarray, "start node"], to_goal: Float[np.ndarray, "node"], straight: Float[np.ndarray, "start"]
) -> Int[np.ndarray, "start"]:
    """Return the node over which the way from each start is shortest, or `STRAIGHT`."""
    over = to_node + to_goal
    best = over.argmin(axis=1)
    return np.where(over[np.arange(len(over)), best] < straight, best, STRAIGHT)


def _grid(low: Points, high: Points, spacing: float) -> tuple[Points, Int[np.ndarray, "2"]]:
    """Return the middles of the cells of a grid over a box, column by column, and the number of columns and rows."""
    size = np.maximum(np.ceil((high - low) / spacing), 1.0).astype(np.int64)
    index = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1).reshape(-1, 2)
    return low + (index + 0.5) / size * (high - low), size


def _straight(start: Points, end: Points, edges: Float[np.ndarray, "edge 2 2"]) -> Float[np.ndarray, "start end"]:
    """Return the lengths of straight ways in metres, infinite where an edge crosses them."""
    corners, index = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    way = end - start[:, None]
    sides = [_cross(way, (corner - start)[:, None]) for corner in corners]  # where each corner lies from each way
    left, right = [side > 0.0 for side in sides], [side < 0.0 for side in sides]
    length = np.hypot(way[..., 0], way[..., 1])
    for (a, b), (i, j) in zip(edges, index.reshape(-1, 2), strict=True):
        s, e = _cross(b - a, start - a)[:, None], _cross(b - a, end - a)
        parted = ((s < 0.0) & (e > 0.0)) | ((s > 0.0) & (e < 0.0))
        length[parted & ((left[i] & right[j]) | (right[i] & left[j]))] = np.inf
    return length


def _cross(one: Float[np.ndarray, "*#n 2"], other: Float[np.ndarray, "*#n 2"]) -> Float[np.ndarray, "*n"]:
    """Return the cross products of vectors, positive where the second one is to the left of the first."""
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def _pad(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return arrays in one, each followed by zeros."""
    padded = np.zeros((len(arrays), *np.max([each.shape for each in arrays], axis=0)), arrays[0].dtype)
    for row, each in zip(padded, arrays, strict=True):
        row[tuple(map(slice, each.shape))] = each
    return padded
