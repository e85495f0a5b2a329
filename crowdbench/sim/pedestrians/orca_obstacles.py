"""Half-planes of permitted velocities of ORCA agents near obstacles (van den Berg et al. 2011), compiled.

The velocities that an edge of a polygon forbids are computed as in the library RVO2 (version 2.0.2): the velocities
that lead to the edge within the time horizon are a truncated cone, and the half-plane is tangent to it at the point
nearest to the agent's velocity. Only the agent is responsible for avoiding an edge, so the half-plane moves by the
whole distance and not by half of it. As in RVO2, walls do not hide the edges behind them.

Corners are listed counter-clockwise around a solid obstacle, so that agents are on the right side of its edges. A
polygon of two corners is a wall, with agents on both sides.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np

from crowdbench.sim.kernels import at
from crowdbench.sim.neighbors import insert_sorted
from crowdbench.sim.obstacles import number_of_corners
from crowdbench.sim.pedestrians.linear_program import unit
from crowdbench.utils.compiled import njit

EDGE = 12
"""Numbers about an edge: first corner x, y, second corner x, y, direction x, y, direction of the edge before it x, y,
of the edge after it x, y, and whether its first and its second corner are convex (1) or concave (0)."""

_COVERED = 1e-5
"""Tolerance in m/s with which edges behind a half-plane are ignored, as in RVO2."""


_TINY = 1e-9
"""Smallest time horizon in seconds, in place of 0."""


@no_type_check
@njit(error_model="numpy", nogil=True)
def wall_lines(begin, end, crowd, horizon, obstacles, lines, line_number):
    """Write the lines of the walls near each agent of a block.

    Args:
        begin (int): The first agent, counted through all worlds.
        end (int): The one after the last.
        crowd (tuple): The fields of `crowdbench.sim.pedestrians.orca.Agents`.
        horizon (array): `Avoidance.time_horizon_obst`.
        obstacles (array): `[world, polygon, corner, 2]`, in metres; or the array of one world for all.
        lines (array): `[agent * most, 4]`, filled: the lines of each agent.
        line_number (array): `[agent]`, filled: how many there are.
    """
    position, velocity, _, radius, max_speed, _, moves, _ = crowd
    agents, most = radius.shape[1], obstacles.shape[1] * obstacles.shape[2]
    edges, order, distance = np.empty((most, EDGE)), np.empty(most, np.int64), np.empty(most)
    for w in range(begin // agents, (end + agents - 1) // agents):
        # Of a copy: threads would wait for each other to count the references to slices of the same array.
        edge_number = _fill_edges(obstacles[min(w, len(obstacles) - 1)].copy(), edges)
        for i in range(max(begin - w * agents, 0), min(end - w * agents, agents)):
            k = w * agents + i - begin
            line_number[k] = 0
            if edge_number == 0 or not at(moves, w, i):
                continue
            x, y, tau = position[w, i, 0], position[w, i, 1], at(horizon, w, i)
            vx, vy = velocity[w, i, 0], velocity[w, i, 1]
            near = _nearest_edges(edges, edge_number, x, y, tau * max_speed[w, i] + radius[w, i], order, distance)
            rate, row = 1.0 / max(tau, _TINY), lines[k * most : (k + 1) * most]
            line_number[k] = _edge_half_planes(edges, order, near, x, y, vx, vy, radius[w, i], rate, row)


@no_type_check
@njit(error_model="numpy")
def _fill_edges(polygons, edges):
    """Fill the table of edges of one world.

    Args:
        polygons (array): `[polygon, corner, 2]`, in metres, NaN after the last corner.
        edges (array): `[edge, EDGE]`, filled.

    Returns:
        number (int): The number of edges.
    """
    number = 0
    for polygon in polygons:
        corners = number_of_corners(polygon)
        for k in range(corners):
            first, second = polygon[k], polygon[(k + 1) % corners]
            before, after = polygon[(k - 1) % corners], polygon[(k + 2) % corners]
            edge = edges[number]
            edge[0], edge[1], edge[2], edge[3] = first[0], first[1], second[0], second[1]
            edge[4], edge[5], _ = unit(second[0] - first[0], second[1] - first[1])
            edge[6], edge[7], _ = unit(first[0] - before[0], first[1] - before[1])
            edge[8], edge[9], _ = unit(after[0] - second[0], after[1] - second[1])
            is_wall = corners == 2
            edge[10] = 1.0 if is_wall or _left_of(before, first, second) >= 0.0 else 0.0
            edge[11] = 1.0 if is_wall or _left_of(first, second, after) >= 0.0 else 0.0
            number += 1
    return number


@no_type_check
@njit(error_model="numpy", forceinline=True)
def _left_of(a, b, c):
    """Return the distance of c to the left of the line from a to b, times the distance of these."""
    return (a[0] - c[0]) * (b[1] - a[1]) - (a[1] - c[1]) * (b[0] - a[0])


@no_type_check
@njit(error_model="numpy")
def _nearest_edges(edges, number, x, y, reach, order, distance):
    """Find the edges with an agent on their right side, nearest first.

    Args:
        edges (array): `[edge, EDGE]`.
        number (int): The number of edges.
        x (float): x of the agent in metres.
        y (float): y of the agent in metres.
        reach (float): Edges are nearer than this, in metres.
        order (array): `[edge]`, filled: indices of edges.
        distance (array): `[edge]`, filled: squared distances in square metres.

    Returns:
        n (int): How many there are.
    """
    n = 0
    for k in range(number):
        ax, ay, bx, by = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3]
        dx, dy = bx - ax, by - ay
        if dx * (y - ay) - dy * (x - ax) >= 0.0:
            continue
        along = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
        along = min(max(along, 0.0), 1.0)
        ox, oy = ax + along * dx - x, ay + along * dy - y
        squared = ox * ox + oy * oy
        if squared >= reach * reach:
            continue
        n = insert_sorted(k, squared, n, number, order, distance)
    return n


@no_type_check
@njit(error_model="numpy")
def _edge_half_planes(edges, order, near, x, y, vx, vy, radius, rate, lines):
    """Write a line for each edge that restricts an agent's velocity.

    Args:
        edges (array): `[edge, EDGE]`.
        order (array): `[edge]`, indices of edges, nearest first.
        near (int): Number of edges in `order`.
        x (float): x of the agent in metres.
        y (float): y of the agent in metres.
        vx (float): x of the agent's velocity in m/s.
        vy (float): y of the agent's velocity in m/s.
        radius (float): The agent's radius in metres.
        rate (float): 1 over the time horizon, in 1/s.
        lines (array): `[line, 4]`, filled from the first line on.

    Returns:
        n (int): The number of lines.
    """
    n = 0
    for index in range(near):
        edge = edges[order[index]]
        ax, ay, bx, by = edge[0] - x, edge[1] - y, edge[2] - x, edge[3] - y
        if not _is_covered(lines, n, rate * ax, rate * ay, rate * bx, rate * by, rate * radius):
            has_line, px, py, dx, dy = _edge_half_plane(edge, ax, ay, bx, by, vx, vy, radius, rate)
            if has_line:
                lines[n, 0], lines[n, 1], lines[n, 2], lines[n, 3] = px, py, dx, dy
                n += 1
    return n


@no_type_check
@njit(error_model="numpy", forceinline=True)
def _is_covered(lines, n, ax, ay, bx, by, margin):
    """Return whether both ends of an edge, in the velocity space, lie behind one of the lines by a margin."""
    for k in range(n):
        px, py, dx, dy = lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3]
        first = (ax - px) * dy - (ay - py) * dx - margin
        second = (bx - px) * dy - (by - py) * dx - margin
        if first >= -_COVERED and second >= -_COVERED:
            return True
    return False


@no_type_check
@njit(error_model="numpy", forceinline=True)
def _legs(px, py, squared, radius):
    """Return the directions of the left and the right tangent from the agent to a disc around a corner."""
    leg, scale = math.sqrt(squared - radius * radius), 1.0 / squared
    left = (px * leg - py * radius) * scale, (px * radius + py * leg) * scale
    return left, ((px * leg + py * radius) * scale, (py * leg - px * radius) * scale)


@no_type_check
@njit(error_model="numpy")
def _edge_half_plane(edge, ax, ay, bx, by, vx, vy, radius, rate):
    """Return the line of one edge.

    Args:
        edge: `[EDGE]`.
        ax, ay, bx, by: Its corners relative to the agent, in metres.
        vx, vy: The agent's velocity in m/s.
        radius: The agent's radius in metres.
        rate: 1 over the time horizon, in 1/s.

    Returns:
        True if there is a line; its point and its direction.
    """
    ux, uy, is_first_convex, is_second_convex = edge[4], edge[5], edge[10] == 1.0, edge[11] == 1.0
    ex, ey = bx - ax, by - ay
    squared_a, squared_b, squared_radius = ax * ax + ay * ay, bx * bx + by * by, radius * radius
    s = -(ax * ex + ay * ey) / (ex * ex + ey * ey)
    ox, oy = ax + s * ex, ay + s * ey
    squared_line = ox * ox + oy * oy

    # An agent that touches the edge must not go on into it.
    if s < 0.0 and squared_a <= squared_radius:
        dx, dy, _ = unit(-ay, ax)
        return is_first_convex, 0.0, 0.0, dx, dy
    if s > 1.0 and squared_b <= squared_radius:
        dx, dy, _ = unit(-by, bx)
        return is_second_convex and bx * edge[9] - by * edge[8] >= 0.0, 0.0, 0.0, dx, dy
    if 0.0 <= s < 1.0 and squared_line <= squared_radius:
        return True, 0.0, 0.0, -ux, -uy

    # If the agent is beyond an end of the edge, both legs of the cone belong to one corner.
    is_corner, cut = False, (ux, uy)
    before_x, before_y, after_x, after_y = edge[6], edge[7], edge[8], edge[9]
    if s < 0.0 and squared_line <= squared_radius:
        if not is_first_convex:
            return False, 0.0, 0.0, 1.0, 0.0
        is_corner, bx, by, is_second_convex = True, ax, ay, True
        after_x, after_y = ux, uy
        left, right = _legs(ax, ay, squared_a, radius)
    elif s > 1.0 and squared_line <= squared_radius:
        if not is_second_convex:
            return False, 0.0, 0.0, 1.0, 0.0
        is_corner, ax, ay, is_first_convex = True, bx, by, True
        before_x, before_y, cut = ux, uy, (after_x, after_y)
        left, right = _legs(bx, by, squared_b, radius)
    else:
        left, right = (-ux, -uy), (ux, uy)
        if is_first_convex:
            left, _ = _legs(ax, ay, squared_a, radius)
        if is_second_convex:
            _, right = _legs(bx, by, squared_b, radius)

    # A leg that points into the neighbouring edge is replaced by that edge, which has a separate line.
    is_left_foreign = is_first_convex and left[1] * before_x - left[0] * before_y >= 0.0
    if is_left_foreign:
        left = -before_x, -before_y
    is_right_foreign = is_second_convex and right[0] * after_y - right[1] * after_x <= 0.0
    if is_right_foreign:
        right = after_x, after_y
    legs = left, right, is_left_foreign, is_right_foreign
    return _tangent(vx, vy, ax, ay, bx, by, is_corner, cut, legs, radius, rate)


@no_type_check
@njit(error_model="numpy", forceinline=True)
def _tangent(vx, vy, ax, ay, bx, by, is_corner, cut, legs, radius, rate):
    """Return the line that is tangent to a truncated cone at the point nearest to a velocity.

    That point is on a round end, on the cut-off line, or on a leg.

    Args:
        vx, vy: The velocity in m/s.
        ax, ay, bx, by: The corners of the edge relative to the agent, in metres.
        is_corner: True if they are the same one.
        cut: The direction of the cut-off line.
        legs: The directions of the left and the right leg, and whether each is a neighbouring edge.
        radius: The agent's radius in metres.
        rate: 1 over the time horizon, in 1/s.

    Returns:
        True if there is a line, False on a neighbouring edge; its point and its direction.
    """
    (left_x, left_y), (right_x, right_y), is_left_foreign, is_right_foreign = legs
    ax, ay, bx, by, margin = rate * ax, rate * ay, rate * bx, rate * by, radius * rate
    ex, ey = bx - ax, by - ay
    t = 0.5 if is_corner else ((vx - ax) * ex + (vy - ay) * ey) / (ex * ex + ey * ey)
    on_left = (vx - ax) * left_x + (vy - ay) * left_y
    on_right = (vx - bx) * right_x + (vy - by) * right_y
    if (t < 0.0 and on_left < 0.0) or (is_corner and on_left < 0.0 and on_right < 0.0):
        wx, wy, _ = unit(vx - ax, vy - ay)
        return True, ax + margin * wx, ay + margin * wy, wy, -wx
    if t > 1.0 and on_right < 0.0:
        wx, wy, _ = unit(vx - bx, vy - by)
        return True, bx + margin * wx, by + margin * wy, wy, -wx
    to_cut, to_left, to_right = math.inf, math.inf, math.inf
    if 0.0 <= t <= 1.0 and not is_corner:
        to_cut = (vx - ax - t * ex) ** 2 + (vy - ay - t * ey) ** 2
    if on_left >= 0.0:
        to_left = (vx - ax - on_left * left_x) ** 2 + (vy - ay - on_left * left_y) ** 2
    if on_right >= 0.0:
        to_right = (vx - bx - on_right * right_x) ** 2 + (vy - by - on_right * right_y) ** 2
    if to_cut <= to_left and to_cut <= to_right:
        return True, ax + margin * cut[1], ay - margin * cut[0], -cut[0], -cut[1]
    if to_left <= to_right:
        return not is_left_foreign, ax - margin * left_y, ay + margin * left_x, left_x, left_y
    return not is_right_foreign, bx + margin * right_y, by - margin * right_x, -right_x, -right_y
