"""A whole step of one world in one compiled call: pedestrians decide, agents move, the step is checked and observed.

It covers the usual case (see `CompiledStep.fits`) with the same kernels that other steps call one by one from Python.
Results are identical to the last bit. In a single world, entering a kernel takes longer than its computation.
"""

from __future__ import annotations

import math
from collections import namedtuple
from typing import Any, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.dynamics import DIRECT, DISC, Holonomic
from crowdbench.core.reward import fill_reward
from crowdbench.core.types import World
from crowdbench.envs.rewards import CheckedReward, crowdnav
from crowdbench.envs.step_outcomes import check_pedestrians
from crowdbench.sim.episode import check_disc
from crowdbench.sim.kernels import per_agent
from crowdbench.sim.neighbors import CELLS_FROM
from crowdbench.sim.pedestrians.orca_crowd import ORCA, avoidance_of, orca_in_one
from crowdbench.sim.simulator import After, move_agents, name_fields, state_before
from crowdbench.utils.compiled import njit
from crowdbench.views.actions import ACTIONS
from crowdbench.views.ego import AGENT_FEATURES, flatten_agents
from crowdbench.views.view import View

Margins = namedtuple("Margins", "safety_space neighbor_distance max_neighbors time_horizon")
"""Parameters of pedestrians that ORCA uses; see `crowdbench.sim.pedestrians.orca.Avoidance`."""


class Exchange(NamedTuple):
    """Observations, actions and rewards of agents.

    Attributes:
        visible: Agents that pedestrians see.
        action: Actions, NaN for agents that do not act.
        normalized: True for actions in [-1, 1], False for velocities in m/s.
        observed: Observations, filled by the kernel.
        outcome: An `Outcome` for each observer, filled by the kernel.
        gap: Smallest distances in metres, filled by the kernel.
        reward: Rewards, filled by the kernel.
    """

    visible: Bool[np.ndarray, "1 agent"]
    action: Float[np.ndarray, "agent 2"]
    normalized: bool
    observed: Float[np.ndarray, "1 observer features"]
    outcome: Int[np.ndarray, "observer"]
    gap: Float[np.ndarray, "observer"]
    reward: Float[np.ndarray, "observer"]


class CompiledStep:
    """Compiled steps of one world, which alternate between two preallocated states.

    Attributes:
        world: The current world. The step after the next one overwrites it.
        outcome: The `Outcome` of the last step, for the vehicle or for each agent: see `outcomes_of_agents`.
        gap: The smallest distance in metres between its rim and another agent's rim in that step.
        reward: Its reward in that step, as in CrowdNav.

    Args:
        world: The world at its start; see `fits`.
        view: Observations of a policy, and the interpretation of its actions.
        everybody: True if every agent observes and has a reward; False if only the vehicle does.
    """

    def __init__(self, world: World, view: View, everybody: bool) -> None:
        self._normalized, self._dtype = ACTIONS[view.action].normalized, view.dtype
        self.world = world = world.replace(**_copies(world))
        self._next = world.replace(**_copies(world))
        agents = world.radius.shape[1]
        observers = agents if everybody else 1
        self._action, self._everybody = np.empty((agents, 2)), list(range(agents))
        self._observed = np.zeros((1, observers, AGENT_FEATURES * agents))
        self.outcome, self.gap, self.reward = np.empty(observers, np.int64), np.empty(observers), np.empty(observers)
        self._arguments = [self._collect(world, self._next), self._collect(self._next, world)]

    def _collect(self, before: World, after: World) -> tuple[Any, ...]:
        """Return the arguments of the kernel for a step from one state to the other."""
        (parameters,) = before.parameters.values()
        visible = before.present.copy()
        visible[:, 0] &= before.rules.visible
        state = tuple(map(np.ascontiguousarray, state_before(before)))
        commands = np.empty((1, 2)), np.empty((1, before.radius.shape[1] - 1, 2))
        arrays = tuple(getattr(after, name) for name in After._fields)
        check = np.empty(1, np.int64), np.empty(1), np.empty(1)
        margins = tuple(map(per_agent, (parameters["safety_space"], *avoidance_of(parameters)[:3])))
        acting = visible, self._action, self._normalized
        exchange = *acting, self._observed, self.outcome, self.gap, self.reward
        return tuple(before.rules.numbers), state, commands, arrays, check, margins, exchange

    @staticmethod
    def fits(world: World, view: View, reward: CheckedReward) -> bool:
        """Return True if the compiled step supports a world, a view and a reward.

        Args:
            view: Observations of a policy, and the interpretation of its actions.
        """
        scenario, rules = view.scenario, world.rules
        is_usual = view.observation == "flat" and ACTIONS[view.action].axes == "world" and reward.reward is crowdnav
        is_plain = isinstance(rules.dynamics, Holonomic) and rules.actuation == DIRECT and rules.body == DISC
        is_alone = scenario.post_step_rule is None and rules.vehicles == 1
        sees_all = rules.sensor.sees_all and not rules.sensor.nearest
        is_orca = [type(policy) for policy in scenario.policies.values()] == [ORCA] and not rules.intentions
        everybody_sees = not rules.visible or rules.attention is None
        is_small = world.radius.shape[1] < CELLS_FROM
        is_open = not (world.route.shape[2] or world.track.shape[1] or world.obstacles.shape[1])
        return is_usual and is_plain and is_alone and sees_all and is_orca and everybody_sees and is_small and is_open

    def step(
        self, columns: int | list[int], actions: Float[np.ndarray, "*acting 2"]
    ) -> Float[np.ndarray, "observer features"]:
        """Simulate a step.

        Args:
            columns: Indices of the agents that act; others follow the scenario's policy.
            actions: Their actions.

        Returns:
            The observation after the step.
        """
        if columns == self._everybody:  # several times faster than an index of each agent
            self._action[:] = actions
        else:
            self._action.fill(np.nan)
            self._action[columns] = actions
        _step_and_observe(*self._arguments[0])
        self._arguments.reverse()
        self.world, self._next = self._next, self.world
        return self._observed[0].astype(self._dtype)


