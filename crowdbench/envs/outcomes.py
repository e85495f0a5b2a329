"""The outcome of a step for each agent of one world: for the vehicle as in a rollout, and for each pedestrian."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.compiled import njit
from crowdbench.dynamics.motion import HOLONOMIC
from crowdbench.geometry import nearest_in_step
from crowdbench.sim.episode import StepCheck, step_outcome
from crowdbench.sim.neighbors import cells_of, nearest_in_cells
from crowdbench.sim.swept import gaps_on_arc
from crowdbench.types import Outcome, World

_MOST = 64
"""Of an agent with more others in reach, all are looked at."""

_SLACK = 1e-6
"""By how much the reach is larger than it must be, in metres, because of rounding."""


def outcomes_of_agents(
    before: World, after: World, check: StepCheck
) -> tuple[Int[np.ndarray, "agent"], Float[np.ndarray, "agent"]]:
    """Check a step of one world for all agents, by the rule for the vehicle (`crowdbench.sim.episode`).

    For a pedestrian the rule is `swept`. Agents that it cannot see do not count, because an agent cannot learn from a
    reward that its observations do not explain.

    Args:
        before: The world before the step.
        after: The world after it.
        check: What the check of the step found for the vehicle.

    Returns:
        The `Outcome` of the step for each agent, and the smallest distance in metres between its rim and another's.
    """
    agents, rules = before.radius.shape[1], before.rules
    outcomes, gaps = np.empty(agents, np.int64), np.empty(agents)
    others = before.present.copy()
    others[:, 0] &= rules.visible and rules.dynamics.code == HOLONOMIC
    _check_agents(
        rules.dynamics.code,
        rules.discs,
        rules.dt,
        rules.visible,
        before.heading,
        0.0 if rules.dynamics.code == HOLONOMIC else math.hypot(*after.velocity[0, 0]),
        after.angular_speed,
        before.position,
        after.position,
        before.goal,
        before.radius,
        before.obstacles,
        before.present,
        others,
        cells_of(before.position, others),
        *check[:2],
        outcomes,
        gaps,
    )
    return outcomes, gaps


@no_type_check
@njit
def _buffers(number):
    """Room for an agent and so many others: positions, motions, radii, that all count, neighbours, their distances."""
    agents = number + 1
    counts = np.ones(agents, np.bool_)
    arrays = np.empty((agents, 2)), np.empty((agents, 2)), np.empty(agents)
    return (*arrays, counts, np.empty(number, np.int64), np.empty(number))


@no_type_check
@njit
def _put(buffers, slot, i, position, motion, radius):
    """Write an agent into a slot of `_buffers`. The other arguments are as in `_check_agents`."""
    for axis in range(2):
        buffers[0][slot, axis], buffers[1][slot, axis] = position[0, i, axis], motion[i, axis]
    buffers[2][slot] = radius[0, i]


@no_type_check
@njit
def _gap_in_cells(i, position, motion, radius, others, cells, widest, fastest, buffers):
    """`nearest_in_step` by cells: the same gap, to the last bit.

    The gap to the others cannot be less than their distance before the step, less both radii and both motions. So only
    those count for which this is less than the gap to the nearest before the step.

    Args:
        i: The agent's index.
        position: `[world, agent, 2]`, before the step, in metres.
        motion: `[agent, 2]`, displacements in the step in metres.
        radius: `[world, agent]`, in metres.
        others: `[world, agent]`, whether each agent counts.
        cells: `Cells` of those who count.
        widest: The largest of their radii in metres.
        fastest: The longest of their displacements in metres.
        buffers: `_buffers`, overwritten.

    Returns:
        gap: In metres; infinite where no agent counts.
    """
    place, moves, radii, counts, neighbor, distance = buffers
    _put(buffers, 0, i, position, motion, radius)
    reach, limit, no_walls = np.inf, 1, np.empty((0, 0, 2))
    gap = np.inf
    for _ in range(2):
        n = nearest_in_cells(0, i, position, cells, reach, limit, False, no_walls, neighbor, distance)
        if limit > 1 and n == limit:
            gap, _ = nearest_in_step(i, position[0], motion, radius[0], others[0])
            return gap
        for k in range(n):
            _put(buffers, 1 + k, neighbor[k], position, motion, radius)
        gap, _ = nearest_in_step(0, place[: n + 1], moves[: n + 1], radii[: n + 1], counts[: n + 1])
        own = radius[0, i] + math.hypot(motion[i, 0], motion[i, 1])
        reach, limit = gap + own + widest + fastest + _SLACK, len(neighbor)
    return gap


@no_type_check
@njit
def _check_agents(
    code,
    body,
    dt,
    visible,
    heading,
    speed,
    turn_rate,
    position,
    end,
    goal,
    radius,
    obstacles,
    present,
    others,
    cells,
    outcome,
    gap,
    outcomes,
    gaps,
):
    """Check a step for the agents of one world. The axis `world` has length 1.

    Args:
        code: The code of the vehicle's dynamics.
        body: `[disc]`, where the centres of its discs are, in metres ahead of its position.
        dt: Duration of the step in seconds.
        visible: Whether pedestrians see the vehicle.
        heading: `[world]`, the vehicle's heading before the step, in radians.
        speed: The vehicle's in the step, in m/s; not used where it is holonomic.
        turn_rate: `[world]`, the vehicle's in the step, in rad/s.
        position: `[world, agent, 2]`, before the step, in metres.
        end: `[world, agent, 2]`, positions after the step in metres.
        goal: `[world, agent, 2]`, in metres.
        radius: `[world, agent]`, in metres.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        present: `[world, agent]`.
        others: `[world, agent]`, whether pedestrians see the agent and it moves straight: a vehicle on wheels does not.
        cells: `Cells` of the others, or None.
        outcome: `[world]`, the vehicle's `Outcome`.
        gap: `[world]`, the vehicle's, in metres.
        outcomes: `[agent]`, filled: an `Outcome`.
        gaps: `[agent]`, filled, in metres.
    """
    motion = np.empty(position.shape[1:])
    widest, fastest = 0.0, 0.0
    for i in range(len(motion)):
        for axis in range(2):
            motion[i, axis] = end[0, i, axis] - position[0, i, axis]
        if others[0, i]:
            widest, fastest = max(widest, radius[0, i]), max(fastest, math.hypot(motion[i, 0], motion[i, 1]))
    outcomes[0], gaps[0] = outcome[0], gap[0]
    drives_past = present[0, 0] and visible and code != HOLONOMIC
    near, pair = _buffers(_MOST), _buffers(1)
    for i in range(1, len(motion)):
        if cells is None:  # noqa: SIM114  # see `orca`
            gaps[i], _ = nearest_in_step(i, position[0], motion, radius[0], others[0])
        elif cells.size[0, 0] < 0:
            gaps[i], _ = nearest_in_step(i, position[0], motion, radius[0], others[0])
        else:
            gaps[i] = _gap_in_cells(i, position, motion, radius, others, cells, widest, fastest, near)
        if drives_past:
            _put(pair, 0, 0, position, motion, radius)
            _put(pair, 1, i, position, motion, radius)
            passed, _ = gaps_on_arc(body, heading[0], speed, turn_rate[0], dt, *pair[:4], obstacles[0, :0])
            gaps[i] = min(gaps[i], passed)
        is_last = outcomes[0] == Outcome.TIMEOUT.value
        dx, dy = goal[0, i, 0] - end[0, i, 0], goal[0, i, 1] - end[0, i, 1]
        outcomes[i] = step_outcome(gaps[i], np.inf, dx, dy, radius[0, i], is_last)
