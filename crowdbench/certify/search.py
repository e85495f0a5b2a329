"""Looks for commands that take the vehicle to its goal: breadth first, step by step, with foresight of the crowd.

This is reachability in space and time (the vehicle's configuration and the time make its state, as in Fraichard 1998),
on a grid of cells in each of which one state goes on. The first layer in which a state has arrived ends the search, so
that no faster way was found on this grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.certify.crowds import Crowd
from crowdbench.certify.expand import expand
from crowdbench.certify.ways import CELL, Ways
from crowdbench.dynamics import Bicycle, Dynamics, Holonomic, State, Unicycle
from crowdbench.dynamics.grids import HEADINGS, REACHED, SPEEDS, TURNS
from crowdbench.geometry import toward_goal
from crowdbench.types import Rules, World

_HEADINGS, _SPEEDS = (16, 96), (4, 8)
"""The least and the largest number of cells of headings and speeds, where the vehicle cannot change them at once."""

_OF_STEP = 0.8
"""A cell of positions is no larger than this share of the farthest way in a step, or the vehicle would stay in it."""

_OF_GRID = np.array([0, *(1 + (speed - 1) * HEADINGS + k for speed in (3, SPEEDS) for k in range(HEADINGS))])
"""Of the commands of a holonomic vehicle: to stand, and two speeds in all headings."""

_OF_REACHED = np.array([speed * TURNS + turn for speed in (0, 3, REACHED - 1) for turn in range(0, TURNS, 3)])
"""Of those of a vehicle on wheels: three speeds and five turns."""


@dataclass(frozen=True)
class Effort:
    """How thoroughly is searched.

    Attributes:
        cell: Side of the cells of positions in metres.
        states: How many states of a layer go on.
    """

    cell: float
    states: int


class Found(NamedTuple):
    """What a search has found.

    Attributes:
        commands: The commands of each step until the vehicle arrives; None if none are found.
        is_exhaustive: Whether no state was left out but for others in the same cell.
    """

    commands: Float[np.ndarray, "step 2"] | None
    is_exhaustive: bool


@dataclass(frozen=True)
class Task:
    """The way of one vehicle that is looked for.

    Attributes:
        rules: The rules of the scenario.
        start: Position, velocity, heading and turn rate at the start.
        goal: In metres.
        radius: The vehicle's, in metres.
        max_speed: Its preferred and largest speed in m/s.
        obstacles: Polygons in metres.
        ways: The ways to the goal.
    """

    rules: Rules
    start: Float[np.ndarray, "6"]
    goal: Float[np.ndarray, "2"]
    radius: float
    max_speed: float
    obstacles: Float[np.ndarray, "polygon corner 2"]
    ways: Ways

    @classmethod
    def of(cls, world: World, row: int) -> Task:
        """The task in one of several worlds at their start."""
        position, goal, radius = world.position[row, 0], world.goal[row, 0], float(world.radius[row, 0])
        turning = world.heading[row], world.angular_speed[row]
        return cls(
            world.rules,
            np.array([*position, *world.velocity[row, 0], *turning]),
            goal.copy(),
            radius,
            float(world.preferred_speed[row, 0]),
            np.ascontiguousarray(world.obstacles[row]),
            Ways.of(position, goal, radius, world.obstacles[row]),
        )


def search(task: Task, crowd: Crowd, margin: float, effort: Effort) -> Found:
    """Look for commands by which the vehicle succeeds.

    Args:
        task: Where it goes.
        crowd: The crowd at the start.
        margin: Smallest gap to pedestrians and obstacles on the way, in metres.
        effort: How thoroughly to search.

    Returns:
        What is found.
    """
    states, layers, is_exhaustive = task.start[None], list[_Layer](), True
    grid = _Grid.of(task, effort)
    for left in reversed(range(task.rules.max_steps - 1)):  # the last step is a time-out in any case
        layer, arrived, is_cut = grid.expanded(states, crowd, margin, left)
        if arrived >= 0:
            return Found(_backwards([*layers, layer], arrived), is_exhaustive)
        kept = _kept(layer.way, effort.states)
        is_exhaustive &= not is_cut and len(kept) == len(layer.way)
        if not len(kept):
            break
        layer = layer.take(kept)
        crowd = crowd.after(layer.parent, layer.command)
        states = layer.state
        layers.append(layer)
    return Found(None, is_exhaustive)


class _Layer(NamedTuple):
    """The states after a step.

    Attributes:
        state: Position, velocity, heading and turn rate.
        way: The way left in metres.
        parent: The state of the layer before that each comes from.
        command: The command by which.
    """

    state: Float[np.ndarray, "state 6"]
    way: Float[np.ndarray, "state"]
    parent: Int[np.ndarray, "state"]
    command: Float[np.ndarray, "state 2"]

    def take(self, rows: Int[np.ndarray, "row"]) -> _Layer:
        return _Layer(*(each[rows] for each in self))


@dataclass(frozen=True)
class _Grid:
    """The cells of states, and the arrays in which layers are made."""

    task: Task
    cell: float
    number: Int[np.ndarray, "4"]
    table: Int[np.ndarray, "cell"]
    layer: _Layer

    @classmethod
    def of(cls, task: Task, effort: Effort) -> _Grid:
        cell = min(effort.cell, _OF_STEP * task.max_speed * task.rules.dt)
        positions = np.ceil((task.ways.high - task.ways.low) / cell).astype(np.int64)
        number = np.array([*positions, *_turns_and_speeds(task)])
        most = min(int(number.prod()), 4 * effort.states) + 1
        arrays = np.empty((most, 6)), np.empty(most), np.empty(most, np.int64), np.empty((most, 2))
        return cls(task, cell, number, np.full(int(number.prod()), -1, np.int32), _Layer(*arrays))

    def expanded(
        self, states: Float[np.ndarray, "state 6"], crowd: Crowd, margin: float, left: int
    ) -> tuple[_Layer, int, bool]:
        """The next layer, which of its states has arrived, -1 if none, and whether states were left out.

        Args:
            states: Those of this layer.
            crowd: The crowd around them.
            margin: Smallest gap in metres.
            left: Steps after this one.
        """
        task, rules, ways = self.task, self.task.rules, self.task.ways
        self.table.fill(-1)
        tolerance = rules.goal_tolerance or task.radius
        count, arrived, is_cut = expand(
            rules.dynamics.code,
            rules.dynamics.limits,
            rules.discs,
            tolerance,
            rules.collision_code,
            rules.dt,
            task.max_speed,
            margin,
            tolerance + (left + 1) * rules.dt * task.max_speed,
            states,
            commands(rules.dynamics, states, task),
            crowd.rows(len(states)),
            *crowd.ahead(),
            task.obstacles,
            task.goal,
            ways.length,
            ways.low,
            CELL,
            ways.low,
            self.cell,
            self.number,
            self.table,
            *self.layer,
        )
        return self.layer.take(np.arange(count)), arrived, is_cut


def _turns_and_speeds(task: Task) -> tuple[int, int]:
    """The numbers of cells of headings and speeds, so small that a step leads from one into the next."""
    dynamics, dt, speed = task.rules.dynamics, task.rules.dt, task.max_speed
    if isinstance(dynamics, Unicycle):
        turn = dt * min(dynamics.max_angular_speed, dt * dynamics.max_angular_acceleration)
    elif isinstance(dynamics, Bicycle):
        turn = dt * speed * math.tan(dynamics.max_steering) / dynamics.wheelbase
    elif dynamics.limits[0] < math.inf:
        turn = math.inf
    else:
        return 1, 1  # its velocity can be any other one after the step
    change = dt * float(dynamics.limits[0])  # of speed
    return _between(_HEADINGS, 8 * math.ceil(math.pi / turn / 4.0)), _between(_SPEEDS, speed / change + 1.0)


def _between(bounds: tuple[int, int], number: float) -> int:
    return min(max(bounds[0], math.ceil(number)), bounds[1])


def commands(
    dynamics: Dynamics, states: Float[np.ndarray, "state 6"], task: Task
) -> Float[np.ndarray, "state action 2"]:
    """The commands that are tried in each state: some of those of the dynamics, and the one straight to the goal.

    Args:
        dynamics: Of the vehicle.
        states: Position, velocity, heading and turn rate of each.
        task: Where it goes.
    """
    of = State(states[:, :2], states[:, 2:4], states[:, 4], states[:, 5])
    speed = np.full(len(states), task.max_speed)
    chosen = _OF_GRID if isinstance(dynamics, Holonomic) else _OF_REACHED
    ahead = toward_goal(of.position, np.broadcast_to(task.goal, of.position.shape), speed)
    straight = dynamics.follow(of, ahead, speed, task.rules.dt)
    grid = dynamics.commands(of, speed, task.rules.dt)[:, chosen]
    return np.concatenate([straight[:, None], grid], axis=1)


def _kept(way: Float[np.ndarray, "state"], most: int) -> Int[np.ndarray, "kept"]:
    """Which states go on, those nearest to the goal first: where there are too many, half of them are the nearest ones.

    The others are spread evenly over the rest, because those who wait or go back must go on too.
    """
    order = np.argsort(way, kind="stable")
    if len(order) <= most:
        return order
    first, rest = order[: most // 2], order[most // 2 :]
    others = np.linspace(0, len(rest) - 1, most - len(first)).astype(np.int64)
    return np.concatenate([first, rest[others]])


def _backwards(layers: list[_Layer], last: int) -> Float[np.ndarray, "step 2"]:
    """The commands that lead to a state of the last layer."""
    found = []
    for layer in reversed(layers):
        found.append(layer.command[last])
        last = int(layer.parent[last])
    return np.array(found[::-1])
