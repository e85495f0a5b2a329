"""The PettingZoo environment: one world in which the vehicle and any of the pedestrians act."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box, Space
from gymnasium.utils import seeding
from jaxtyping import Float, Int
from pettingzoo import ParallelEnv

from crowdbench.envs import spaces, stepping
from crowdbench.envs.observations import flatten_everybody
from crowdbench.envs.outcomes import outcomes_of_agents
from crowdbench.envs.render import RENDER_MODES, Renderer
from crowdbench.envs.rewards import Reward, Step, crowdnav, load_reward, paid
from crowdbench.envs.seats import seats
from crowdbench.envs.views import NEAREST, View
from crowdbench.errors import InputError
from crowdbench.reward import reward
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.types import Outcome, World

VEHICLE = "vehicle"
"""The name of the vehicle as an agent. The others are `pedestrian_0`, `pedestrian_1`, ..."""

# As numbers, because access to members of an enumeration is slow, and trainings call `step` most of the time.
_RUNNING, _SUCCESS, _TIMEOUT = (int(o) for o in (Outcome.RUNNING, Outcome.SUCCESS, Outcome.TIMEOUT))
_LABELS = stepping.LABELS

Observations = dict[str, Float[np.ndarray, "features"]]
Infos = dict[str, dict[str, Any]]


def parallel_env(
    scenario: str | Path | Scenario = "circle_crossing_5",
    render_mode: str | None = None,
    reward: str | Reward = "crowdnav",
    observation: str = "flat",
    action: str = "world",
    nearest: int = NEAREST,
) -> CrowdParallelEnv:
    """Make the PettingZoo environment of a scenario.

    Args:
        scenario: The name of a scenario, the path of its file, or a `Scenario`.
        render_mode: `human`, `rgb_array` or None.
        reward: The name of a reward, `./mine.py`, or a function of a step.
        observation: `flat` or `goal_frame`.
        action: `world` or `goal_frame`, the axes of a velocity, or `native`, where the vehicle gives commands.
        nearest: How many other agents are seen in the frame of the goal, at most.

    Raises:
        InputError: Scenario, render mode, reward, observation or action do not exist.
    """
    loaded = stepping.as_scenario(scenario)
    return CrowdParallelEnv(loaded, render_mode, reward, View(loaded, observation, action, nearest))


class CrowdParallelEnv(ParallelEnv[str, np.ndarray, np.ndarray]):  # type: ignore[misc]  # pettingzoo is untyped
    """One world of a scenario as a PettingZoo `ParallelEnv`. Make it with `parallel_env`.

    - Agents: `vehicle`, and `pedestrian_0`, `pedestrian_1`, ... for the pedestrians of the case.
    - Observations: see `crowdbench.envs.views`.
    - Actions: velocities `(vx, vy)` in m/s, along the axes of the world or in the frame of the agent's goal. An action
      faster than the agent's preferred speed is slowed down to it. A pedestrian without an action, or with None,
      follows the scenario's policy. The vehicle must have an action.
    - Rewards: see `crowdbench.envs.rewards`, of each agent's own outcome and gap (`crowdbench.envs.outcomes`) in its
      own world (`crowdbench.envs.seats`).
    - Starting state: the case that `reset` is asked for, or else a training case drawn from the seed.
    - Terminations: a pedestrian terminates when it reaches its goal; it is no agent any more, but stays in the world
      and follows the scenario's policy. All agents terminate when the vehicle reaches its goal or collides.
    - Truncations: all agents, at the scenario's time limit.
    - Infos: `case`, its name such as `test:37`; after a step also `outcome`, the name of the agent's `Outcome`, and
      `gap`, the smallest distance in metres between the rims of the agent and another one during the step.

    Args:
        scenario: The scenario.
        render_mode: `human`, `rgb_array` or None.
        reward: The name of a reward, `./mine.py`, or a function of a step.
        view: What agents see, and what their actions mean.

    Raises:
        InputError: There is no such reward, or the view is `dict`: worlds keep no history of the vehicle.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "crowdbench_v0",
        "render_modes": RENDER_MODES,
        "render_fps": 4,
        "is_parallelizable": True,
    }

    def __init__(self, scenario: Scenario, render_mode: str | None, reward: str | Reward, view: View) -> None:
        if view.observation == "dict":
            raise InputError("observation is 'dict', but agents of this environment see flat or goal_frame")
        self.scenario = scenario
        self.view = view
        self.reward_name, self.reward = load_reward(reward)
        self.render_mode = render_mode
        fps = round(1 / self.scenario.rules.dt)
        self.metadata = {**self.metadata, "render_fps": fps}  # type: ignore[misc]  # read of each environment
        self.possible_agents = [VEHICLE, *(f"pedestrian_{p}" for p in range(scenario.max_agents - 1))]
        self.agents: list[str] = []
        self.observation_spaces = {agent: view.observation_space for agent in self.possible_agents}
        self.action_spaces = {agent: spaces.pedestrian_action_space(scenario) for agent in self.possible_agents}
        self.action_spaces[VEHICLE] = view.action_space
        self._column = {agent: column for column, agent in enumerate(self.possible_agents)}
        self._renderer = Renderer(render_mode)
        self._generator: np.random.Generator | None = None
        self._bodies = 0
        self._case = ""
        self._world: World
        self._seated: tuple[World, World] | None = None

    def observation_space(self, agent: str) -> Space[Any]:
        """The observation space of an agent, the same object at each call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The action space of an agent, the same object at each call."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start a new episode.

        Args:
            seed: Seeds the generator that draws training cases. None continues with the same generator.
            options: `{"case": "test:37"}` starts this case instead of a drawn one.

        Returns:
            Observations and infos by agent.

        Raises:
            InputError: There is no such case, or an option is unknown.
        """
        # PettingZoo's own test gives an option called "options", only to see that options are taken.
        given = {name: value for name, value in (options or {}).items() if name != "options"}
        case = stepping.checked_options(given, "case").get("case")
        if seed is not None or self._generator is None:
            self._generator, _ = seeding.np_random(seed)
        self._case = stepping.chosen_case(case, self._generator)
        self._world = stepping.start(self.scenario, [self._case])
        self.agents = [agent for agent, here in zip(self.possible_agents, self._world.present[0], strict=True) if here]
        self._bodies = len(self.agents)
        self._renderer.show(self._world, self._case)
        return self._observe(), {agent: {"case": self._case} for agent in self.agents}

    def step(
        self, actions: Mapping[str, np.ndarray | None]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Simulate one step.

        Args:
            actions: Velocities `[2]` in m/s by agent: of the vehicle, and of any pedestrians.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent, of the agents before the step.

        Raises:
            InputError: The vehicle has no action, an action belongs to no current agent, or is no finite velocity.
        """
        if not self.agents and not actions:
            return {}, {}, {}, {}, {}
        before, agents = self._world, self.agents
        self._world, check = step(before, *self._velocities(actions))
        outcomes, gaps = outcomes_of_agents(before, self._world, check)
        rewards = self._rewards(before, outcomes, gaps)
        observations = self._observe()
        outcome, gap_of, case = outcomes.tolist(), gaps.tolist(), self._case
        columns = [(agent, self._column[agent]) for agent in agents]
        truncated = outcome[0] == _TIMEOUT
        over = outcome[0] not in (_RUNNING, _TIMEOUT)
        terminations = {agent: over or outcome[c] == _SUCCESS for agent, c in columns}
        self.agents = [] if truncated else [agent for agent in agents if not terminations[agent]]
        self._renderer.show(self._world, case)
        return (
            observations,
            {agent: rewards[c] for agent, c in columns},
            terminations,
            dict.fromkeys(agents, truncated),
            {agent: {"outcome": _LABELS[outcome[c]], "gap": gap_of[c], "case": case} for agent, c in columns},
        )

    def render(self) -> np.ndarray | None:
        """The picture `[height, width, 3]`, uint8, in mode `rgb_array`; None in other modes."""
        stepping.require_reset(self._case)
        return self._renderer.frame(self._world, self._case)

    def close(self) -> None:
        """Close the window of mode `human`."""
        self._renderer.close()

    def _rewards(
        self, before: World, outcomes: Int[np.ndarray, "agent"], gaps: Float[np.ndarray, "agent"]
    ) -> list[float]:
        if self.reward is crowdnav:  # which needs no worlds of the agents' own
            return list(reward(outcomes, gaps, before.rules.dt).tolist())
        step = Step(self._seats(before), self._seats(self._world), outcomes, gaps)
        return list(paid(self.reward_name, self.reward, step).tolist())

    def _seats(self, world: World) -> World:
        """As `seats`, made once for each world."""
        if self._seated is None or self._seated[0] is not world:
            self._seated = world, seats(world)
        return self._seated[1]

    def _observe(self) -> Observations:
        is_flat = self.view.observation == "flat"
        views = flatten_everybody(self._world)[0] if is_flat else self.view.observe(self._seats(self._world))
        return {agent: views[self._column[agent]] for agent in self.agents}

    def _velocities(
        self, actions: Mapping[str, np.ndarray | None]
    ) -> tuple[Float[np.ndarray, "1 2"], Float[np.ndarray, "1 pedestrian 2"]]:
        """All velocities of a step.

        Args:
            actions: The actions by agent.

        Returns:
            The vehicle's command and the pedestrians' velocities in m/s: their actions, or else their policies'.
        """
        given = {agent: action for agent, action in actions.items() if action is not None}
        if not self.agents:
            raise InputError("the episode is over: call reset()")
        if VEHICLE not in given or not given.keys() <= set(self.agents):
            raise InputError(
                f"there are actions for {', '.join(given) or 'no agent'}, but there must be one for the vehicle, and "
                f"there may be others for {', '.join(self.agents[1:]) or 'no other agent'}"
            )
        asked = stepping.velocities(list(given.values()), (len(given), 2))
        columns = [self._column[agent] for agent in given]
        asked = self.view.commands(self._world.position[0, columns], goals_on_way(self._world)[0, columns], asked)
        velocity = np.zeros(self._world.velocity.shape)
        if len(given) < self._bodies:
            velocity[:, 1:] = crowd_velocities(self._world, self.scenario.policies)
        velocity[0, columns] = asked
        return self.view.followed(self._world, velocity[:, 0]), velocity[:, 1:]
