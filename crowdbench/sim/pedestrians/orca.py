"""Optimal reciprocal collision avoidance, ORCA (van den Berg et al. 2011), compiled.

Equations and sections refer to the paper; the current velocity is its optimization velocity (section 5.2).

For each neighbour, an agent may only take velocities in a half-plane of the velocity space (equations 5 and 6). Among
the velocities that all half-planes and the speed limit permit, it takes the one nearest to its preferred velocity: a
linear program in two dimensions (section 5.1). If there is none, a linear program in three dimensions finds the
velocity whose largest distance beyond a half-plane is smallest (section 5.3).

The half-planes and the linear programs are in `linear_program`.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Shaped

from crowdbench.core.arrays import AgentFlags, AgentNumbers, AgentPoints
from crowdbench.sim import neighbors
from crowdbench.sim.kernels import at, in_blocks, per_agent, writable
from crowdbench.sim.neighbors import find_neighbors, make_cells, nearest_of_all
from crowdbench.sim.pedestrians.linear_program import AS_VELOCITY, least_violation, nearest_permitted, unit
from crowdbench.sim.pedestrians.orca_obstacles import wall_lines
from crowdbench.utils.compiled import njit

BLOCK_AGENTS = 200, 1024
"""Smallest and largest number of agents of a block for a thread: the transfer to it takes about 50 microseconds."""

_EVERYBODY = np.ones((1, 1), np.bool_)
_NO_OBSTACLES = np.empty((1, 0, 0, 2))
_NO_LINES, _NOBODY = np.empty((0, 4)), np.empty(0, np.int64)
_NO_SPACE = np.zeros((1, 1))

_TINY = 1e-9
"""Smallest time horizon in seconds, in place of 0, with which only overlapping agents avoid each other."""


class Avoidance(NamedTuple):
    """The parameters of ORCA, which `at` reads. They are floats, so that kernels are compiled for one type.

    Attributes:
        neighbor_distance: In metres.
        max_neighbors: A whole number.
        time_horizon: In seconds.
        time_horizon_obst: In seconds.
        line_of_sight: 0 or 1.
    """

    neighbor_distance: Float[np.ndarray, "_ _"]
    max_neighbors: Float[np.ndarray, "_ _"]
    time_horizon: Float[np.ndarray, "_ _"]
    time_horizon_obst: Float[np.ndarray, "_ _"]
    line_of_sight: Float[np.ndarray, "_ _"]


class Agents(NamedTuple):
    """The agents of worlds as ORCA takes them.

    Attributes:
        position: Centres in metres.
        velocity: In m/s.
        preferred: Velocities in m/s that they would take if they were alone.
        radius: Radii for avoidance in metres.
        max_speed: In m/s.
        seen: True if the others avoid the agent, read by `at`.
        moves: True if its velocity is computed, read by `at`.
        space: Distance in metres that the agent adds to the sum of its radius and that of another agent whose velocity
            is computed, read by `at`. It may be negative.
    """

    position: AgentPoints
    velocity: AgentPoints
    preferred: AgentPoints
    radius: AgentNumbers
    max_speed: AgentNumbers
    seen: Bool[np.ndarray, "_ _"]
    moves: Bool[np.ndarray, "_ _"]
    space: Float[np.ndarray, "_ _"] = _NO_SPACE


def orca_velocities(
    position: AgentPoints,
    velocity: AgentPoints,
    preferred_velocity: AgentPoints,
    radius: AgentNumbers,
    max_speed: AgentNumbers,
    *,
    time_step: float = 0.25,
    neighbor_distance: float | AgentNumbers = 10.0,
    max_neighbors: int | Shaped[np.ndarray, "..."] = 10,
    time_horizon: float | AgentNumbers = 5.0,
    obstacles: Float[np.ndarray, "_ polygon corner 2"] | None = None,
    time_horizon_obst: float | AgentNumbers = 5.0,
    line_of_sight: float | Shaped[np.ndarray, "..."] = False,
    seen: AgentFlags | None = None,
    moves: AgentFlags | None = None,
) -> AgentPoints:
    """Compute the velocity that each agent takes next.

    Args:
        position: Centres in metres.
        velocity: Current velocities in m/s.
        preferred_velocity: Velocities in m/s that the agents would take if they were alone.
        radius: Radii in metres. No safety margin is added to them.
        max_speed: Largest speeds in m/s.
        time_step: Length of a step in seconds. Overlapping agents separate within one step.
        neighbor_distance: Agents whose centres are at least this far away, in metres, are not avoided.
        max_neighbors: An agent avoids at most this many, the nearest ones: one number, or one per world or agent.
        time_horizon: The paper's tau: an agent avoids collisions that would happen within this time, in seconds.
        obstacles: Polygons in metres of each world, or one for all, see `crowdbench.sim.pedestrians.orca_obstacles`.
        time_horizon_obst: An agent avoids collisions with obstacles that would happen within this time, in seconds.
        line_of_sight: True if an agent avoids only those that no obstacle hides: the straight line between the centres
            crosses none. RVO2 avoids others through walls. One value, or one per world or agent.
        seen: True if the agent is avoided by the others; all are if None.
        moves: True if the agent's velocity is computed; all are if None.

    Returns:
        Velocities in m/s; 0 for agents that do not move.
    """
    visible, mobile = (_EVERYBODY if array is None else writable(array) for array in (seen, moves))
    state = map(writable, (position, velocity, preferred_velocity, radius, max_speed))
    avoidance = neighbor_distance, max_neighbors, time_horizon, time_horizon_obst, line_of_sight
    walls = _NO_OBSTACLES if obstacles is None else writable(obstacles)
    crowd = Agents(*[*state, visible, mobile])
    return avoid(0, crowd, time_step, walls, Avoidance(*map(per_agent, avoidance)))


def avoid(
    first: int,
    crowd: Agents,
    time_step: float,
    obstacles: Float[np.ndarray, "_ polygon corner 2"],
    avoidance: Avoidance,
) -> Float[np.ndarray, "world moving 2"]:
    """Compute the velocities of agents in blocks, see `orca_velocities`.

    Parts that only some scenarios need are separate kernels, compiled at their first call: lines of walls, and
    neighbours from cells or by line of sight.

    Args:
        first: Index of the first agent whose velocity is computed.
        time_step: Length of a step in seconds.
        obstacles: Polygons in metres.

    Returns:
        Velocities in m/s of the agents from the first one on.
    """
    worlds, agents = crowd.radius.shape
    out, edges = np.empty((worlds, agents - first, 2)), obstacles.shape[1] * obstacles.shape[2]
    has_cells = agents >= neighbors.CELLS_FROM or (edges > 0 and avoidance.line_of_sight.any())
    cells = make_cells(crowd.position, crowd.seen) if has_cells else None
    room = 0 if cells is None else min(int(avoidance.max_neighbors.max(initial=0.0)), agents)

    fields, limits = tuple(crowd), avoidance[:3]  # plain tuples, because numba takes longer to receive named ones

    def compute(begin: int, end: int) -> None:
        walls, nearest = (_NO_LINES, _NOBODY), (_NOBODY, _NOBODY)
        if edges > 0:
            walls = np.empty(((end - begin) * edges, 4)), np.empty(end - begin, np.int64)
            wall_lines(begin, end, fields, avoidance.time_horizon_obst, obstacles, *walls)
        if cells is not None:
            nearest = np.empty((end - begin) * room, np.int64), np.empty(end - begin, np.int64)
            find_neighbors(begin, end, crowd.position, crowd.moves, cells, avoidance, obstacles, *nearest)
        avoid_block(begin, end, first, fields, time_step, limits, walls, nearest, out)

    in_blocks(compute, worlds * agents, *BLOCK_AGENTS)
    return out


@no_type_check
@njit(error_model="numpy", nogil=True)
def avoid_block(begin, end, first, crowd, time_step, limits, walls, nearest, out):
    """Compute the velocities of a block of agents.

    Args:
        begin (int): The first agent, counted through all worlds.
        end (int): The one after the last.
        first (int): Index of the first agent of a world whose velocity is computed.
        crowd (tuple): The fields of `Agents`.
        time_step (float): In seconds.
        limits (tuple): The first three fields of `Avoidance`.
        walls (tuple): For each agent of the block the lines of walls `[agent * most, 4]`, and how many there are; both
            are empty without walls.
        nearest (tuple): For each agent of the block its neighbours `[agent * most]`, and how many there are;
            both are empty if the neighbours are searched here.
        out (array): `[world, agent from first on, 2]`, filled: velocities in m/s.
    """
    # Unpacked, because reading fields by name in the loop would make ORCA a sixth slower.
    position, velocity, preferred, radius, max_speed, seen, moves, space = crowd
    reach, limit, horizon = limits
    (hard_lines, hard_number), (from_cells, cells_number) = walls, nearest
    agents = radius.shape[1]
    room = 0
    for number in limit.flat:
        room = max(room, min(np.int64(number), agents))
    most_hard, most = len(hard_lines) // max(len(hard_number), 1), len(from_cells) // max(len(cells_number), 1)
    neighbor, distance = np.empty(room, np.int64), np.empty(room)
    lines, scratch = np.empty((room + most_hard, 4)), np.empty((room + most_hard, 4))
    # Loops over worlds and their agents: a division of each index would take a tenth of the time.
    for w in range(begin // agents, (end + agents - 1) // agents):
        for i in range(max(begin - w * agents, first), min(end - w * agents, agents)):
            k = w * agents + i - begin
            out[w, i - first, 0], out[w, i - first, 1] = 0.0, 0.0
            if not at(moves, w, i):
                continue
            hard = hard_number[k] if len(hard_number) > 0 else 0
            for line in range(hard):
                for part in range(4):
                    lines[line, part] = hard_lines[k * most_hard + line, part]
            if len(cells_number) > 0:
                n = cells_number[k]
                for m in range(n):
                    neighbor[m] = from_cells[k * most + m]
            else:
                far, at_most = at(reach, w, i), np.int64(at(limit, w, i))
                n = nearest_of_all(w, i, position, seen, far, at_most, neighbor, distance)
            tau, between = at(horizon, w, i), at(space, w, i)
            for m in range(n):
                j = neighbor[m]
                touching = radius[w, i] + radius[w, j]
                if j >= first:
                    touching = max(touching + between, 0.0)
                _half_plane(position, velocity, touching, w, i, j, tau, time_step, lines, hard + m)
            n += hard
            speed, x, y = max_speed[w, i], preferred[w, i, 0], preferred[w, i, 1]
            failed, x, y = nearest_permitted(lines, n, speed, x, y, AS_VELOCITY)
            if failed < n:
                x, y = least_violation(lines, n, hard, failed, speed, x, y, scratch)
            out[w, i - first, 0], out[w, i - first, 1] = x, y


@no_type_check
@njit(error_model="numpy", forceinline=True)
def _half_plane(position, velocity, reach, w, i, j, time_horizon, time_step, lines, k):
    """Write line k: the velocities that agent i of world w may take because of its neighbour j (equation 6, figure 2).

    The velocity obstacle, in relative velocities, is a cone with a round tip (equation 2). The line goes through
    the agent's velocity plus half of u, the smallest change of the relative velocity that leads out of it (equation 5).

    Args:
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, in m/s.
        reach: Distance in metres between the centres at which the agents touch.
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
    squared = dx * dx + dy * dy
    overlapping = squared <= reach * reach
    # Overlapping agents must separate within the step.
    rate = 1.0 / (time_step if overlapping else max(time_horizon, _TINY))
    wx, wy = rx - rate * dx, ry - rate * dy
    dot = wx * dx + wy * dy
    if overlapping or (dot < 0.0 and dot * dot > reach * reach * (wx * wx + wy * wy)):
        nx, ny, length = unit(wx, wy)
        if length == 0.0 and j < i:  # two agents at one position separate in opposite directions
            nx = -nx
        cx, cy = ny, -nx
        depth = reach * rate - length
        sx, sy = depth * nx, depth * ny
    else:
        # The legs of the cone are the direction to the neighbour, turned by half the angle of the cone. The right one
        # points back to the tip, so that permitted velocities lie to its left.
        side = 1.0 if _passes_left(px, py, vx, vy, qx, qy, ux, uy, rate) else -1.0
        leg, scale = side * math.sqrt(squared - reach * reach), 1.0 / squared
        cx, cy = (dx * leg - dy * reach) * scale, (dx * reach + dy * leg) * scale
        along = rx * cx + ry * cy
        sx, sy = along * cx - rx, along * cy - ry
    lines[k, 0], lines[k, 1] = vx + 0.5 * sx, vy + 0.5 * sy
    lines[k, 2], lines[k, 3] = cx, cy


@no_type_check
@njit(error_model="numpy", forceinline=True)
def _passes_left(px, py, vx, vy, qx, qy, ux, uy, rate):
    """Return whether the nearer leg of the cone is the left one.

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
