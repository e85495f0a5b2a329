"""Optimal reciprocal collision avoidance, ORCA (van den Berg et al. 2011), compiled.

Equations and sections are those of the paper, the current velocity is its optimization velocity (section 5.2).

For each neighbour, an agent may only take velocities in a half-plane of the velocity space (equations 5 and 6). Among
the velocities that all half-planes and the speed limit permit, it takes the one nearest to its preferred velocity: a
linear program in two dimensions (section 5.1). If there is none, a linear program in three dimensions finds the
velocity whose largest distance beyond a half-plane is smallest (section 5.3).

The half-planes and the linear programs are in `linear_program`.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Shaped

from crowdbench.sim import neighbors
from crowdbench.sim.kernels import at, per_agent, serial_and_parallel, writable
from crowdbench.sim.neighbors import nearest_in_cells, nearest_of_all
from crowdbench.sim.pedestrians.linear_program import least_violation, nearest_permitted, unit
from crowdbench.sim.pedestrians.orca_obstacles import EDGE, edge_half_planes, fill_edges, nearest_edges
from crowdbench.utils.compiled import njit, prange

PARALLEL_AGENTS = 400
"""Batches with at least this many agents run on several threads, whose start takes 110 microseconds."""

_BLOCKS = 64
"""Agents are divided among threads in at most this many blocks. Each block allocates its working memory once."""

_BLOCK_AGENTS = 32
"""A world is divided only into blocks of at least this many agents."""

_EVERYBODY = np.ones((1, 1), np.bool_)
_NO_OBSTACLES = np.empty((1, 0, 0, 2))

_TINY = 1e-9
"""Smallest time horizon in seconds, in place of 0, with which only overlapping agents avoid each other."""


def orca_velocities(
    position: Float[np.ndarray, "world agent 2"],
    velocity: Float[np.ndarray, "world agent 2"],
    preferred_velocity: Float[np.ndarray, "world agent 2"],
    radius: Float[np.ndarray, "world agent"],
    max_speed: Float[np.ndarray, "world agent"],
    *,
    time_step: float = 0.25,
    neighbor_distance: float | Float[np.ndarray, "world agent"] = 10.0,
    max_neighbors: int | Shaped[np.ndarray, "..."] = 10,
    time_horizon: float | Float[np.ndarray, "world agent"] = 5.0,
    obstacles: Float[np.ndarray, "_ polygon corner 2"] | None = None,
    time_horizon_obst: float | Float[np.ndarray, "world agent"] = 5.0,
    line_of_sight: float | Shaped[np.ndarray, "..."] = False,
    seen: Bool[np.ndarray, "world agent"] | None = None,
    moves: Bool[np.ndarray, "world agent"] | None = None,
) -> Float[np.ndarray, "world agent 2"]:
    """The velocity that each agent takes next.

    Args:
        position: Centres in metres.
        velocity: Current velocities in m/s.
        preferred_velocity: Velocities in m/s that the agents would take if they were alone.
        radius: Radii in metres. No safety margin is added to them.
        max_speed: Largest speeds in m/s.
        time_step: Length of a step in seconds. Agents that overlap part within one step.
        neighbor_distance: Agents whose centres are at least this far away, in metres, are not avoided.
        max_neighbors: An agent avoids at most this many, the nearest ones: one number, or one per world or agent.
        time_horizon: The paper's tau: an agent avoids collisions that would happen within this time, in seconds.
        obstacles: Polygons in metres of each world, or one for all, see `crowdbench.sim.pedestrians.orca_obstacles`.
        time_horizon_obst: An agent avoids collisions with obstacles that would happen within this time, in seconds.
        line_of_sight: Whether an agent avoids only those that no obstacle hides: the straight line between the centres
            crosses none. RVO2 avoids others through walls. One value, or one per world or agent.
        seen: Whether the agent is avoided by the others; all are if None.
        moves: Whether the agent's velocity is computed; all are if None.

    Returns:
        Velocities in m/s; 0 for agents that do not move.
    """
    agents = tuple(map(writable, (position, velocity, preferred_velocity, radius, max_speed)))
    visible, mobile = (_EVERYBODY if each is None else writable(each) for each in (seen, moves))
    walls = _NO_OBSTACLES if obstacles is None else writable(obstacles)
    # The whole numbers as those of scenarios are, so that the same compiled kernels serve both.
    neighbors_avoided, only_visible = (per_agent(each, np.int64) for each in (max_neighbors, line_of_sight))
    distance, horizon, horizon_obst = map(per_agent, (neighbor_distance, time_horizon, time_horizon_obst))
    # Asked here too, because the call alone takes 4 % of a step of 6 agents.
    cells = None if radius.shape[1] < neighbors.CELLS_FROM else neighbors.cells_of(agents[0], visible)
    out = np.empty((*radius.shape, 2))
    compute = orca_parallel if radius.size >= PARALLEL_AGENTS else orca_serial
    limits = distance, neighbors_avoided, horizon, horizon_obst, only_visible
    compute(cells, out, *agents, visible, mobile, time_step, walls, *limits)
    return out


@no_type_check
def _orca(cells, out, *arrays):
    """The loop over worlds, compiled twice: for one thread and for all.

    Args:
        cells: `Cells`, or None: then each agent looks at all others.
        out: `[world, agent, 2]`, filled: velocities in m/s.
        *arrays: The arguments of `orca_velocities` in SI units. All after the obstacles, and who is seen and who moves,
            are read by `at`; one world's obstacles may stand for all.
    """
    # Not a NamedTuple: reading its fields would make ORCA a sixth slower.
    position, velocity, preferred, radius, max_speed, seen, moves = arrays[:7]
    time_step, obstacles, neighbor_distance, max_neighbors, time_horizon, time_horizon_obst, line_of_sight = arrays[7:]
    worlds, number = radius.shape
    # A world's edges are made once in each block, so that worlds are only divided where a block has many agents.
    blocks = min(max(worlds, worlds * number // _BLOCK_AGENTS), _BLOCKS)
    room = 0
    for most_neighbors in max_neighbors.flat:
        room = max(room, min(np.int64(most_neighbors), number))
    for block in prange(blocks):
        neighbor, distance = np.empty(room, np.int64), np.empty(room)
        most = obstacles.shape[1] * obstacles.shape[2]
        lines, scratch = np.empty((room + most, 4)), np.empty((room + most, 4))
        edges, order, apart = np.empty((most, EDGE)), np.empty(most, np.int64), np.empty(most)
        # The index of a prange is unsigned, which would turn the bounds into floats.
        begin = np.int64(block) * (worlds * number) // blocks
        end = (np.int64(block) + 1) * (worlds * number) // blocks
        for w in range(begin // number, (end + number - 1) // number):
            polygons = obstacles[min(w, len(obstacles) - 1)]
            edge_count = fill_edges(polygons, edges) if most > 0 else 0
            for i in range(max(begin - w * number, 0), min(end - w * number, number)):
                x, y = 0.0, 0.0
                if at(moves, w, i):
                    hard, speed = 0, max_speed[w, i]
                    if edge_count > 0:
                        horizon = at(time_horizon_obst, w, i)
                        px, py, size = position[w, i, 0], position[w, i, 1], radius[w, i]
                        near = nearest_edges(edges, edge_count, px, py, horizon * speed + size, order, apart)
                        vx, vy, rate = velocity[w, i, 0], velocity[w, i, 1], 1.0 / max(horizon, _TINY)
                        hard = edge_half_planes(edges, order, near, px, py, vx, vy, size, rate, lines)
                    reach, limit = at(neighbor_distance, w, i), np.int64(at(max_neighbors, w, i))
                    hides = edge_count > 0 and at(line_of_sight, w, i) != 0.0
                    # Not one condition: numba only leaves out a branch whose condition is None alone.
                    if cells is None:  # noqa: SIM114
                        n = nearest_of_all(w, i, position, seen, reach, limit, hides, polygons, neighbor, distance)
                    elif cells.size[w, 0] < 0:
                        n = nearest_of_all(w, i, position, seen, reach, limit, hides, polygons, neighbor, distance)
                    else:
                        n = nearest_in_cells(w, i, position, cells, reach, limit, hides, polygons, neighbor, distance)
                    horizon = at(time_horizon, w, i)
                    for k in range(n):
                        _half_plane(position, velocity, radius, w, i, neighbor[k], horizon, time_step, lines, hard + k)
                    n += hard
                    x, y = preferred[w, i, 0], preferred[w, i, 1]
                    failed, x, y = nearest_permitted(lines, n, speed, x, y, False)
                    if failed < n:
                        x, y = least_violation(lines, n, hard, failed, speed, x, y, scratch)
                out[w, i, 0], out[w, i, 1] = x, y


orca_serial, orca_parallel = serial_and_parallel(_orca)


@no_type_check
@njit(error_model="numpy", inline="always")
def _half_plane(position, velocity, radius, w, i, j, time_horizon, time_step, lines, k):
    """Write line k: the velocities that agent i of world w may take because of its neighbour j (equation 6, figure 2).

    The velocity obstacle, in relative velocities, is a cone with a round tip (equation 2). The line goes through
    the agent's velocity plus half of u, the smallest change of the relative velocity that leads out of it (equation 5).

    Args:
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, in m/s.
        radius: `[world, agent]`, in metres.
        w, i, j: Indices of the world, of the agent and of the neighbour.
        time_horizon: Avoid collisions within this time, in seconds.
        time_step: Length of a step in seconds.
        lines: `[line, 4]`, of which row k is filled.
        k: Index of the line.
    """
    px, py, qx, qy = position[w, i, 0], position[w, i, 1], position[w, j, 0], position[w, j, 1]
    vx, vy, ux, uy = velocity[w, i, 0], velocity[w, i, 1], velocity[w, j, 0], velocity[w, j, 1]
    dx, dy = qx - px, qy - py
    rx, ry = vx - ux, vy - uy
    reach = radius[w, i] + radius[w, j]
    squared = dx * dx + dy * dy
    overlapping = squared <= reach * reach
    # Agents that overlap must part within the step.
    rate = 1.0 / (time_step if overlapping else max(time_horizon, _TINY))
    wx, wy = rx - rate * dx, ry - rate * dy
    dot = wx * dx + wy * dy
    if overlapping or (dot < 0.0 and dot * dot > reach * reach * (wx * wx + wy * wy)):
        nx, ny, length = unit(wx, wy)
        cx, cy = ny, -nx
        depth = reach * rate - length
        sx, sy = depth * nx, depth * ny
    else:
        # The legs of the cone are the direction to the neighbour, turned by half the angle of the cone. The right one
        # points back to the tip, so that what is permitted lies to its left.
        side = 1.0 if _passes_left(px, py, vx, vy, qx, qy, ux, uy, rate) else -1.0
        leg, scale = side * math.sqrt(squared - reach * reach), 1.0 / squared
        cx, cy = (dx * leg - dy * reach) * scale, (dx * reach + dy * leg) * scale
        along = rx * cx + ry * cy
        sx, sy = along * cx - rx, along * cy - ry
    lines[k, 0], lines[k, 1] = vx + 0.5 * sx, vy + 0.5 * sy
    lines[k, 2], lines[k, 3] = cx, cy


@no_type_check
@njit(error_model="numpy", inline="always")
def _passes_left(px, py, vx, vy, qx, qy, ux, uy, rate):
    """Whether the nearer leg of the cone is the left one.

    Computed in float32, as in RVO2: for two agents that walk straight at each other both legs are equally near, and
    rounding decides on which side they pass.

    Args:
        px, py: Position of the agent in metres.
        vx, vy: Velocity of the agent in m/s.
        qx, qy: Position of the neighbour in metres.
        ux, uy: Velocity of the neighbour in m/s.
        rate: 1 over the time in which they must avoid each other, in 1/s.
    """
    dx, dy = np.float32(qx) - np.float32(px), np.float32(qy) - np.float32(py)
    wx = np.float32(vx) - np.float32(ux) - np.float32(rate) * dx
    wy = np.float32(vy) - np.float32(uy) - np.float32(rate) * dy
    return dx * wy - dy * wx > np.float32(0.0)
