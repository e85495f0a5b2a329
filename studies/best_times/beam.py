"""Beam search for commands with the least time plus seconds close to pedestrians, given the pedestrians' future.

A layer has the states after a number of steps, each with a world of its own, which the simulator advances. States that
cannot arrive within a bound are discarded. The bound grows until commands are found, is bisected, and then searches
with other candidates try to improve them. The result is the best known one, never proved to be optimal.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench import Cases, Scenario, World
from crowdbench.core import (
    PERFECT_SENSOR,
    REACHABLE_SPEEDS,
    REACHABLE_TURNS,
    Holonomic,
    State,
    norm,
    toward_goal,
)
from studies.best_times.crowds import Crowds
from studies.best_times.successors import Successors, fill_successors, steps_left
from studies.best_times.task import Task

QUANTUM = 1e-4
"""Unit in which the numbers of commands are stored, in m/s, rad/s or rad."""

WIDTH = 256
HEADINGS, SPEEDS = 32, (1.0, 0.6, 0.3)
"""Candidates of a holonomic vehicle: headings relative to the goal, and speeds as shares of the largest one."""

_ON_WHEELS = (
    np.array([0, 2, 3, REACHABLE_SPEEDS - 1])[:, None] * REACHABLE_TURNS + np.arange(0, REACHABLE_TURNS, 2)
).reshape(-1)
"""Candidates of a vehicle on wheels: four speeds and seven turns."""

_FINE, _COARSE = 0.1, 0.4
"""Sides in metres of the cells with one state each, and of those among which half of a layer is spread."""

GAIN = 0.01
"""Smallest improvement in seconds for which a search continues."""

Commands = Float[np.ndarray, "step 2"]
Cells = Int[np.ndarray, "state 4"]


class Shape(NamedTuple):
    """Parameters of a search that restarts vary.

    Attributes:
        width: Number of states of a layer.
        cells: Factor of the sides of the cells.
        heading: Offset of the candidates' headings in radians.
        turn: Factor of the turns of a vehicle on wheels.
    """

    width: int = WIDTH
    cells: float = 1.0
    heading: float = 0.0
    turn: float = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator, width: int) -> Shape:
        """Draw other parameters."""
        heading = rng.uniform(-0.5, 0.5) * 2.0 * math.pi / HEADINGS
        return cls(width, rng.uniform(0.6, 1.4), heading, rng.uniform(0.5, 1.0))


class Found(NamedTuple):
    """Commands of a case.

    Attributes:
        cost: Time plus seconds close to pedestrians, as the search estimates them; infinite without commands.
        commands: The commands of each step.
    """

    cost: float = math.inf
    commands: Commands = np.empty((0, 2))


def search_case(scenario: Scenario, case: int, seconds: float, seed: int = 0) -> Found:
    """Search for commands in a validation case.

    Args:
        scenario: The scenario.
        case: The number of the case.
        seconds: Processor time after which found commands are not improved further.
        seed: Seed of the restarts.
    """
    # The vehicle's sensor does not affect pedestrians.
    scenario = dataclasses.replace(scenario, rules=dataclasses.replace(scenario.rules, sensor=PERFECT_SENSOR))
    world = scenario.worlds(Cases("val", case, case + 1))
    task = Task.of(world)
    dt, deadline = task.rules.dt, time.process_time() + seconds
    least = low = _least_time(task)
    longest = least + task.max_steps * dt
    for k in itertools.count():
        bound = min(least + 2.0 * (2**k - 1) * dt, longest)
        found = search(scenario, world, task, bound, Shape())
        if len(found.commands):
            break
        if bound == longest:
            return found
        low = bound
    while found.cost - low > dt and time.process_time() < deadline:
        middle = 0.5 * (low + found.cost)
        better = search(scenario, world, task, middle, Shape(), deadline)
        found, low = (better, low) if len(better.commands) else (found, middle)
    rng = np.random.default_rng([case, seed])
    for attempt in itertools.count():
        if time.process_time() >= deadline or found.cost <= least:
            return found
        shape = Shape.draw(rng, WIDTH * 2 ** min(attempt // 4, 3))
        # A lower bound discards more states: some of the searches hope for more.
        bound = found.cost - GAIN - 0.5 * rng.random() ** 2 * (found.cost - least)
        better = search(scenario, world, task, bound, shape, deadline)
        found = better if len(better.commands) else found
    return found


def _least_time(task: Task) -> float:
    """Return a lower bound in seconds for the time to the goal."""
    x, y, vx, vy = task.start[:4]
    tolerance, dt = task.vehicle.tolerance, task.rules.dt
    length = math.dist((x, y), task.cost.goal)
    limits = math.hypot(vx, vy), task.vehicle.max_speed, task.rules.dynamics.limits[0] * dt
    return max(math.ceil(steps_left(length, *limits, tolerance, dt) - 1e-6), 1) * dt


def search(
    scenario: Scenario, world: World, task: Task, bound: float, shape: Shape, deadline: float = math.inf
) -> Found:
    """Return the best commands of one beam.

    Args:
        scenario: The scenario.
        world: Its world at the start.
        task: The search problem of the vehicle.
        bound: Largest cost in seconds.
        shape: Parameters of the search.
        deadline: Processor time at which the search ends.
    """
    dt, crowd = task.rules.dt, Crowds(scenario, world)
    states, close = task.start[None], np.zeros(1)
    parents, chosen, found = list[Int[np.ndarray, "state"]](), list[Commands](), Found()
    for t in range(task.max_steps - 1):  # the last step is a time-out in any case
        commands = candidates(task, states, shape)
        new = Successors.empty(*commands.shape[:2])
        step = crowd.ahead()
        fill_successors(task.vehicle, task.cost, states, close, commands, step, bound - t * dt + 1e-9, new)
        if new.arrived.any():
            s, a = np.unravel_index(np.where(new.arrived, new.close, np.inf).argmin(), new.close.shape)
            bound = (t + 1) * dt + float(new.close[s, a])
            last = _trace_back(parents, chosen, int(s))
            found = Found(bound, np.concatenate([last, commands[s, a][None]]))
            bound -= GAIN
        parent, action = select(new, shape, float(task.rules.dynamics.limits[0]) * dt)
        if not len(parent) or time.process_time() > deadline:
            return found
        parents.append(parent)
        chosen.append(commands[parent, action])
        states, close = new.state[parent, action], new.close[parent, action]
        crowd = crowd.after(parent, chosen[-1])
    return found


def _trace_back(parents: list[Int[np.ndarray, "state"]], chosen: list[Commands], state: int) -> Commands:
    """Return the commands that lead to a state of the last layer."""
    commands = []
    for parent, command in zip(reversed(parents), reversed(chosen), strict=True):
        commands.append(command[state])
        state = int(parent[state])
    return np.array(commands[::-1]).reshape(-1, 2)


def candidates(task: Task, states: Float[np.ndarray, "state 6"], shape: Shape) -> Float[np.ndarray, "state action 2"]:
    """Return the commands to try in each state, in whole multiples of `QUANTUM`."""
    dynamics, dt, most = task.rules.dynamics, task.rules.dt, task.vehicle.max_speed
    of, speed = State(states[:, :2], states[:, 2:4], states[:, 4], states[:, 5]), np.full(len(states), most)
    goal = np.broadcast_to(task.cost.goal, of.position.shape)
    straight = dynamics.follow(of, toward_goal(of.position, goal, speed), speed, dt)[:, None]
    if isinstance(dynamics, Holonomic):
        ahead = np.arctan2(*(goal - of.position).T[::-1])
        angle = ahead[:, None] + shape.heading + np.arange(HEADINGS) * (2.0 * np.pi / HEADINGS)
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=2)
        moving = np.concatenate([share * most * direction for share in SPEEDS], axis=1)
        tried = [straight, np.zeros_like(straight), moving]
    else:
        tried = [straight, dynamics.commands(of, speed, dt)[:, _ON_WHEELS] * [1.0, shape.turn]]
    return as_stored(np.concatenate(tried, axis=1)) * QUANTUM


def as_stored(commands: Float[np.ndarray, "*batch 2"]) -> Int[np.ndarray, "*batch 2"]:
    """Return commands in whole multiples of `QUANTUM`, rounded towards 0 so that no limit is exceeded."""
    return np.trunc(commands / QUANTUM + 1e-6 * np.sign(commands)).astype(np.int16)


def select(new: Successors, shape: Shape, change: float) -> tuple[Int[np.ndarray, "kept"], Int[np.ndarray, "kept"]]:
    """Return the states and actions of the successors to keep.

    One successor per fine cell counts. Half of the width are those with the least expected cost. The others are taken
    in turns from coarse cells of position and heading, because states that wait or make room must be kept, too.

    Args:
        new: The successors.
        shape: Parameters of the search.
        change: Largest change of speed in a step in m/s, infinite without a limit.
    """
    rank = new.close + new.left
    parent, action = np.nonzero(np.isfinite(new.left) & ~new.arrived)
    rank, state = rank[parent, action], new.state[parent, action]
    order = np.argsort(rank, kind="stable")
    order = order[_first_of_each(_cells(state[order], _FINE * shape.cells, 32, change))]
    half = shape.width // 2
    best, rest = order[:half], order[half:]
    cell = np.unique(_cells(state[rest], _COARSE * shape.cells, 8, math.inf), axis=0, return_inverse=True)[1].reshape(
        -1
    )
    by_cell = np.argsort(cell, kind="stable")
    begin = np.searchsorted(cell[by_cell], cell[by_cell])
    turn = np.empty(len(rest), np.int64)
    turn[by_cell] = np.arange(len(rest)) - begin
    spread = rest[np.argsort(turn, kind="stable")][: shape.width - half]
    kept = np.concatenate([best, spread])
    return parent[kept], action[kept]


def _cells(state: Float[np.ndarray, "state 6"], side: float, headings: int, speed: float) -> Cells:
    """Return the cells of states: position, heading and speed.

    Args:
        state: The states, as in `Successors`.
        side: Side in metres.
        headings: Number of headings.
        speed: Side in m/s.
    """
    heading = np.rint(state[:, 4] * headings / (2.0 * np.pi)) % headings
    speeds = np.rint(norm(state[:, 2:4]) / speed)
    return np.column_stack([np.floor(state[:, :2] / side), heading, speeds]).astype(np.int64)


def _first_of_each(cells: Cells) -> Int[np.ndarray, "kept"]:
    """Return the index of the first state in each cell, in order."""
    return np.sort(np.unique(cells, axis=0, return_index=True)[1])
