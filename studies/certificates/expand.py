"""Expansion of a layer of states to the next one: every command of every state, checked as in the simulator.

A layer contains states that the vehicle can reach after a number of steps. Of all states in one cell of a grid over
position, heading and speed, it contains only the one with the shortest remaining path. Compiled.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core import COLLISION_RULES, HOLONOMIC, Discs, Motion, RuleNumbers, drive, nearest_in_step
from crowdbench.sim import fill_motion, gaps_on_arc, wall_gap_in_step
from crowdbench.utils import njit
from studies.certificates.cost_to_go import cost_left

_PLUS = COLLISION_RULES.index("crowdnav_plus")

SAFE = 1e-9
"""Excess of a gap over the margin, in metres, so that rounding does not cause a collision."""


class Vehicle(NamedTuple):
    """Motion of a vehicle, and the obstacles. For kernels.

    Attributes:
        rules: The rules.
        max_speed: Largest speed in m/s.
        tolerance: Distance in metres to the goal below which it has arrived.
        obstacles: Polygons in metres.
    """

    rules: RuleNumbers
    max_speed: float
    tolerance: float
    obstacles: Float[np.ndarray, "polygon corner 2"]


class Grid(NamedTuple):
    """The cells of states. For kernels.

    Attributes:
        cell: Side of the cells in metres.
        number: Numbers of cells along x, y, heading and speed.
        table: The index of the new state in each cell; -1 where there is none.
    """

    cell: float
    number: Int[np.ndarray, "4"]
    table: Int[np.ndarray, "cell"]


class Layer(NamedTuple):
    """The states after a step. For kernels.

    Attributes:
        state: Position, velocity, heading and turn rate.
        cost: The length of the remaining path in metres.
        parent: The preceding state of each state, in the layer before.
        command: The command from the preceding state to this one.
    """

    state: Float[np.ndarray, "state 6"]
    cost: Float[np.ndarray, "state"]
    parent: Int[np.ndarray, "state"]
    command: Float[np.ndarray, "state 2"]

    def take(self, rows: Int[np.ndarray, "row"]) -> Layer:
        """Return some of the states."""
        return Layer(*(each[rows] for each in self))


@no_type_check
@njit(nogil=True)
def expand(vehicle, cost, margin, farthest, states, commands, crowds, grid, layer):
    """Find the states that are reached in a step with a margin to all pedestrians and obstacles.

    Args:
        vehicle (Vehicle): Motion of the vehicle, and the obstacles.
        cost (CostToGo): The lengths of the paths to its goal.
        margin (float): Smallest gap to pedestrians and obstacles, in metres.
        farthest (float): Distance in metres to the goal from which it can still be reached after the step.
        states (array): `[state, 6]`, as in `Layer`, the most promising first.
        commands (array): `[state, action, 2]`, the commands to try.
        crowds (CrowdStep): Motion of the crowd of each state in the step, or the one crowd of all states.
        grid (Grid): The cells, whose table is filled.
        layer (Layer): The new states, which are filled.

    Returns:
        count (int): The number of new states.
        arrived (int): The index of a state that has arrived at the goal; -1 if there is none. No states follow it.
        is_cut (bool): True if states were left out because they do not fit; those outside the grid do not count.
    """
    rules, max_speed, tolerance, obstacles = vehicle
    before, end, velocity, radius, present = crowds
    new_state, new_cost, new_parent, new_command = layer
    agents, dt, is_plus = radius.shape[1], rules.dt, rules.collision == _PLUS
    motion, position, moved = np.empty((agents, 2)), np.empty((agents, 2)), np.empty((agents, 2))
    near_radius, near_present = np.empty(agents), np.ones(agents, np.bool_)
    reach, size = max(abs(rules.body[0]), abs(rules.body[-1])), radius[0, 0]
    count, is_cut, last = 0, False, -1
    for s in range(len(states)):
        x, y, vx, vy, heading, turn_rate = states[s]
        now = Motion(x, y, vx, vy, heading, turn_rate)
        c = s if len(radius) > 1 else 0
        if c != last:
            fill_motion(before[c], end[c], velocity[c], rules.collision, dt, motion)
            last = c
        # Only pedestrians that can come near in this step.
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
        discs = Discs(position[:near], moved[:near], near_radius[:near], near_present[:near])
        for a in range(commands.shape[1]):
            first, second = commands[s, a]
            nx, ny, nvx, nvy, after, turned = drive(rules.code, rules.limits, now, (first, second), max_speed, dt)
            arrived_x, arrived_y = (x, y) if is_plus else (nx, ny)
            distance = math.hypot(cost.goal[0] - arrived_x, cost.goal[1] - arrived_y)
            arrived = distance < tolerance
            index = _cell_of(nx, ny, math.hypot(nvx, nvy) / max_speed, after, cost.low, grid)
            if index < 0 or distance > farthest:
                continue
            left = cost_left(nx, ny, cost)
            slot = grid.table[index]
            if not arrived and slot >= 0 and new_cost[slot] <= left:
                continue
            position[0, 0], position[0, 1] = x, y
            if rules.code == HOLONOMIC:
                moved[0, 0], moved[0, 1] = (0.0, 0.0) if is_plus else (nx - x, ny - y)
                gap, _ = nearest_in_step(0, discs)
                wall_gap = wall_gap_in_step(x, y, moved[0, 0], moved[0, 1], size, walls)
            else:
                speed, rate = (0.0, 0.0) if is_plus else (math.hypot(nvx, nvy), turned)
                gap, wall_gap = gaps_on_arc(rules.body, heading, speed, rate, dt, discs, walls)
            if min(gap, wall_gap) < margin + SAFE:
                continue
            if slot < 0 and count == len(new_cost) - 1 and not arrived:
                is_cut = True
                continue
            if slot < 0 or arrived:
                slot = count
                count += 1
                grid.table[index] = slot
            new_state[slot] = (nx, ny, nvx, nvy, after, turned)
            new_cost[slot], new_parent[slot], new_command[slot] = left, s, (first, second)
            if arrived:
                return count, slot, is_cut
    return count, -1, is_cut


@no_type_check
@njit(nogil=True)
def _cell_of(x, y, speed, heading, low, grid):
    """Return the index of the cell of a state, -1 outside the grid.

    Args:
        x (float): x of its position in metres.
        y (float): y of its position in metres.
        speed (float): As a share of the largest one.
        heading (float): In radians.
        low (array): `[2]`, the corner of the grid in metres.
        grid (Grid): The grid.
    """
    cell, number, _ = grid
    i, j = math.floor((x - low[0]) / cell), math.floor((y - low[1]) / cell)
    if not (0 <= i < number[0] and 0 <= j < number[1]):
        return -1
    h = math.floor(heading / (2.0 * math.pi) * number[2] + 0.5) % number[2]
    v = min(int(speed * (number[3] - 1) + 0.5), number[3] - 1)
    return ((i * number[1] + j) * number[2] + h) * number[3] + v
