"""The worlds of a scenario in which a policy is trained by PPO, as its network sees them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.types import Outcome
from crowdbench.envs.rewards import Step, load_reward
from crowdbench.envs.training_worlds import CASES, TrainingWorlds
from crowdbench.envs.views import View
from crowdbench.networks.policy import Seen
from crowdbench.planners.policy import Showing
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.sensor import observe


class Paid(NamedTuple):
    """What a step gave.

    Attributes:
        reward: What each vehicle was given.
        ended: Where the step ended the episode.
        returned: The sums of the rewards of the episodes that ended.
        timed_out: The worlds whose episode the time limit ended.
        cut_off: What is seen there after the step.
    """

    reward: Float[np.ndarray, "world"]
    ended: Bool[np.ndarray, "world"]
    returned: list[float]
    timed_out: Int[np.ndarray, "row"]
    cut_off: Seen


class PolicyWorlds:
    """Many worlds of a scenario in which a policy drives.

    Attributes:
        seen: What the policy is shown of them now. There is nothing before `start`.

    Args:
        number: How many worlds there are.
        scenario: The scenario.
        showing: What the policy is shown, and what its actions mean.
        reward: The name of a reward, or a file.
        device: `cpu` or `cuda`.
    """

    def __init__(self, number: int, scenario: Scenario, showing: Showing, reward: str, device: str) -> None:
        view = View(scenario, action="native" if showing.predictor else "world")
        self.worlds = TrainingWorlds(number, view, load_reward(reward), CASES)
        self.number, self.showing, self.device = number, showing, device

    def start(self, seed: int) -> None:
        """Draw training cases anew, and start episodes in all worlds."""
        self.worlds.seed(seed)
        self.worlds.start()
        self._look()

    def step(self, action: Float[np.ndarray, "world 2"]) -> Paid:
        """Simulate a step in which the policy acts; where it ends an episode, the next one starts."""
        step, reward, returned, _ = self.worlds.step(self.showing.commands(action, self.vehicle, self.axis))
        paid = Paid(reward, step.ended, returned[step.ended].tolist(), *self._cut_off(step))
        self._look()
        return paid

    def _cut_off(self, step: Step) -> tuple[Int[np.ndarray, "row"], Seen]:
        rows = np.flatnonzero(step.outcome == Outcome.TIMEOUT)
        seen = self.seen.each(lambda part: part[:0])
        return rows, Seen.of(self.showing(observe(step.after.take(rows))), self.device) if len(rows) else seen

    def _look(self) -> None:
        """See the worlds as they are now."""
        obs = observe(self.worlds.worlds)
        shown = self.showing(obs)
        self.seen, self.axis, self.vehicle = Seen.of(shown, self.device), shown.axis, obs.vehicle
