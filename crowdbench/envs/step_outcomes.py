"""The outcome of a step for each agent of one world: for the vehicle as in a rollout, and for each pedestrian."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Int

from crowdbench.core.arrays import PerAgent
from crowdbench.core.dynamics.kernels import HOLONOMIC, signed_speed
from crowdbench.core.geometry import Discs, nearest_in_step
from crowdbench.core.types import Outcome, World
from crowdbench.sim.episode import StepCheck, gaps_on_arc, step_outcome
from crowdbench.sim.neighbors import cells_of, nearest_in_cells
from crowdbench.utils.compiled import njit

_MAX_NEIGHBORS = 64
"""Largest number of neighbours in reach; an agent with more is compared with all agents."""

_SLACK = 1e-6
"""Margin in metres that is added to the reach because of rounding."""


def outcomes_of_agents(before: World, after: World, check: StepCheck) -> tuple[Int[np.ndarray, "agent"], PerAgent]:
    """Check a step of one world for all agents, by the rule for the vehicle (`crowdbench.sim.episode`).

    For a pedestrian the rule is `swept`. Agents that it cannot see do not count, because an agent cannot learn from a
    reward that its observations do not explain.

    Args:
        before: The world before the step.
        after: The world after it.
        check: Result of the check of the step for the vehicle.

    Returns:
        The `Outcome` of the step for each agent, and the smallest distance in metres between its rim and another rim.
    """
    agents, rules = before.radius.shape[1], before.rules
    outcomes, gaps = np.empty(agents, np.int64), np.empty(agents)
    outcomes[0] = check.outcome.min()  # running until all vehicles have ended
    on_wheels = rules.dynamics.code != HOLONOMIC
    counts = before.present.copy()
    counts[:, : rules.vehicles] &= rules.visible
    counts[:, 0] &= not on_wheels
    arc = None
    if on_wheels and rules.visible and before.present[0, 0]:
        speed = signed_speed(*after.velocity[0, 0], after.heading[0])
        turn_rate = float(after.angular_speed[0])
        arc = rules.numbers.body, float(before.heading[0]), speed, turn_rate, rules.dt
    states = before.position, after.position, before.goal, before.radius, counts
    check_pedestrians(*states, arc, cells_of(before.position, counts), outcomes, gaps)
    outcomes[: rules.vehicles], gaps[: rules.vehicles] = check.outcome, check.gap
    return outcomes, gaps


@no_type_check
@njit
def _chosen(i, others, agents):
    """Return agent i, followed by the agents with the indices `others`, as `Discs` that all count."""
    index = np.empty(len(others) + 1, np.int64)
    index[0], index[1:] = i, others
    return Discs(agents.position[index], agents.motion[index], agents.radius[index], np.ones(len(index), np.bool_))


@no_type_check
@njit
def _gap_in_cells(i, position, agents, cells, widest, fastest):
    """Compute the gap of `nearest_in_step` with a grid of cells; results are identical to the last bit.

    The gap to an agent is at least the distance before the step minus both radii and both displacements. Only agents
    for which this bound is less than the gap to the agent nearest before the step are compared.

    Args:
        i: The agent's index.
        position: `[world, agent, 2]`, before the step, in metres.
        agents: The same agents as `Discs`.
        cells: `Cells` of the agents that count.
        widest: The largest of their radii in metres.
        fastest: The longest of their displacements in metres.

    Returns:
        gap: In metres; infinite if no agent counts.
    """
    neighbor, distance = np.empty(_MAX_NEIGHBORS, np.int64), np.empty(_MAX_NEIGHBORS)
    n = nearest_in_cells(0, i, position, cells, np.inf, 1, None, neighbor, distance)
    gap, _ = nearest_in_step(0, _chosen(i, neighbor[:n], agents))
    size = agents.radius[i] + math.hypot(agents.motion[i, 0], agents.motion[i, 1])
    reach = gap + size + widest + fastest + _SLACK
    n = nearest_in_cells(0, i, position, cells, reach, _MAX_NEIGHBORS, None, neighbor, distance)
    gap, _ = nearest_in_step(i, agents) if n == _MAX_NEIGHBORS else nearest_in_step(0, _chosen(i, neighbor[:n], agents))
    return gap


@no_type_check
@njit
def check_pedestrians(position, end, goal, radius, counts, arc, cells, outcomes, gaps):
    """Check a step for the pedestrians of one world.

    Args:
        position (ndarray): `[1, agent, 2]`, before the step, in metres, as are all lengths.
        end (ndarray): `[1, agent, 2]`, after the step.
        goal (ndarray): `[1, agent, 2]`.
        radius (ndarray): `[1, agent]`.
        counts (ndarray): `[1, agent]`, True for agents that pedestrians see and that move straight, unlike a vehicle on
            wheels.
        arc (tuple or None): Motion of a visible vehicle on wheels: the first arguments of `gaps_on_arc`.
        cells (Cells or None): Cells of the agents that count.
        outcomes (ndarray): `[agent]`, filled for pedestrians: an `Outcome`.
        gaps (ndarray): `[agent]`, filled for pedestrians, in metres.
    """
    motion = end[0] - position[0]
    widest, fastest = 0.0, 0.0
    for i in range(len(motion)):
        if counts[0, i]:
            widest = max(widest, radius[0, i])
            fastest = max(fastest, math.hypot(motion[i, 0], motion[i, 1]))
    agents = Discs(position[0], motion, radius[0], counts[0])
    is_last = outcomes[0] == Outcome.TIMEOUT.value
    for i in range(1, len(motion)):
        if cells is None:
            gaps[i], _ = nearest_in_step(i, agents)
        else:
            gaps[i] = _gap_in_cells(i, position, agents, cells, widest, fastest)
        if arc is not None:
            body, heading, speed, turn_rate, dt = arc
            pair = _chosen(0, np.full(1, i), agents)
            passed, _ = gaps_on_arc(body, heading, speed, turn_rate, dt, pair, np.empty((0, 0, 2)))
            gaps[i] = min(gaps[i], passed)
        dx, dy = goal[0, i, 0] - end[0, i, 0], goal[0, i, 1] - end[0, i, 1]
        outcomes[i] = step_outcome(gaps[i], np.inf, dx, dy, radius[0, i], is_last)
