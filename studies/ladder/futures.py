"""The futures of a crowd, simulated from its true state: the true one, or several with other chance."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench.core import rng
from crowdbench.core.geometry import norm
from crowdbench.core.types import Observation, World
from crowdbench.predict import Prediction, Predictor
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.simulator import crowd_decisions, move

AWAY = 1e3
"""Who has left goes so many metres straight away from the vehicle, so that no sequence of commands meets it."""


class Simulated(Predictor):
    """Simulates the crowd ahead, with people who react to the vehicle where they see it.

    Everybody keeps policy, goal and what it remembers. Who comes in is not foreseen, and who leaves is gone. Of other
    chance are turns and stops from now on; whoever stands as `stop_and_go` does, begins its stops anew.

    Args:
        scenario: The scenario.
        futures: Number of futures with other chance each; None for the true one [1].
    """

    privileged: ClassVar[bool] = True

    def __init__(self, scenario: Scenario, futures: int | None) -> None:
        self.scenario, self.futures = scenario, futures
        self._world: World

    def foresee(self, world: World) -> None:
        """Learn the worlds as they are now, before the observation of them."""
        self._world = world

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`: where the vehicle stands."""
        return self.predict_given(obs, steps, np.zeros((len(obs), steps, 2)))

    def predict_given(self, obs: Observation, steps: int, plan: Float[np.ndarray, "world time 2"]) -> Prediction:
        """See `Predictor`."""
        number = self.futures or 1
        row = np.tile(np.arange(len(obs)), number)
        world, scenario = self._world.take(row), self.scenario
        if self.futures is not None:
            step = int(self._world.step[0])  # all worlds of a batch are in the same one
            keys = [rng.other_chance(self._world.key, step, future) for future in range(number)]
            world = world.replace(key=np.concatenate(keys))
        before, person, position = world.position[:, 1:], world.person, []
        gone, everywhere = ~world.present[:, 1:], np.ones(len(world), bool)
        for t in range(steps):
            crowd, world = crowd_decisions(world, scenario.policies)
            world, _ = move(world, plan[row, t], crowd)
            if scenario.post_step_rule is not None:
                world = scenario.post_step_rule(world, everywhere)
            leaves = ~gone & (~world.present[:, 1:] | (world.person != person))
            gone |= leaves
            before = np.where(gone[..., None], before, world.position[:, 1:])
            before = np.where(leaves[..., None], _away(before, world.position[:, :1]), before)
            position.append(before)
        shape = (number, len(obs), steps, *before.shape[1:])
        found = np.stack(position, axis=1).reshape(shape).swapaxes(0, 1)
        start = np.broadcast_to(obs.pedestrians.position[:, None, None], (*found.shape[:2], 1, *found.shape[3:]))
        return Prediction(found, np.diff(found, axis=2, prepend=start) / obs.dt)


def _away(
    position: Float[np.ndarray, "world pedestrian 2"], vehicle: Float[np.ndarray, "world 1 2"]
) -> Float[np.ndarray, "world pedestrian 2"]:
    """Positions in metres far away from a vehicle, in the same direction from it."""
    direction = position - vehicle
    return vehicle + AWAY * direction / np.maximum(norm(direction), 1e-9)[..., None]
