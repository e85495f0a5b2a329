"""The neighbours of an agent: the nearest others within its reach, among all or from cells. Compiled.

Both searches find the same neighbours in the same order: by distance, and by index if distances are equal.

The cells are squares of a grid, as in the cell lists of molecular dynamics. The search covers the cells around an
agent, ring by ring, until the remaining cells are too far away.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.sim.kernels import at, in_blocks
from crowdbench.sim.obstacles import touches_in_step
from crowdbench.utils.compiled import njit

CELLS_FROM = 128
"""Smallest number of agents of a world with cells. In smaller worlds, a search among all agents takes no longer."""

_PER_CELL = 2.0
"""Agents of a cell, on average. With 5 the search takes a tenth longer, with 1 as long."""

_SPREAD = 1.8
"""Half the length of the grid in standard deviations of the positions: slightly more than for evenly spread agents.
Agents farther away belong to the cell at the border, so that a few outliers do not enlarge the cells."""

_SLACK = 1e-6
"""Tolerance of rounding, in lengths of a cell."""


class Cells(NamedTuple):
    """The cells of worlds, as `nearest_in_cells` takes them.

    Attributes:
        corner: The lowest corner of the grid in metres.
        length: Length of a cell's side in metres.
        size: Columns and rows of the grid: 1 and 1 if no agent is seen, or a position is not finite.
        first: Index in `member` at which each cell begins; cells are counted by rows.
        member: Indices of the agents, by cells.
        point: Positions of these agents in metres.
    """

    corner: Float[np.ndarray, "world 2"]
    length: Float[np.ndarray, "world"]
    size: Int[np.ndarray, "world 2"]
    first: Int[np.ndarray, "world cell"]
    member: Int[np.ndarray, "world agent"]
    point: Float[np.ndarray, "world agent 2"]


def cells_of(position: Float[np.ndarray, "world agent 2"], seen: Bool[np.ndarray, "_ _"]) -> Cells | None:
    """Put the agents of worlds into cells.

    Args:
        position: In metres.
        seen: True if each agent can be a neighbour, read by `at`.

    Returns:
        The cells; None for worlds with less than `CELLS_FROM` agents.
    """
    return make_cells(position, seen) if position.shape[1] >= CELLS_FROM else None


def make_cells(position: Float[np.ndarray, "world agent 2"], seen: Bool[np.ndarray, "_ _"]) -> Cells:
    """Put the agents of worlds of any size into cells, see `cells_of`."""
    worlds, agents = position.shape[:2]
    corner, length, size = np.empty((worlds, 2)), np.empty(worlds), np.empty((worlds, 2), np.int64)
    first, member = np.empty((worlds, agents + 2), np.int64), np.empty((worlds, agents), np.int64)
    cells = Cells(corner, length, size, first, member, np.empty((worlds, agents, 2)))
    in_blocks(lambda begin, end: _fill_cells(begin, end, position, seen, *cells), worlds, 1, worlds)
    return cells


@no_type_check
@njit(error_model="numpy", nogil=True)
def _fill_cells(begin, end, position, seen, corner, length, size, first, member, point):
    """Fill the arrays of `Cells` for a block of worlds, see `cells_of`."""
    agents = position.shape[1]
    for w in range(begin, end):
        n, columns, rows = _lay(w, position, seen, corner, length)
        size[w, 0], size[w, 1] = columns, rows
        for cell in range(columns * rows + 1):
            first[w, cell] = 0
        cell_of = np.empty(agents, np.int64)
        for j in range(agents):
            if at(seen, w, j):
                column = _index(position[w, j, 0] - corner[w, 0], length[w], columns)
                row = _index(position[w, j, 1] - corner[w, 1], length[w], rows)
                cell_of[j] = row * columns + column
                first[w, cell_of[j] + 1] += 1
        for cell in range(columns * rows):
            first[w, cell + 1] += first[w, cell]
        # Backwards: `first` moves from the end of each cell to its beginning, and the agents keep their order.
        for k in range(agents):
            j = agents - 1 - k
            if at(seen, w, j):
                first[w, cell_of[j] + 1] -= 1
                slot = first[w, cell_of[j] + 1]
                member[w, slot], point[w, slot, 0], point[w, slot, 1] = j, position[w, j, 0], position[w, j, 1]
        for cell in range(columns * rows):
            first[w, cell] = first[w, cell + 1]
        first[w, columns * rows] = n


@no_type_check
@njit
def _lay(w, position, seen, corner, length):
    """Lay the grid of world w over the agents that are seen.

    Args:
        w: Index of the world.
        position: `[world, agent, 2]`, in metres.
        seen: True if each agent is seen, read by `at`.
        corner: `[world, 2]`, of which row w is filled, in metres.
        length: `[world]`, of which element w is filled, in metres.

    Returns:
        The numbers of seen agents, columns and rows. One cell contains all agents if a position is not finite.
    """
    n = 0
    low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
    sum_x, sum_y, square_x, square_y, x0, y0 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(position.shape[1]):
        if at(seen, w, j):
            if n == 0:
                x0, y0 = position[w, j, 0], position[w, j, 1]
            x, y = position[w, j, 0] - x0, position[w, j, 1] - y0
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
            sum_x, sum_y, square_x, square_y = sum_x + x, sum_y + y, square_x + x * x, square_y + y * y
            n += 1
    if n == 0 or not math.isfinite(square_x + square_y):
        corner[w, 0], corner[w, 1], length[w] = 0.0, 0.0, 1.0
        return n, 1, 1
    middle_x, middle_y = sum_x / n, sum_y / n
    half_x = _SPREAD * math.sqrt(max(square_x / n - middle_x * middle_x, 0.0))
    half_y = _SPREAD * math.sqrt(max(square_y / n - middle_y * middle_y, 0.0))
    low_x, high_x = max(low_x, middle_x - half_x), min(high_x, middle_x + half_x)
    low_y, high_y = max(low_y, middle_y - half_y), min(high_y, middle_y + half_y)
    width, height = max(high_x - low_x, 0.0), max(high_y - low_y, 0.0)
    side = max(math.sqrt(width * height * _PER_CELL / n), max(width, height) * _PER_CELL / n)
    if not side > 0.0:
        side = 1.0
    columns, rows = int(width / side) + 1, int(height / side) + 1
    while columns * rows > position.shape[1]:
        side *= 1.5
        columns, rows = int(width / side) + 1, int(height / side) + 1
    corner[w, 0], corner[w, 1], length[w] = x0 + low_x, y0 + low_y, side
    return n, columns, rows


@no_type_check
@njit(error_model="numpy", forceinline=True)
def _index(distance, length, number):
    """Return the index of the column or row at a distance from the grid's corner, clipped to the grid.

    Args:
        distance: In metres; not finite only if there is one cell.
        length: Length of a cell's side in metres.
        number: Number of columns or rows.
    """
    return np.int64(min(max(distance / length, 0.0), number - 1.0)) if number > 1 else np.int64(0)


@no_type_check
@njit(error_model="numpy", forceinline=True)
def insert_sorted(j, squared, n, limit, neighbor, distance):
    """Insert an item into a list sorted by distance, and by index if distances are equal.

    Args:
        j (int): Index of the item; if the list is full, it must come before the last one.
        squared (float): The squared distance.
        n (int): Length of the list.
        limit (int): Its largest length, above 0; the last item of a full list is dropped.
        neighbor (array): The indices.
        distance (array): The squared distances.

    Returns:
        n (int): Its length now.
    """
    slot = n if n < limit else n - 1
    while slot > 0 and (squared < distance[slot - 1] or (squared == distance[slot - 1] and j < neighbor[slot - 1])):
        neighbor[slot], distance[slot] = neighbor[slot - 1], distance[slot - 1]
        slot -= 1
    neighbor[slot], distance[slot] = j, squared
    return min(n + 1, limit)


@no_type_check
@njit(error_model="numpy", nogil=True)
def find_neighbors(begin, end, position, moves, cells, avoidance, obstacles, neighbor, number):
    """Find the neighbours of a block of agents from cells; obstacles may hide some.

    Args:
        begin (int): The first agent, counted through all worlds.
        end (int): The one after the last.
        position (array): `[world, agent, 2]`, in metres.
        moves (array): True if the agent has neighbours, read by `at`.
        cells (Cells): The cells of the agents.
        avoidance (tuple): The fields of `crowdbench.sim.pedestrians.orca.Avoidance`.
        obstacles (array): `[world, polygon, corner, 2]`, in metres; or the array of one world for all.
        neighbor (array): `[agent * most]`, filled: indices of the neighbours of each agent, nearest first.
        number (array): `[agent]`, filled: how many there are.
    """
    reach, limit, _, _, line_of_sight = avoidance
    agents, most = position.shape[1], len(neighbor) // len(number)
    distance, nearest = np.empty(most), np.empty(most, np.int64)
    for w in range(begin // agents, (end + agents - 1) // agents):
        # A copy: threads would wait for each other to count the references to slices of the same array.
        polygons = obstacles[min(w, len(obstacles) - 1)].copy()
        for i in range(max(begin - w * agents, 0), min(end - w * agents, agents)):
            k = w * agents + i - begin
            number[k] = 0
            if not at(moves, w, i):
                continue
            hiding = polygons if at(line_of_sight, w, i) != 0.0 else polygons[:0]
            far, room = at(reach, w, i), np.int64(at(limit, w, i))
            number[k] = nearest_in_cells(w, i, position, cells, far, room, hiding, nearest, distance)
            for m in range(number[k]):
                neighbor[k * most + m] = nearest[m]


@no_type_check
@njit(error_model="numpy")
def nearest_in_cells(w, i, position, cells, reach, limit, polygons, neighbor, distance):
    """Find the neighbours of an agent from cells.

    Args:
        w (int): Index of the world.
        i (int): Index of the agent.
        position (array): `[world, agent, 2]`, in metres.
        cells (tuple): The `Cells`.
        reach (float): Neighbours are nearer than this, in metres.
        limit (int): Largest number of neighbours.
        polygons (array or None): `[polygon, corner, 2]`, obstacles that hide others, in metres.
        neighbor (array): `[agent]`, filled: indices of the neighbours, nearest first.
        distance (array): `[agent]`, filled: squared distances in square metres.

    Returns:
        n (int): The number of neighbours.
    """
    n = np.int64(0)  # with a literal, `insert_sorted` would be compiled twice
    if limit == 0:
        return n
    corner, length, size, first, member, point = cells
    # The bound on neighbours: their squared distance, and their index if distances are equal.
    farthest, last = reach * reach, -1
    x, y, side, columns, rows = position[w, i, 0], position[w, i, 1], length[w], size[w, 0], size[w, 1]
    to_x, to_y = x - corner[w, 0], y - corner[w, 1]
    column, row = _index(to_x, side, columns), _index(to_y, side, rows)
    ring = 1
    while True:
        left, right = max(column - ring, 0), min(column + ring, columns - 1)
        bottom, top = max(row - ring, 0), min(row + ring, rows - 1)
        for r in range(bottom, top + 1):
            # The cells of a row follow each other. Of the inner rows, all but the two outermost cells are done.
            is_whole = ring == 1 or r == row - ring or r == row + ring
            for part in range(1 if is_whole else 2):
                begin, end = left, right
                if not is_whole:
                    begin = column - ring if part == 0 else column + ring
                    end = begin
                    if begin < 0 or end >= columns:
                        continue
                for s in range(first[w, r * columns + begin], first[w, r * columns + end + 1]):
                    dx, dy = point[w, s, 0] - x, point[w, s, 1] - y
                    squared = dx * dx + dy * dy
                    if squared > farthest:
                        continue
                    j = member[w, s]
                    if j == i or (squared == farthest and j > last):
                        continue
                    if polygons is not None and len(polygons) > 0 and touches_in_step(x, y, dx, dy, 0.0, polygons):
                        continue
                    n = insert_sorted(j, squared, n, limit, neighbor, distance)
                    if n == limit:
                        farthest, last = distance[n - 1], neighbor[n - 1]
        # Distance to the nearest remaining cells on each of the four sides, infinite if there are none.
        west = to_x - left * side if left > 0 else np.inf
        east = (right + 1) * side - to_x if right < columns - 1 else np.inf
        south = to_y - bottom * side if bottom > 0 else np.inf
        north = (top + 1) * side - to_y if top < rows - 1 else np.inf
        away = min(west, east, south, north) - _SLACK * side
        if away == np.inf or (away > 0.0 and away * away > farthest):
            return n
        ring += 1


@no_type_check
@njit(error_model="numpy", forceinline=True)
def nearest_of_all(w, i, position, seen, reach, limit, neighbor, distance):
    """Find the neighbours of an agent among all others.

    Args:
        w (int): Index of the world.
        i (int): Index of the agent.
        position (array): `[world, agent, 2]`, in metres.
        seen (array): True if each agent can be a neighbour, read by `at`.
        reach (float): Neighbours are nearer than this, in metres.
        limit (int): Largest number of neighbours.
        neighbor (array): `[agent]`, filled: indices of the neighbours, nearest first.
        distance (array): `[agent]`, filled: squared distances in square metres.

    Returns:
        n (int): The number of neighbours.
    """
    n = np.int64(0)  # see `nearest_in_cells`
    reach_squared = reach * reach
    for j in range(position.shape[1]):
        if j == i or not at(seen, w, j):
            continue
        dx, dy = position[w, j, 0] - position[w, i, 0], position[w, j, 1] - position[w, i, 1]
        squared = dx * dx + dy * dy
        if squared >= reach_squared or limit == 0:
            continue
        n = insert_sorted(j, squared, n, limit, neighbor, distance)
        if n == limit:
            reach_squared = distance[n - 1]
    return n
