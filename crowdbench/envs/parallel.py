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

from crowdbench.core.reward import reward
from crowdbench.core.types import HISTORY, Outcome, World
from crowdbench.envs import stepping
from crowdbench.envs.render import RENDER_MODES
from crowdbench.envs.rewards import Reward, Step, crowdnav
from crowdbench.envs.step_outcomes import outcomes_of_agents
from crowdbench.scenario.population import CONTINUING_ARRIVALS
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.lidar import scan
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.simulator import crowd_decisions, finish_step, move, without_intentions
from crowdbench.utils.errors import InputError, require
from crowdbench.views.ego import ego_views, flatten_everybody, with_own_motion
from crowdbench.views.global_state import global_state, state_bounds
from crowdbench.views.scans import lidar_features_of_all
from crowdbench.views.view import NEAREST, Observed, View, row_of

VEHICLE = "vehicle"
"""The name of the vehicle as an agent. The others are `pedestrian_0`, `pedestrian_1`, ..."""

# As integers, because access to members of an enumeration is slow, and training spends most of its time in `step`.
_RUNNING, _SUCCESS, _TIMEOUT = int(Outcome.RUNNING), int(Outcome.SUCCESS), int(Outcome.TIMEOUT)

Observations = dict[str, Observed]
Infos = dict[str, dict[str, Any]]


