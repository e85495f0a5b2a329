"""How a policy sees the worlds of a scenario and acts in them: observations, actions and their spaces.

Observations, of the vehicle:

- `flat`: a vector along the axes of the world, see `crowdbench.envs.observations`.
- `goal_frame`: a vector in the frame of the goal, see `crowdbench.planners.policy.features`: the vehicle's numbers,
  then those of each pedestrian and 1 where there is one.
- `dict`: the same as a dictionary of `vehicle`, `pedestrians`, `mask` (1 where there is a pedestrian), and `history`,
  the last 8 positions of each pedestrian; and `lidar` where the vehicle has one, as `Observation.lidar`.

The vehicle sees by the scenario's sensor.

Actions are velocities in m/s, along the axes of the world (`world`) or in the frame of the goal (`goal_frame`), which a
vehicle on wheels follows as far as it can; or commands of the vehicle's dynamics (`native`), see `crowdbench.dynamics`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces as gym_spaces
from jaxtyping import Float

from crowdbench.dynamics import State
from crowdbench.envs import spaces
from crowdbench.envs.observations import flatten
from crowdbench.errors import InputError
from crowdbench.planners.policy.features import (
    PEDESTRIAN_FEATURES,
    VEHICLE_FEATURES,
    direction,
    features,
    histories,
    to_world,
)
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.sensor import observe
from crowdbench.types import HISTORY, Observation, World

OBSERVATIONS = ("flat", "goal_frame", "dict")
ACTIONS = ("world", "goal_frame", "native")

NEAREST = 10
"""Pedestrians that are seen in the frame of the goal, where the scenario has more."""

Observed = Any
"""An array `[world, features]`, or a dictionary of arrays `[world, ...]`."""


@dataclass(frozen=True)
class View:
    """How a policy sees the worlds of a scenario and acts in them.

    Attributes:
        scenario: The scenario.
        observation: One of `OBSERVATIONS`.
        action: One of `ACTIONS`.
        nearest: How many pedestrians are seen in the frame of the goal, at most.

    Raises:
        InputError: There is no such observation or action.
    """

    scenario: Scenario
    observation: str = "flat"
    action: str = "world"
    nearest: int = NEAREST

    def __post_init__(self) -> None:
        for name, value, known in (
            ("observation", self.observation, OBSERVATIONS),
            ("action", self.action, ACTIONS),
        ):
            if value not in known:
                raise InputError(f"{name} is {value!r}, but must be one of {', '.join(known)}")
        if not (isinstance(self.nearest, int) and self.nearest >= 1):
            raise InputError(f"nearest is {self.nearest!r}, but must be a whole number of pedestrians, 1 or more")

    @property
    def observation_space(self) -> gym_spaces.Space[Any]:
        """The space of the observations of one world."""
        if self.observation == "flat":
            return spaces.observation_space(self.scenario)
        k = self.nearest
        parts = {
            "vehicle": _box(VEHICLE_FEATURES),
            "pedestrians": _box(k, PEDESTRIAN_FEATURES),
            "mask": gym_spaces.Box(0.0, 1.0, (k,), np.float64),
        }
        if self.observation == "dict":
            if lidar := self.scenario.rules.sensor.lidar:
                parts["lidar"] = gym_spaces.Box(0.0, lidar.range, (lidar.beams,), np.float64)
            return gym_spaces.Dict({**parts, "history": _box(HISTORY, k, 2)})
        return _box(VEHICLE_FEATURES + k * (PEDESTRIAN_FEATURES + 1))

    @property
    def action_space(self) -> gym_spaces.Box:
        """The space of the vehicle's actions in one world."""
        return spaces.vehicle_action_space(self.scenario, self.action == "native")

    def observe(self, worlds: World) -> Observed:
        """What the vehicle sees in each world."""
        return self.shown(observe(worlds))

    def shown(self, obs: Observation) -> Observed:
        """What a policy is shown of what a planner sees."""
        if self.observation == "flat":
            return flatten(obs)
        found = features(obs, self.nearest)
        mask = found.seen.astype(np.float64)
        if self.observation == "goal_frame":
            each = np.concatenate([found.pedestrians, mask[..., None]], axis=2)
            return np.concatenate([found.vehicle, each.reshape(len(obs), -1)], axis=1)
        parts = {"vehicle": found.vehicle, "pedestrians": found.pedestrians, "mask": mask}
        if obs.lidar is not None:
            parts["lidar"] = obs.lidar
        return {**parts, "history": histories(obs, found)}

    def commands(
        self,
        position: Float[np.ndarray, "world 2"],
        goal: Float[np.ndarray, "world 2"],
        action: Float[np.ndarray, "world 2"],
    ) -> Float[np.ndarray, "world 2"]:
        """The velocities in m/s, along the axes of the world, that actions ask for; native actions as they are.

        Args:
            position: Where the vehicles are, in metres.
            goal: Their goals in metres.
            action: The actions.
        """
        return to_world(action, direction(position, goal)) if self.action == "goal_frame" else action

    def followed(self, worlds: World, asked: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world 2"]:
        """The commands of vehicles that are asked for velocities, or for commands where actions are native.

        Args:
            worlds: The worlds before the step.
            asked: Velocities in m/s, or native commands.
        """
        if self.action == "native":
            return asked
        state = State(worlds.position[:, 0], worlds.velocity[:, 0], worlds.heading, worlds.angular_speed)
        return worlds.rules.dynamics.follow(state, asked, worlds.preferred_speed[:, 0], worlds.rules.dt)

    def vehicle_commands(self, worlds: World, action: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world 2"]:
        """The commands of vehicles whose actions are given.

        Args:
            worlds: The worlds before the step.
            action: The actions.
        """
        return self.followed(worlds, self.commands(worlds.position[:, 0], goals_on_way(worlds)[:, 0], action))


def row_of(seen: Observed, index: int) -> Observed:
    """What one of several worlds shows.

    Args:
        seen: What all of them show.
        index: Which one.
    """
    return {name: part[index] for name, part in seen.items()} if isinstance(seen, dict) else seen[index]


def _box(*shape: int) -> gym_spaces.Box:
    return gym_spaces.Box(-np.inf, np.inf, shape, np.float64)
