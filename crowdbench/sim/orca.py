"""Optimal reciprocal collision avoidance (van den Berg, Guy, Lin and Manocha 2011), compiled.

Every agent forbids itself, for each neighbour, the velocities on one side of a line (a half-plane of
the velocity space), and takes the permitted velocity nearest to the one it prefers: a linear program in
two dimensions (section 4 of the paper). Where nothing is permitted, a program in three dimensions finds
the velocity that violates the lines least (section 5.3). A line is (point, direction); what lies to the
left of its direction is permitted.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numba import njit, prange

from crowdbench.sim.kernels import at, per_agent, serial_and_parallel

PARALLEL_AGENTS = 400
"""Agents in a batch from which the 110 microseconds that starting threads costs are worth paying."""

_BLOCKS = 64
"""Worlds are shared out to threads in this many blocks, each with memory of its own to work in."""

_EVERYBODY = per_agent(True, np.bool_)

_TINY = 1e-9
"""The least time horizon in seconds: with none at all, others are avoided once they overlap."""

_PARALLEL = 1e-5
"""Two lines whose directions' cross product is below this count as parallel (RVO2's constant)."""


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
    seen: Bool[np.ndarray, "world agent"] | None = None,
    moves: Bool[np.ndarray, "world agent"] | None = None,
) -> Float[np.ndarray, "world agent 2"]:
    """The velocity that each agent takes next, in m/s.

    Positions and radii are in metres and used as given, nothing is added to them. Neighbours are the
    `max_neighbors` nearest agents (one number, one per world, or one per agent) within
    `neighbor_distance` metres; `time_horizon` is the paper's tau, in seconds. Agents that are not `seen`
    are nobody's neighbours; the velocity of agents that do not move (`moves`) is not computed and zero.
    """
    out = np.empty((*radius.shape, 2))
    compute = _orca_parallel if radius.size >= PARALLEL_AGENTS else _orca_serial
    compute(
        np.ascontiguousarray(position),
        np.ascontiguousarray(velocity),
        np.ascontiguousarray(preferred_velocity),
        np.ascontiguousarray(radius),
        np.ascontiguousarray(max_speed),
        time_step,
        per_agent(neighbor_distance),
        per_agent(max_neighbors, np.int64),
        per_agent(time_horizon),
        _EVERYBODY if seen is None else np.ascontiguousarray(seen),
        _EVERYBODY if moves is None else np.ascontiguousarray(moves),
        out,
    )
    return out


@no_type_check
def _orca(
    position,
    velocity,
    preferred,
    radius,
    max_speed,
    time_step,
    neighbor_distance,
    max_neighbors,
    time_horizon,
    seen,
    moves,
    out,
):
    """The loop over worlds, compiled twice: for one thread and for all."""
    worlds, agents = radius.shape
    blocks = min(worlds, _BLOCKS)
    for block in prange(blocks):
        neighbor, distance = np.empty(agents, np.int64), np.empty(agents)
        lines, scratch = np.empty((agents, 4)), np.empty((agents, 4))
        # The index of a prange is unsigned, which would turn the bounds into floats.
        first = np.int64(block) * worlds // blocks
        for w in range(first, (np.int64(block) + 1) * worlds // blocks):
            for i in range(agents):
                x, y = 0.0, 0.0
                if at(moves, w, i):
                    reach, limit = at(neighbor_distance, w, i), at(max_neighbors, w, i)
                    horizon = at(time_horizon, w, i)
                    n = _nearest(w, i, position, seen, reach, limit, neighbor, distance)
                    for k in range(n):
                        _half_plane(position, velocity, radius, w, i, neighbor[k], horizon, time_step, lines, k)
                    x, y = preferred[w, i, 0], preferred[w, i, 1]
                    failed, x, y = _nearest_permitted(lines, n, max_speed[w, i], x, y, False)
                    if failed < n:
                        x, y = _least_violation(lines, n, failed, max_speed[w, i], x, y, scratch)
                out[w, i, 0], out[w, i, 1] = x, y


_orca_serial, _orca_parallel = serial_and_parallel(_orca)


@no_type_check
@njit(cache=True, error_model="numpy", inline="always")
def _nearest(w, i, position, seen, reach, limit, neighbor, distance):
    """Fill `neighbor` with the nearest agents, nearest first; return how many there are."""
    n = 0
    reach_squared = reach * reach
    for j in range(position.shape[1]):
        if j == i or not at(seen, w, j):
            continue
        dx, dy = position[w, j, 0] - position[w, i, 0], position[w, j, 1] - position[w, i, 1]
        squared = dx * dx + dy * dy
        if squared >= reach_squared or limit == 0:
            continue
        place = n if n < limit else n - 1
        while place > 0 and squared < distance[place - 1]:
            neighbor[place], distance[place] = neighbor[place - 1], distance[place - 1]
            place -= 1
        neighbor[place], distance[place] = j, squared
        if n < limit:
            n += 1
        if n == limit:
            reach_squared = distance[n - 1]
    return n


@no_type_check
@njit(cache=True, error_model="numpy", inline="always")
def _unit(x, y):
    length = math.sqrt(x * x + y * y)
    if length == 0.0:
        return 1.0, 0.0, 0.0
    return x / length, y / length, length


@no_type_check
@njit(cache=True, error_model="numpy", inline="always")
def _half_plane(position, velocity, radius, w, i, j, time_horizon, time_step, lines, k):
    """Line k: what agent i of world w owes its neighbour j (section 4, figure 2).

    The velocity obstacle, in relative velocities, is a cone with a round tip. The line goes through the
    agent's velocity plus half of the smallest change that leads out of it.
    """
    px, py, qx, qy = position[w, i, 0], position[w, i, 1], position[w, j, 0], position[w, j, 1]
    vx, vy, ux, uy = velocity[w, i, 0], velocity[w, i, 1], velocity[w, j, 0], velocity[w, j, 1]
    dx, dy = qx - px, qy - py
    rx, ry = vx - ux, vy - uy
    reach = radius[w, i] + radius[w, j]
    squared = dx * dx + dy * dy
    overlapping = squared <= reach * reach
    # Those who overlap must part within the step, the others within the horizon.
    rate = 1.0 / (time_step if overlapping else max(time_horizon, _TINY))
    wx, wy = rx - rate * dx, ry - rate * dy
    dot = wx * dx + wy * dy
    if overlapping or (dot < 0.0 and dot * dot > reach * reach * (wx * wx + wy * wy)):
        nx, ny, length = _unit(wx, wy)
        cx, cy = ny, -nx
        depth = reach * rate - length
        sx, sy = depth * nx, depth * ny
    else:
        # The legs are the way to the neighbour turned by the half angle of the cone; the right one leads back.
        side = 1.0 if _passes_left(px, py, vx, vy, qx, qy, ux, uy, rate) else -1.0
        leg, scale = side * math.sqrt(squared - reach * reach), 1.0 / squared
        cx, cy = (dx * leg - dy * reach) * scale, (dx * reach + dy * leg) * scale
        along = rx * cx + ry * cy
        sx, sy = along * cx - rx, along * cy - ry
    lines[k, 0], lines[k, 1] = vx + 0.5 * sx, vy + 0.5 * sy
    lines[k, 2], lines[k, 3] = cx, cy


@no_type_check
@njit(cache=True, error_model="numpy", inline="always")
def _passes_left(px, py, vx, vy, qx, qy, ux, uy, rate):
    """Whether the nearer leg of the cone is the left one.

    In float32, because RVO2 is: two agents who walk straight at each other are exactly in between, and
    the side that rounding chooses for them decides the whole encounter.
    """
    dx, dy = np.float32(qx) - np.float32(px), np.float32(qy) - np.float32(py)
    wx = np.float32(vx) - np.float32(ux) - np.float32(rate) * dx
    wy = np.float32(vy) - np.float32(uy) - np.float32(rate) * dy
    return dx * wy - dy * wx > np.float32(0.0)


@no_type_check
@njit(cache=True, error_model="numpy", inline="always")
def _nearest_on_line(lines, k, speed, x, y, as_direction):
    """The best velocity on line k that lines 0 to k - 1 and the speed permit; the first result says if any."""
    px, py, dx, dy = lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3]
    dot = px * dx + py * dy
    discriminant = dot * dot + speed * speed - (px * px + py * py)
    if discriminant < 0.0:
        return False, x, y
    root = math.sqrt(discriminant)
    left, right = -dot - root, -dot + root
    for j in range(k):
        cross = dx * lines[j, 3] - dy * lines[j, 2]
        offset = lines[j, 2] * (py - lines[j, 1]) - lines[j, 3] * (px - lines[j, 0])
        if abs(cross) <= _PARALLEL:
            if offset < 0.0:
                return False, x, y
            continue
        t = offset / cross
        if cross >= 0.0:
            right = min(right, t)
        else:
            left = max(left, t)
        if left > right:
            return False, x, y
    if as_direction:
        t = right if x * dx + y * dy > 0.0 else left
    else:
        t = min(max(dx * (x - px) + dy * (y - py), left), right)
    return True, px + t * dx, py + t * dy


@no_type_check
@njit(cache=True, error_model="numpy", inline="always")
def _nearest_permitted(lines, n, speed, x, y, as_direction):
    """The permitted velocity nearest to (x, y), or farthest in its direction, no faster than `speed`.

    Returns n and the velocity, or the number of the first line that cannot be met and the best so far.
    """
    best_x, best_y = x, y
    if as_direction:
        best_x, best_y = x * speed, y * speed
    elif x * x + y * y > speed * speed:
        ux, uy, _ = _unit(x, y)
        best_x, best_y = ux * speed, uy * speed
    for k in range(n):
        if lines[k, 2] * (lines[k, 1] - best_y) - lines[k, 3] * (lines[k, 0] - best_x) > 0.0:
            found, new_x, new_y = _nearest_on_line(lines, k, speed, x, y, as_direction)
            if not found:
                return k, best_x, best_y
            best_x, best_y = new_x, new_y
    return n, best_x, best_y


@no_type_check
@njit(cache=True, error_model="numpy")
def _least_violation(lines, n, failed, speed, x, y, scratch):
    """The velocity that lies least far beyond any line, from the best before line `failed` (section 5.3)."""
    worst = 0.0
    for k in range(failed, n):
        px, py, dx, dy = lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3]
        if dx * (py - y) - dy * (px - x) <= worst:
            continue
        m = 0
        for j in range(k):
            cross = dx * lines[j, 3] - dy * lines[j, 2]
            if abs(cross) <= _PARALLEL:
                if dx * lines[j, 2] + dy * lines[j, 3] > 0.0:
                    continue
                scratch[m, 0], scratch[m, 1] = 0.5 * (px + lines[j, 0]), 0.5 * (py + lines[j, 1])
            else:
                t = (lines[j, 2] * (py - lines[j, 1]) - lines[j, 3] * (px - lines[j, 0])) / cross
                scratch[m, 0], scratch[m, 1] = px + t * dx, py + t * dy
            scratch[m, 2], scratch[m, 3], _ = _unit(lines[j, 2] - dx, lines[j, 3] - dy)
            m += 1
        missed, new_x, new_y = _nearest_permitted(scratch, m, speed, -dy, dx, True)
        # By construction a solution exists; rounding alone can miss it, and then the last one stands.
        if missed == m:
            x, y = new_x, new_y
        worst = dx * (py - y) - dy * (px - x)
    return x, y