class CrowdParallelEnv(stepping.OneWorld, ParallelEnv[str, np.ndarray, np.ndarray]):  # type: ignore[misc]  # pettingzoo is untyped
    """One world of a scenario as a PettingZoo `ParallelEnv`, which is also called `parallel_env`.

    - Agents: `vehicle`, and `pedestrian_0`, `pedestrian_1`, ... for the pedestrians of the case. In a scenario with
      recorded pedestrians, only the vehicle.
    - Observations: see `crowdbench.views.view`. The vehicle uses the scenario's sensor, pedestrians observe all agents.
      A pedestrian is a disc that moves in any direction; its heading is that of its velocity.
    - State: see `crowdbench.views.global_state`.
    - Actions: by default a velocity `(vx, vy)` as a share of the agent's preferred speed, in [-1, 1]; see
      `crowdbench.views.actions`. A speed above the preferred speed is reduced to it. The scenario's `limits` bound
      changes of a pedestrian's velocity. A pedestrian without an action, or with None, follows the scenario's policy.
      The vehicle must have an action.
    - Rewards: see `crowdbench.envs.rewards`, computed from the outcome and gap of each agent in
      its ego view (`crowdbench.views.ego.ego_views`).
    - Starting state: the case in the options of `reset`, or else a training case drawn from the seed.
    - Terminations: a pedestrian terminates when it reaches its goal; it is no longer an agent, but stays in the world
      and follows the scenario's policy, unless the scenario's `arrival` removes it. If pedestrians get new goals or are
      replaced on arrival, the agent continues with the new goal or as the new pedestrian. All agents terminate when the
      vehicle reaches its goal or collides.
    - Truncations: all agents, at the scenario's time limit or after `max_episode_steps`.
    - Infos: numbers: `case`; `outcome`, the number of the agent's `Outcome`; `is_success`; and `gap`, the smallest
      distance in metres between the rims of the agent and another one during the step.

    The attribute `case` is the name of the case, such as `test/37`.

    Args:
        scenario: The name of a scenario, the path of its file, or a `Scenario`.
        render_mode: `human`, `rgb_array` or None.
        reward: The name of a reward, `./mine.py`, or a function of a step.
        observation: `flat`, `goal_frame`, `dict` or `lidar`.
        action: `normalized` or another name of `crowdbench.views.actions`.
        nearest: Largest number of other agents in an observation in the frame of the goal.
        rays: Number of rays to walls in an observation in the frame of the goal.
        dtype: Type of the numbers of an observation: `float32`, or `float64` for unrounded numbers.
        max_episode_steps: Largest number of steps of an episode, after which it is truncated.

    Raises:
        InputError: Scenario, render mode, reward, observation, action or type do not exist; or agents see only the
            nearest others (`Sensor.nearest`), and the observation is `goal_frame` or `dict`, or the reward not
            `crowdnav`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "crowdbench_v0",
        "render_modes": RENDER_MODES,
        "is_parallelizable": True,
    }

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
        max_episode_steps: int | None = None,
    ) -> None:
        self._max_steps = stepping.check_max_steps(max_episode_steps)
        scenario = stepping.as_scenario(scenario, several=True)
        view = View(scenario, observation, action, nearest, rays, dtype)
        super().__init__(view, render_mode, reward)
        self._vehicles = vehicles = scenario.rules.vehicles
        most, shown = scenario.max_agents - 1, scenario.rules.sensor.nearest
        is_default = observation in ("flat", "lidar") and self.reward.reward is crowdnav
        if shown is not None and shown < most and not is_default:  # each agent would need a world: too much memory
            raise InputError(
                f"observation is {observation!r} and reward {self.reward.name!r}, but in a scenario with up "
                f"to {most} pedestrians, of which {shown} are shown, they must be 'flat' or 'lidar', and 'crowdnav'"
            )
        # Recorded pedestrians appear and leave at recorded times, and are not agents.
        pedestrians = 0 if scenario.tracks else scenario.crowd.number[1]
        self._drivers = [VEHICLE] if vehicles == 1 else [f"{VEHICLE}_{k}" for k in range(vehicles)]
        self.possible_agents = [*self._drivers, *(f"pedestrian_{p}" for p in range(pedestrians))]
        self._leaves = scenario.crowd.arrival not in CONTINUING_ARRIVALS
        self.observation_spaces = dict.fromkeys(self.possible_agents, view.observation_space)
        self.state_space = view.box(*state_bounds(scenario))
        self.action_spaces = dict.fromkeys(self.possible_agents, view.pedestrian_action_space)
        self.action_spaces |= dict.fromkeys(self._drivers, view.action_space)
        self._column = {agent: column for column, agent in enumerate(self.possible_agents)}
        self._set_agents([])
        self._generator: np.random.Generator | None = None
        self._bodies = 0
        self._ego: tuple[World, World] | None = None
        self._past: Float[np.ndarray, "1 time 2"] | None = None

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the observation space of an agent, the same object at each call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """Return the action space of an agent, the same object at each call."""
        return self.action_spaces[agent]

    def state(self) -> Float[np.ndarray, "features"]:
        """Return the global state of the world."""
        self._check_reset()
        return global_state(self._world)[0].astype(self.view.dtype)

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start a new episode.

        Args:
            seed: Seeds the generator that draws training cases. None continues with the same generator.
            options: `{"case": "test/37"}` starts this case instead of a drawn one.

        Returns:
            Observations and infos by agent.

        Raises:
            InputError: There is no such case, or an option is unknown.
        """
        # PettingZoo's API test passes an option named "options" to test that options are accepted.
        case = stepping.check_options(options, "case", "options").get("case")
        if seed is not None or self._generator is None:
            self._generator, _ = seeding.np_random(seed)
        self._start(case, self._generator, everybody=True)
        present = self._world.present[0].tolist()
        self._set_agents([agent for agent, column in self._column.items() if present[column]])
        self._bodies = int(self._world.present[0].sum()) if self.scenario.tracks is None else self.scenario.max_agents
        return self._by_agent(self._observe()), {agent: stepping.make_info(self._number) for agent in self.agents}

    def step(
        self, actions: Mapping[str, np.ndarray | None]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Simulate one step.

        Args:
            actions: Actions `[2]` by agent: of the vehicle, and of any pedestrians.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent, of the agents before the step.

        Raises:
            InputError: The vehicle has no action, an action belongs to no current agent, or is not two finite numbers.
        """
        if not self.agents and not actions:
            return {}, {}, {}, {}, {}
        agents = self.agents
        outcomes, gaps, rewards, views = self._advance(*self._check_actions(actions))
        outcome, gap, present = outcomes.tolist(), gaps.tolist(), self._world.present[0].tolist()
        number, leaves, columns, vehicles = self._number, self._leaves, self._columns, self._vehicles
        driving = [outcome[k] for _, k in columns if k < vehicles]
        timeout, at_limit = _TIMEOUT in driving, self._world.step[0].item() >= self._max_steps
        over = _RUNNING not in driving and not timeout
        observations = self._by_agent(views)
        rewards_of = {agent: rewards[k] for agent, k in columns}
        terminations = {
            agent: over
            or (outcome[k] not in (_RUNNING, _TIMEOUT) if k < vehicles else leaves and outcome[k] == _SUCCESS)
            or not present[k]
            for agent, k in columns
        }
        infos = {agent: stepping.make_info(number, outcome[k], gap[k]) for agent, k in columns}
        all_truncated = at_limit or (timeout and _RUNNING not in driving)
        truncations = {agent: all_truncated or (k < vehicles and outcome[k] == _TIMEOUT) for agent, k in columns}
        ended = {agent for agent in agents if terminations[agent] or truncations[agent]}
        if ended:
            self._set_agents([agent for agent in agents if agent not in ended])
        return observations, rewards_of, terminations, truncations, infos

    def _advance(
        self, acting: list[int], actions: Float[np.ndarray, "n 2"]
    ) -> tuple[Int[np.ndarray, "agent"], Float[np.ndarray, "agent"], list[float], Observed]:
        """Advance the world by one step.

        Args:
            acting: Columns of the acting agents.
            actions: Their actions.

        Returns:
            Outcomes, gaps in metres, rewards, and the observation of each agent after the step.
        """
        if (compiled := self._compiled) is not None:
            views = compiled.step(acting, actions)
            self._enter(compiled.world)
            return compiled.outcome, compiled.gap, compiled.reward.tolist(), views
        before, world = self._world, self._world
        chosen = np.zeros(world.velocity.shape)
        # A policy with a memory is updated at every step, even if no pedestrian follows it.
        if len(acting) < self._bodies or any(world.memory.values()):
            chosen[:, 1:], world = crowd_decisions(world, self.scenario.policies)
        position, goal = before.position[0, acting], goals_on_way(before)[0, acting]
        columns, vehicles = np.array(acting), self._vehicles
        speed, is_vehicle = before.preferred_speed[0, acting], columns < vehicles
        commands = self.view.commands(position, goal, speed, actions, is_vehicle)
        chosen[columns[is_vehicle], 0] = commands[is_vehicle]
        chosen[:, columns[~is_vehicle]] = commands[~is_vehicle]
        world = without_intentions(world, [column - 1 for column in acting if column >= vehicles])
        moved, check = move(world, self.view.to_command(world, chosen[:, 0]), chosen[:, 1:])
        outcomes, gaps = outcomes_of_agents(before, moved, check)
        if self.reward.reward is crowdnav:  # it needs no ego views
            rewards = reward(outcomes, gaps, before.rules.dt)
        else:
            rewards = self.reward(Step(self._ego_views(before), self._ego_views(moved), outcomes, gaps))
        self._enter(finish_step(moved, check, self.scenario.post_step_rule))
        return outcomes, gaps, rewards.tolist(), self._observe()

    def _ego_views(self, world: World) -> World:
        """Return `ego_views` of a world, computed once per world."""
        if self._ego is None or self._ego[0] is not world:
            self._ego = world, ego_views(world.take(np.array([0])) if self._vehicles > 1 else world)
        return self._ego[1]

    def _enter(self, world: World) -> None:
        super()._enter(world)
        if self.view.observation == "dict":
            here = world.position[:1, :1]
            past = np.repeat(here, HISTORY, axis=1) if self._past is None or world.step[0] == 0 else self._past
            self._past = np.concatenate([past[:, 1:], here], axis=1)

    def _observe(self) -> Observed:
        """Return the observation of each agent, by column."""
        if self._vehicles == 1:
            return self._observe_in(self._world)
        own, everybody = self.view.observe(self._world), self._observe_in(self._world.take(np.array([0])))
        rows = range(self._vehicles, self._world.radius.shape[1])
        return [*(row_of(own, k) for k in range(self._vehicles)), *(everybody[column] for column in rows)]

    def _observe_in(self, world: World) -> Observed:
        """Return the observation of each agent, by column, from the row of the first vehicle."""
        if self.view.observation == "flat":
            return self.view.rounded(flatten_everybody(world)[0])
        if self.view.observation == "lidar":
            return self.view.rounded(lidar_features_of_all(world))
        ego = self._ego_views(world)
        if self.view.observation == "goal_frame" and not self.view.rays and world.rules.sensor.sees_all:
            return self.view.observe(ego)
        # Only the vehicle has a sensor and dynamics.
        own, others = self.view.observe(world), self.view.observe(with_own_motion(ego, world, self._past))
        if self.view.observation == "dict" and (lidar := world.rules.sensor.lidar):
            # Not of ego views, which have neither the vehicle's body nor the numbers of persons and of the agent.
            others["lidar"] = self.view.rounded(scan(world, lidar, len(ego))[0])
        return [row_of(own, 0), *(row_of(others, column) for column in range(1, len(ego)))]

    def _set_agents(self, agents: list[str]) -> None:
        self.agents = agents
        self._columns = [(agent, self._column[agent]) for agent in agents]

    def _by_agent(self, views: Observed) -> Observations:
        return {agent: views[column] for agent, column in self._columns}

    def _check_actions(self, actions: Mapping[str, np.ndarray | None]) -> tuple[list[int], Float[np.ndarray, "n 2"]]:
        """Return the columns of the acting agents, and their actions. Raises InputError as `step` does."""
        require("actions", actions, isinstance(actions, Mapping), "a table of actions by agent")
        given = {agent: action for agent, action in actions.items() if action is not None}
        if not self.agents:
            raise InputError("the episode is over: call reset()")
        driven = [agent for agent in self.agents if agent in self._drivers]
        if not set(driven) <= given.keys() <= set(self.agents):
            named = ", ".join(map(str, given)) or "no agent"
            others = ", ".join(agent for agent in self.agents if agent not in driven) or "no other agent"
            must = "the vehicle" if self._vehicles == 1 else ", ".join(driven)
            raise InputError(
                f"there are actions for {named}, but there must be one for {must}, and there may be others for {others}"
            )
        chosen = stepping.check_actions(list(given.values()), (len(given), 2))
        return [self._column[agent] for agent in given], chosen


parallel_env = CrowdParallelEnv
"""PettingZoo's name for the environment."""
