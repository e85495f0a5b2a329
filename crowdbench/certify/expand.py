"""From the states of a layer to those of the next one: every command of every state, checked as the simulator does.

A layer holds what the vehicle may be after so many steps. Of all states in one cell of a grid over position, heading
and speed it keeps one, that with the shortest way left. Compiled.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np

from crowdbench.compiled import njit
from crowdbench.dynamics.motion import HOLONOMIC, drive
from crowdbench.geometry import nearest_in_step
from crowdbench.sim.episode import fill_motion
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.sim.swept import gaps_on_arc
from crowdbench.types import COLLISION_RULES

_PLUS = COLLISION_RULES.index("crowdnav_plus")

SAFE = 1e-9
"""What a gap must be larger than the margin, in metres, so that rounding does not make a collision of it."""


@no_type_check
@njit(nogil=True)
def expand(
    code,
    limits,
    body,
    tolerance,
    rule,
    dt,
    max_speed,
    margin,
    farthest,
    state,
    command,
    crowd,
    before,
    end,
    velocity,
    radius,
    present,
    obstacles,
    goal,
    ways,
    ways_origin,
    ways_cell,
    origin,
    cell,
    number,
    table,
    new_state,
    new_way,
    new_parent,
    new_command,
):
    """Find the states that are reached in a step without coming nearer to anything than a margin.

    Args:
        code (int): The code of the vehicle's dynamics.
        limits (array): Its limits.
        body (array): `[disc]`, where the centres of its discs are, in metres ahead of its position.
        tolerance (float): Distance in metres to the goal below which it has arrived.
        rule (int): Index of the collision rule in `COLLISION_RULES`.
        dt (float): Duration of the step in seconds.
        max_speed (float): The vehicle's, in m/s.
        margin (float): Smallest gap to pedestrians and obstacles, in metres.
        farthest (float): Distance in metres to the goal from which it can still be reached after the step.
        state (array): `[state, 6]`: position, velocity, heading and turn rate, the most promising first.
        command (array): `[state, action, 2]`, the commands to try.
        crowd (array): `[state]`, which of the crowds each state is in.
        before (array): `[crowd, agent, 2]`, positions before the step in metres; the vehicle's are not read.
        end (array): `[crowd, agent, 2]`, positions after it.
        velocity (array): `[crowd, agent, 2]`, velocities before it, in m/s.
        radius (array): `[crowd, agent]`, in metres.
        present (array): `[crowd, agent]`.
        obstacles (array): `[polygon, corner, 2]`, in metres.
        goal (array): `[2]`, in metres.
        ways (array): `[x, y]`, the ways to the goal around obstacles in metres; empty without obstacles.
        ways_origin (array): `[2]`, the centre of the first of these points.
        ways_cell (float): Their distance from each other in metres.
        origin (array): `[2]`, the corner of the grid of states in metres.
        cell (float): Side of its cells in metres.
        number (array): `[4]`, numbers of cells along x, y, heading and speed.
        table (array): `[cell]`, -1, filled: the index of the new state in each cell.
        new_state (array): `[most, 6]`, filled.
        new_way (array): `[most]`, filled: the ways left in metres.
        new_parent (array): `[most]`, filled: the state that each comes from.
        new_command (array): `[most, 2]`, filled: by which command.

    Returns:
        count (int): The number of new states.
        arrived (int): The index of one that has arrived at the goal; -1 if there is none. No others follow it.
        is_cut (bool): Whether states were left out because they do not fit; those outside the grid do not count.
    """
    agents = radius.shape[1]
    motion, position, moved = np.empty((agents, 2)), np.empty((agents, 2)), np.empty((agents, 2))
    near_radius, near_present = np.empty(agents), np.ones(agents, np.bool_)
    reach, size = max(abs(body[0]), abs(body[-1])), radius[0, 0]
    count, is_cut, last = 0, False, -1
    for s in range(len(state)):
        x, y, vx, vy, heading, turn_rate = state[s]
        c = crowd[s]
        if c != last:
            fill_motion(before[c], end[c], velocity[c], rule, dt, motion)
            last = c
        # Only who can come near in this step.
        near = 1
        for j in range(1, agents):
            if present[c, j]:
                far = 2.0 * reach + max_speed * dt + math.hypot(motion[j, 0], motion[j, 1])
                far += size + radius[c, j] + margin + SAFE
                if math.hypot(before[c, j, 0] - x, before[c, j, 1] - y) <= far:
                    position[near, 0], position[near, 1] = before[c, j, 0], before[c, j, 1]
                    moved[near, 0], moved[near, 1] = motion[j, 0], motion[j, 1]
                    near_radius[near] = radius[c, j]
                    near += 1
        near_radius[0] = size
        walls = obstacles
        if wall_gap_in_step(x, y, 0.0, 0.0, size, obstacles) > 2.0 * reach + max_speed * dt + margin + SAFE:
            walls = obstacles[:0]
        for a in range(command.shape[1]):
            first, second = command[s, a]
            nx, ny, nvx, nvy, after, turned = drive(
                code, limits, x, y, vx, vy, heading, turn_rate, first, second, max_speed, dt
            )
            arrived_x, arrived_y = (x, y) if rule == _PLUS else (nx, ny)
            distance = math.hypot(goal[0] - arrived_x, goal[1] - arrived_y)
            arrived = distance < tolerance
            index = _cell_of(nx, ny, math.hypot(nvx, nvy) / max_speed, after, origin, cell, number)
            if index < 0 or distance > farthest:
                continue
            way = way_left(nx, ny, goal, ways, ways_origin, ways_cell)
            there = table[index]
            if not arrived and there >= 0 and new_way[there] <= way:
                continue
            position[0, 0], position[0, 1] = x, y
            if code == HOLONOMIC:
                moved[0, 0], moved[0, 1] = (0.0, 0.0) if rule == _PLUS else (nx - x, ny - y)
                gap, _ = nearest_in_step(0, position[:near], moved[:near], near_radius[:near], near_present[:near])
                wall_gap = wall_gap_in_step(x, y, moved[0, 0], moved[0, 1], size, walls)
            else:
                speed, rate = (0.0, 0.0) if rule == _PLUS else (math.hypot(nvx, nvy), turned)
                around = position[:near], moved[:near], near_radius[:near], near_present[:near], walls
                gap, wall_gap = gaps_on_arc(body, heading, speed, rate, dt, *around)
            if min(gap, wall_gap) < margin + SAFE:
                continue
            if there < 0 and count == len(new_way) - 1 and not arrived:
                is_cut = True
                continue
            if there < 0 or arrived:
                there = count
                count += 1
                table[index] = there
            new_state[there, 0], new_state[there, 1], new_state[there, 2], new_state[there, 3] = nx, ny, nvx, nvy
            new_state[there, 4], new_state[there, 5] = after, turned
            new_way[there], new_parent[there] = way, s
            new_command[there, 0], new_command[there, 1] = first, second
            if arrived:
                return count, there, is_cut
    return count, -1, is_cut


@no_type_check
@njit(nogil=True)
def _cell_of(x, y, speed, heading, origin, cell, number):
    """The index of the cell of a state, -1 outside the grid.

    Args:
        x (float): x of its position in metres.
        y (float): Its y.
        speed (float): As a share of the largest one.
        heading (float): In radians.
        origin (array): `[2]`, the corner of the grid in metres.
        cell (float): Side of the cells in metres.
        number (array): `[4]`, numbers of cells along x, y, heading and speed.

    Returns:
        index (int): Of the cell.
    """
    i, j = math.floor((x - origin[0]) / cell), math.floor((y - origin[1]) / cell)
    if not (0 <= i < number[0] and 0 <= j < number[1]):
        return -1
    h = math.floor(heading / (2.0 * math.pi) * number[2] + 0.5) % number[2]
    v = min(int(speed * (number[3] - 1) + 0.5), number[3] - 1)
    return ((i * number[1] + j) * number[2] + h) * number[3] + v


@no_type_check
@njit(nogil=True, error_model="numpy")
def way_left(x, y, goal, ways, origin, cell):
    """The length of the way from a point to the goal. Compiled.

    Args:
        x (float): x of the point in metres.
        y (float): Its y.
        goal (array): `[2]`, in metres.
        ways (array): `[x, y]`, ways from points of a grid in metres, infinite where none leads; empty without
            obstacles.
        origin (array): `[2]`, the first of these points.
        cell (float): Their distance from each other in metres.

    Returns:
        way (float): In metres, infinite where no way leads.
    """
    if ways.shape[0] == 0:
        return math.hypot(goal[0] - x, goal[1] - y)
    i, j = round((x - origin[0]) / cell), round((y - origin[1]) / cell)
    least = math.inf
    for k in range(max(i - 1, 0), min(i + 2, ways.shape[0])):
        for m in range(max(j - 1, 0), min(j + 2, ways.shape[1])):
            least = min(least, ways[k, m] + math.hypot(origin[0] + k * cell - x, origin[1] + m * cell - y))
    return least
