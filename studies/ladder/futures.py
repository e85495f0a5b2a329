"""The futures of a crowd, simulated from its true state with some of the knowledge that the simulator has."""

from __future__ import annotations

import dataclasses
import enum
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench import ORCA, Observation, Prediction, Predictor, Scenario, World
from crowdbench.core import continuation_keys, norm
from crowdbench.sim import crowd_decisions, forget_vehicle, has_attention, move

AWAY = 1e3
"""Distance in metres from the vehicle to which pedestrians that leave are moved, so that no sequence meets them."""

FUTURES = 8
"""Number of futures if futures are random."""

ASSUMED = "assumed"
"""The assumed policy of all pedestrians if only goals are known: ORCA with its default parameters."""


class Knowledge(enum.IntEnum):
    """Knowledge of the crowd beside its true state; each kind includes the kinds before it.

    `GOALS`: goals and preferred speeds. `POLICIES`: policies with their parameters, and reactions to the vehicle.
    `ATTENTION`: which pedestrians have noticed the vehicle, and the reaction of each. `ALL`: the true future.
    """

    GOALS = 0
    POLICIES = 1
    ATTENTION = 2
    ALL = 3


class Simulated(Predictor):
    """Predictor that simulates the crowd. Pedestrians that spawn later are not predicted; those that leave are gone.

    Without knowledge of policies all walk by ORCA and ignore the vehicle; standing pedestrians remain standing. Without
    knowledge of attention no pedestrian has noticed the vehicle yet, and reactions are drawn again in each future.
    Except in the true future, later turns and stops are drawn again too, and no pedestrian avoids those that spawn
    later.

    Args:
        scenario: The scenario.
        knows: The knowledge.
    """

    privileged: ClassVar[bool] = True

    def __init__(self, scenario: Scenario, knows: Knowledge) -> None:
        if knows < Knowledge.ALL and scenario.crowd.arrival == "respawn":
            scenario = dataclasses.replace(scenario, crowd=dataclasses.replace(scenario.crowd, arrival="leave"))
        self.scenario, self.knows = scenario, knows
        self.futures = FUTURES if has_chance(scenario, knows) else 1
        self._world: World

    def foresee(self, world: World) -> None:
        """Store the current worlds, before their observation."""
        self._world = world

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`. The vehicle is assumed to stand."""
        return self.predict_given(obs, steps, np.zeros((len(obs), steps, 2)))

    def predict_given(self, obs: Observation, steps: int, plan: Float[np.ndarray, "world time 2"]) -> Prediction:
        """See `Predictor`."""
        row = np.tile(np.arange(len(obs)), self.futures)
        world, position = self._known(self._world.take(row)), []
        policies = {ASSUMED: ORCA()} if self.knows == Knowledge.GOALS else self.scenario.policies
        before, person = world.position[:, 1:], world.person
        gone, everywhere = ~world.present[:, 1:], np.ones(len(world), bool)
        for t in range(steps):
            crowd, world = crowd_decisions(world, policies)
            stands = self.scenario.crowd.stands[world.policy]
            world, _ = move(world, plan[row, t], np.where(stands[..., None], 0.0, crowd))
            if self.scenario.post_step_rule is not None:
                world = self.scenario.post_step_rule(world, everywhere)
            leaves = ~gone & (~world.present[:, 1:] | (world.person != person))
            gone |= leaves
            before = np.where(gone[..., None], before, world.position[:, 1:])
            before = np.where(leaves[..., None], _away(before, world.position[:, :1]), before)
            position.append(before)
        shape = (self.futures, len(obs), steps, *before.shape[1:])
        found = np.stack(position, axis=1).reshape(shape).swapaxes(0, 1)
        start = np.broadcast_to(obs.pedestrians.position[:, None, None], (*found.shape[:2], 1, *found.shape[3:]))
        return Prediction(found, np.diff(found, axis=2, prepend=start) / obs.dt)

    def _known(self, world: World) -> World:
        """Return the worlds of all futures, with assumptions in place of unknown parts."""
        if self.knows < Knowledge.ALL:
            step = int(self._world.step[0])  # all worlds of a batch are in the same one
            keys = [continuation_keys(self._world.key, step, future) for future in range(self.futures)]
            world = world.replace(key=np.concatenate(keys))
        if self.knows == Knowledge.GOALS:
            usual = {name: np.full(world.radius.shape, float(value)) for name, value in ORCA.parameters.items()}
            rules = dataclasses.replace(world.rules, visible=False, intentions=())
            return world.replace(rules=rules, parameters={**world.parameters, ASSUMED: usual})
        return forget_vehicle(world) if self.knows == Knowledge.POLICIES else world


def has_chance(scenario: Scenario, knows: Knowledge) -> bool:
    """Return whether futures of a crowd can differ."""
    if knows == Knowledge.ALL:
        return False
    crowd = scenario.crowd
    if crowd.goal_change is not None or crowd.arrival not in ("walk_on", "stop", "leave"):
        return True
    if knows == Knowledge.GOALS:
        return False
    if any(intention.noise for intention in scenario.rules.intentions):
        return True
    policies = scenario.policies.values()
    is_certain = all(isinstance(policy, ORCA) or policy.stands for policy in policies)
    return not is_certain or (knows == Knowledge.POLICIES and has_attention(scenario.rules))


def adds_nothing(scenario: Scenario, knows: Knowledge) -> bool:
    """Return whether a kind of knowledge gives the same futures as the one before it, by construction."""
    if knows == Knowledge.POLICIES:
        usual = ORCA.parameters
        return not (scenario.rules.visible or scenario.crowd.variation) and all(
            scenario.policies[name].stands
            or (
                isinstance(scenario.policies[name], ORCA)
                and all(usual[key] == value.low == value.high for key, value in table.items())
            )
            for name, table in scenario.crowd.parameters.items()
        )
    if knows == Knowledge.ATTENTION:
        return not has_attention(scenario.rules)
    return knows == Knowledge.ALL and not has_chance(scenario, Knowledge.ATTENTION)


def _away(
    position: Float[np.ndarray, "world pedestrian 2"], vehicle: Float[np.ndarray, "world 1 2"]
) -> Float[np.ndarray, "world pedestrian 2"]:
    """Return positions in metres far away from a vehicle, in the same direction from it."""
    direction = position - vehicle
    return vehicle + AWAY * direction / np.maximum(norm(direction), 1e-9)[..., None]