def _copies(world: World) -> dict[str, np.ndarray]:
    """Return copies of the arrays that a step replaces."""
    return {name: np.array(getattr(world, name), order="C") for name in After._fields}


@no_type_check
@njit(nogil=True)
def _step_and_observe(numbers, state, commands, arrays, check, margins, exchange):
    """Simulate all of a step, in one kernel.

    Args:
        numbers (tuple): The fields of `RuleNumbers`.
        state (tuple): The fields of `Before`.
        commands (tuple): The fields of `Commands`, filled.
        arrays (tuple): The fields of `After`, filled.
        check (tuple): The fields of `StepCheck`, filled.
        margins (tuple): The fields of `Margins`.
        exchange (tuple): The fields of `Exchange`.
    """
    rules, before, orders, after, result = name_fields(numbers, state, commands, arrays, check)
    limits, agents = Margins(*margins), Exchange(*exchange)
    goal, speed, radius, crowd = before.goal, before.preferred_speed, before.radius, orders.crowd
    action, visible, outcome, gap = agents.action, agents.visible, agents.outcome, agents.gap
    if agents.normalized:
        for a in range(len(action)):
            for k in range(2):
                action[a, k] = 0.0 + min(max(action[a, k], -1.0), 1.0) * speed[0, a]  # 0.0 + x is never -0.0
    is_asked = False
    for a in range(1, len(action)):
        is_asked = is_asked or (before.present[0, a] and math.isnan(action[a, 0]))
    if is_asked:
        seen = before.position, before.velocity, radius, speed, visible
        avoidance = limits.neighbor_distance, limits.max_neighbors, limits.time_horizon
        orca_in_one(goal, speed, limits.safety_space, *seen, rules.dt, *avoidance, crowd)
    for a in range(1, len(action)):
        if not math.isnan(action[a, 0]):
            crowd[0, a - 1, 0], crowd[0, a - 1, 1] = action[a, 0], action[a, 1]
    orders.vehicle[0, 0], orders.vehicle[0, 1] = action[0, 0], action[0, 1]
    move_agents(rules, before, orders, after)
    check_disc(rules, before, after, result)
    outcome[0], gap[0] = result.outcome[0], result.gap[0]
    if len(outcome) > 1:
        check_pedestrians(before.position, after.position, goal, radius, visible, None, None, outcome, gap)
    fill_reward(outcome, gap, rules.dt, agents.reward)
    moved = after.position, after.velocity, radius, goal, speed, before.present
    flatten_agents(*moved, visible, agents.observed)
