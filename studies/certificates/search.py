"""Breadth-first search, step by step, for commands that take the vehicle to its goal, given the crowd's future.

This is reachability in space and time (a state is the vehicle's configuration and the time, as in Fraichard 1998), on a
grid in which one state per cell is expanded. The search ends at the first layer with a state at the goal, so that no
faster path was found on this grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench import Rules, World
from crowdbench.core import (
    GRID_HEADINGS,
    GRID_SPEEDS,
    REACHABLE_SPEEDS,
    REACHABLE_TURNS,
    Bicycle,
    Holonomic,
    State,
    Unicycle,
    toward_goal,
)
from studies.certificates.cost_to_go import CostToGo, cost_left, find_cost_to_go
from studies.certificates.crowds import Crowd
from studies.certificates.expand import SAFE, Grid, Layer, Vehicle, expand

_HEADINGS, _SPEEDS = (16, 96), (4, 8)
"""The least and the largest number of cells of headings and speeds, if the vehicle cannot change them at once."""

_OF_STEP = 0.8
"""Largest cell of positions as a share of the longest path in a step: in a larger one the vehicle could stay."""

_OF_GRID = np.array(
    [0, *(1 + (speed - 1) * GRID_HEADINGS + k for speed in (3, GRID_SPEEDS) for k in range(GRID_HEADINGS))]
)
"""Commands of a holonomic vehicle: to stand, and two speeds in all headings."""

_OF_REACHED = np.array(
    [speed * REACHABLE_TURNS + turn for speed in (0, 3, REACHABLE_SPEEDS - 1) for turn in range(0, REACHABLE_TURNS, 3)]
)
"""Commands of a vehicle on wheels: three speeds and five turns."""


class Effort(NamedTuple):
    """Effort of a search.

    Attributes:
        cell: Side of the cells of positions in metres.
        states: Largest number of states of a layer that are expanded.
    """

    cell: float
    states: int


class SearchResult(NamedTuple):
    """Result of a search.

    Attributes:
        commands: The commands of each step until the vehicle arrives; None if none are found.
        is_exhaustive: True if states were left out only for other states in the same cell.
    """

    commands: Float[np.ndarray, "step 2"] | None
    is_exhaustive: bool


class Task(NamedTuple):
    """The search problem of one vehicle.

    Attributes:
        rules: The rules of the scenario.
        max_steps: Steps after which the episode times out.
        start: Position, velocity, heading and turn rate at the start.
        vehicle: Its motion, and the obstacles.
        cost: The lengths of the paths to its goal, with the margin to walls.
    """

    rules: Rules
    max_steps: int
    start: Float[np.ndarray, "6"]
    vehicle: Vehicle
    cost: CostToGo

    @classmethod
    def of(cls, world: World, row: int, margin: float = 0.0) -> Task:
        """Return the task in one of several worlds at their start, with a margin to walls in metres."""
        rules, position, radius = world.rules, world.position[row, 0], float(world.radius[row, 0])
        speed, tolerance = float(world.preferred_speed[row, 0]), float(rules.goal_tolerance or radius)
        vehicle = Vehicle(rules.numbers, speed, tolerance, np.ascontiguousarray(world.obstacles[row]))
        start = np.array([*position, *world.velocity[row, 0], world.heading[row], world.angular_speed[row]])
        room = radius + (margin + SAFE if margin else 0.0)
        cost = find_cost_to_go(position, world.goal[row, 0].copy(), room, world.obstacles[row])
        return cls(rules, int(world.max_steps[row]), start, vehicle, cost)


def search(task: Task, crowd: Crowd, margin: float, effort: Effort) -> SearchResult:
    """Search for commands by which the vehicle succeeds.

    Args:
        task: The search problem.
        crowd: The crowd at the start.
        margin: Smallest gap to pedestrians and obstacles in metres.
        effort: The effort of the search.
    """
    rules, vehicle, cost = task.rules, task.vehicle, task.cost
    if margin and math.isinf(cost_left(task.start[0], task.start[1], cost)):
        return SearchResult(None, False)  # no path has the margin, for example through a narrow door
    cell = min(effort.cell, _OF_STEP * vehicle.max_speed * rules.dt)
    number = np.array([*np.ceil((cost.high - cost.low) / cell).astype(np.int64), *_turns_and_speeds(task)])
    cells = int(number.prod())
    grid = Grid(cell, number, np.empty(cells, np.int32))
    most = min(cells, 4 * effort.states) + 1
    space = Layer(np.empty((most, 6)), np.empty(most), np.empty(most, np.int64), np.empty((most, 2)))
    states, layers, is_exhaustive = task.start[None], list[Layer](), True
    for left in reversed(range(task.max_steps - 1)):  # the last step is a time-out in any case
        grid.table.fill(-1)
        farthest = vehicle.tolerance + (left + 1) * rules.dt * vehicle.max_speed
        actions = commands(task, states)
        count, arrived, is_cut = expand(vehicle, cost, margin, farthest, states, actions, crowd.ahead(), grid, space)
        layer = space.take(np.arange(count))
        if arrived >= 0:
            return SearchResult(_trace_back([*layers, layer], arrived), is_exhaustive)
        rows = _select_states(layer.cost, effort.states)
        is_exhaustive &= not is_cut and len(rows) == len(layer.cost)
        if not len(rows):
            break
        layer = layer.take(rows)
        crowd = crowd.after(layer.parent, layer.command)
        states = layer.state
        layers.append(layer)
    return SearchResult(None, is_exhaustive)


def _turns_and_speeds(task: Task) -> tuple[int, int]:
    """Return the numbers of cells of headings and speeds, such that a step leads from one cell into the next."""
    dynamics, dt, speed = task.rules.dynamics, task.rules.dt, task.vehicle.max_speed
    if isinstance(dynamics, Unicycle):
        turn = dt * min(dynamics.max_angular_speed, dt * dynamics.max_angular_acceleration)
    elif isinstance(dynamics, Bicycle):
        turn = dt * speed * math.tan(dynamics.max_steering) / dynamics.wheelbase
    elif dynamics.limits[0] < math.inf:
        turn = math.inf
    else:
        return 1, 1  # its velocity can change to any other one in a step
    change = dt * float(dynamics.limits[0])  # of speed
    cells = (_HEADINGS, 8 * math.ceil(math.pi / turn / 4.0)), (_SPEEDS, speed / change + 1.0)
    headings, speeds = (min(max(least, math.ceil(number)), most) for (least, most), number in cells)
    return headings, speeds


def commands(task: Task, states: Float[np.ndarray, "state 6"]) -> Float[np.ndarray, "state action 2"]:
    """Return the commands to try in each state: some commands of the dynamics, and the one straight to the goal."""
    dynamics, dt = task.rules.dynamics, task.rules.dt
    of = State(states[:, :2], states[:, 2:4], states[:, 4], states[:, 5])
    speed = np.full(len(states), task.vehicle.max_speed)
    chosen = _OF_GRID if isinstance(dynamics, Holonomic) else _OF_REACHED
    ahead = toward_goal(of.position, np.broadcast_to(task.cost.goal, of.position.shape), speed)
    straight = dynamics.follow(of, ahead, speed, dt)
    return np.concatenate([straight[:, None], dynamics.commands(of, speed, dt)[:, chosen]], axis=1)


def _select_states(cost: Float[np.ndarray, "state"], most: int) -> Int[np.ndarray, "kept"]:
    """Return the states to expand, nearest to the goal first. If there are too many, half of them are the nearest ones.

    The others are spread evenly over the rest, because states that wait or go back must be expanded too.
    """
    order = np.argsort(cost, kind="stable")
    if len(order) <= most:
        return order
    first, rest = order[: most // 2], order[most // 2 :]
    others = np.linspace(0, len(rest) - 1, most - len(first)).astype(np.int64)
    return np.concatenate([first, rest[others]])


def _trace_back(layers: list[Layer], last: int) -> Float[np.ndarray, "step 2"]:
    """Return the commands that lead to a state of the last layer."""
    found = []
    for layer in reversed(layers):
        found.append(layer.command[last])
        last = int(layer.parent[last])
    return np.array(found[::-1])
