"""A whole step of one world in one compiled call: people decide, everybody moves, the step is checked and observed.

It is for the usual case, and what it does is put together of the kernels that every other step takes one after another,
so that the results are the same to the last bit. In one world, most of a step is the way into kernels.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.dynamics import DISC, Holonomic
from crowdbench.core.reward import fill_reward
from crowdbench.core.types import RuleNumbers, World
from crowdbench.envs.observations import AGENT_FEATURES, flatten_agents, states_of
from crowdbench.envs.rewards import CheckedReward, crowdnav
from crowdbench.envs.views import View
from crowdbench.sim.episode import StepCheck, check_step
from crowdbench.sim.neighbors import CELLS_FROM
from crowdbench.sim.pedestrians.orca_crowd import ORCA, ORDER, orca_in_one
from crowdbench.sim.simulator import After, Before, move_agents
from crowdbench.utils.compiled import njit


class CompiledStep:
    """Steps of one world between two states that take turns, so that nothing is made anew.

    Attributes:
        world: The world as it is now. The step after the next one changes it.
        outcome: The `Outcome` of the last step.
        gap: The smallest distance in metres to a pedestrian's rim in it.
        reward: Its reward, that of CrowdNav.

    Args:
        world: The world at its start; see `fits`.
    """

    def __init__(self, world: World) -> None:
        self.world = world = world.replace(**_copies(world))
        self._next = world.replace(**_copies(world))
        (name,) = world.parameters
        present = world.present.copy()
        present[:, 0] &= world.rules.visible
        limits = ORDER(world.parameters[name])
        pedestrians = world.radius.shape[1] - 1
        self._command, crowd = np.empty((1, 2)), np.empty((1, pedestrians, 2))
        self._check = StepCheck(np.empty(1, np.int64), np.empty(1), np.empty(1))
        self._observed, self._reward = np.zeros((1, 1, AGENT_FEATURES * (1 + pedestrians))), np.empty(1)
        own = world.parameters[name]["safety_space"], present, *limits
        seen = states_of(world)[-1]
        self._arguments = [
            (
                *world.rules.numbers,
                *map(np.ascontiguousarray, (getattr(before, field) for field in Before._fields)),
                *(self._command, crowd),
                *(getattr(after, field) for field in After._fields),
                *self._check,
                *map(np.ascontiguousarray, own),
                *(self._observed, seen, self._reward),
            )
            for before, after in ((world, self._next), (self._next, world))
        ]

    @staticmethod
    def fits(world: World, view: View, reward: CheckedReward) -> bool:
        """Whether a step takes nothing but what is compiled here.

        Args:
            world: One world.
            view: What a policy sees, and what its actions mean.
            reward: What it is given for a step.
        """
        scenario, rules = view.scenario, world.rules
        is_usual = view.observation == "flat" and view.action == "world" and reward.reward is crowdnav
        is_alone = isinstance(rules.dynamics, Holonomic) and rules.body == DISC and scenario.renewal is None
        sees_all = rules.sensor.sees_all and not rules.sensor.nearest
        is_orca = [type(policy) for policy in scenario.policies.values()] == [ORCA]
        everybody_sees = not rules.visible or rules.sees_vehicle >= 1.0
        is_small = world.radius.shape[1] < CELLS_FROM and not world.route.shape[2] and not world.track.shape[1]
        return is_usual and is_alone and sees_all and is_orca and everybody_sees and is_small

    def step(self, command: Float[np.ndarray, "2"]) -> Float[np.ndarray, "features"]:
        """Simulate a step, and return what the vehicle sees after it.

        Args:
            command: The vehicle's velocity in m/s.
        """
        self._command[0] = command
        _step_and_observe(*self._arguments[0])
        self._arguments.reverse()
        self.world, self._next = self._next, self.world
        self.outcome, self.gap = int(self._check.outcome[0]), float(self._check.gap[0])
        self.reward = float(self._reward[0])
        return self._observed[0, 0].copy()


def _copies(world: World) -> dict[str, np.ndarray]:
    """Copies of what a step makes anew."""
    return {name: np.array(getattr(world, name), order="C") for name in After._fields}


@no_type_check
@njit
def _step_and_observe(*arrays):
    """Takes what `crowdbench.sim.simulator` gives its step; margins, who is there for ORCA, and ORCA's parameters; what
    is observed `[1, 1, features]`, whom others see, and rewards. Commands of pedestrians, the state after the step, its
    check, what is observed and rewards are filled."""
    rules, before = RuleNumbers(*arrays[:7]), Before(*arrays[7:18])
    command, crowd = arrays[18:20]
    after, check = After(*arrays[20:26]), StepCheck(*arrays[26:29])
    margin, present, limits = arrays[29], arrays[30], arrays[31:36]
    observed, seen, rewards = arrays[36:]
    goal, speed, radius = before.goal, before.preferred_speed, before.radius
    state = before.position, before.velocity, radius, speed, present
    orca_in_one(goal, speed, margin, crowd, *state, rules.dt, before.obstacles, *limits)
    move_agents(rules, before, command, crowd, after)
    check_step(rules, before, after, check)
    fill_reward(check.outcome, check.gap, rules.dt, rewards)
    flatten_agents(after.position, after.velocity, radius, goal, speed, before.present, seen, observed)
