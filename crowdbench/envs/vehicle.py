"""The Gymnasium environment of one world, in which the vehicle acts. For many worlds see `crowdbench.envs.vector`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np

from crowdbench.core.types import Outcome
from crowdbench.envs import stepping
from crowdbench.envs.render import RENDER_MODES
from crowdbench.envs.rewards import Reward
from crowdbench.scenario.scenario import Scenario
from crowdbench.views.view import NEAREST, Observed, View, row_of


class VehicleEnv(stepping.OneWorld, gymnasium.Env[Observed, np.ndarray]):
    """The vehicle in one world of a scenario, `crowdbench/Vehicle-v0`.

    `gymnasium.make("crowdbench:crowdbench/Vehicle-v0")` also works in a program that does not import crowdbench.

    - Observation: see `crowdbench.views.view`.
    - Action: by default a velocity `(vx, vy)` as a share of the preferred speed, in [-1, 1]; see
      `crowdbench.views.actions`. A speed above the vehicle's preferred speed is reduced to it.
    - Reward: see `crowdbench.envs.rewards`.
    - Starting state: the case in the options of `reset`, or else a training case drawn from the seed.
    - Termination: success or collision.
    - Truncation: the scenario's time limit.
    - Info: numbers: `case`; `outcome`, the number of its `Outcome`; `is_success`; and `gap`, the smallest distance in
      metres between the rims of the vehicle and a pedestrian during the step.

    The attribute `case` is the name of the case, such as `test/37`.

    Args:
        scenario: The name of a scenario, the path of its file, or a `Scenario`.
        render_mode: `human`, `rgb_array` or None.
        reward: The name of a reward, `./mine.py`, or a function of a step.
        observation: `flat`, `goal_frame`, `dict` or `lidar`.
        action: `normalized` or another name of `crowdbench.views.actions`.
        nearest: Largest number of pedestrians in an observation in the frame of the goal.
        rays: Number of rays to walls in an observation in the frame of the goal.
        dtype: Type of the numbers of an observation: `float32`, or `float64` for unrounded numbers.

    Raises:
        InputError: Scenario, render mode, reward, observation, action or type do not exist.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES}  # type: ignore[misc]

    def __init__(
        self,
        scenario: str | Path | Scenario = "circle_crossing_5",
        render_mode: str | None = None,
        reward: str | Reward = "crowdnav",
        observation: str = "flat",
        action: str = "normalized",
        nearest: int = NEAREST,
        rays: int = 0,
        dtype: str = "float32",
    ) -> None:
        loaded = stepping.as_scenario(scenario)
        super().__init__(View(loaded, observation, action, nearest, rays, dtype), render_mode, reward)
        self.observation_space = self.view.observation_space
        self.action_space = self.view.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: Seeds the generator that draws training cases. None continues with the same generator.
            options: `{"case": "test/37"}` starts this case instead of a drawn one.

        Returns:
            The observation and the info.

        Raises:
            InputError: There is no such case, or an option is unknown.
        """
        case = stepping.check_options(options, "case").get("case")
        super().reset(seed=seed)
        self._start(case, self.np_random, everybody=False)
        return self._observation(), stepping.make_info(self._number)

    def step(self, action: np.ndarray) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Simulate one step; the pedestrians follow the scenario's policies.

        Args:
            action: The vehicle's action `[2]`.

        Returns:
            Observation, reward, terminated, truncated, info.

        Raises:
            InputError: The action is not two finite numbers.
        """
        self._check_reset()
        action = stepping.check_actions(action, (2,))
        if self._compiled is not None:
            observed = self._compiled.step(0, action)[0]
            self._enter(self._compiled.world)
            outcome, gap, reward = self._compiled.outcome[0], self._compiled.gap[0], self._compiled.reward[0]
        else:
            step = stepping.drive(self.view, self._world, action[None])
            self._enter(step.after)
            observed = self._observation()
            outcome, gap, reward = step.outcome[0], step.gap[0], self.reward(step)[0]
        truncated = bool(outcome == Outcome.TIMEOUT)
        terminated = bool(outcome != Outcome.RUNNING) and not truncated
        info = stepping.make_info(self._number, int(outcome), float(gap))
        return observed, float(reward), terminated, truncated, info

    def _observation(self) -> Observed:
        return row_of(self.view.observe(self._world), 0)
