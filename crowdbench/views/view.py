"""Observations and actions of a policy in the worlds of a scenario, and their spaces.

Observations, of the vehicle:

- `flat`: a vector along the axes of the world, see `crowdbench.views.ego`.
- `goal_frame`: a vector in the frame of the goal, see `crowdbench.networks.features`: the vehicle's numbers, then for
  each pedestrian its numbers and 1 (zeros if it is missing). With `rays`, also the parts `motion` and `rays`.
- `dict`: the same as a dictionary of `vehicle`, `pedestrians`, `mask` (1 for a pedestrian, else 0), and `history`, the
  last 8 positions of each pedestrian; `lidar` if the vehicle has one, as `Observation.lidar`; and with `rays`, `motion`
  (the motion of the vehicle and its next two waypoints) and `rays` (the distances to walls along that number of rays),
  see `crowdbench.networks.features_ahead`.
- `lidar`: a vector of the vehicle's own numbers and the ranges of a scan, see `crowdbench.views.scans`.

The vehicle observes through the scenario's sensor.

Actions: see `crowdbench.views.actions`. A vehicle on wheels follows a velocity as closely as its dynamics allow.

Observations are of float32, or of float64, in which nothing is rounded. The bounds of spaces follow from the scenario.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.spaces import Box
from jaxtyping import Bool, Float

from crowdbench.core.arrays import Numbers
from crowdbench.core.dynamics import FREE, SPEED_TOLERANCE, State
from crowdbench.core.rng import MOST_NORMAL
from crowdbench.core.types import HISTORY, Observation, World
from crowdbench.core.types.rules import MAX_PEDESTRIANS
from crowdbench.networks.features import (
    PEDESTRIAN_FEATURES,
    VEHICLE_FEATURES,
    Vectors,
    direction,
    features,
    histories,
    to_world,
)
from crowdbench.networks.features_ahead import MOTION, REACH, motion
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.placement import EXTENT
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.intention import FASTEST
from crowdbench.sim.lidar import DEFAULT_LIDAR, wall_distances
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import is_integer, is_number, require, require_count
from crowdbench.views.actions import ACTIONS, scale
from crowdbench.views.ego import AGENT_FEATURES, flatten, flatten_vehicle
from crowdbench.views.scans import OWN_NUMBERS, lidar_features

OBSERVATIONS = ("flat", "goal_frame", "dict", "lidar")
DTYPES = ("float32", "float64")

KEYS = ("vehicle", "pedestrians", "mask", "lidar", "motion", "rays", "history")
"""The keys of an observation `dict`, in its order; the order of its space is alphabetical."""

NEAREST = 10
"""Default for the largest number of pedestrians in an observation in the frame of the goal."""

MAX_RAYS = 10_000
"""Largest number of rays to walls."""

Flags = Bool[np.ndarray, "world"]

Observed = Any
"""An array `[world, features]`, or a dictionary of arrays `[world, ...]`."""


@dataclass(frozen=True)
class View:
    """Observations and actions of a policy in the worlds of a scenario.

    Attributes:
        scenario: The scenario.
        observation: One of `OBSERVATIONS`.
        action: One of `ACTIONS`.
        nearest: Largest number of pedestrians in an observation in the frame of the goal.
        rays: Number of rays to walls in the frame of the goal; 0 for neither rays nor the part `motion`.
        dtype: Type of the numbers of observations, and of actions in physical units: `float32` or `float64`.

    Raises:
        InputError: There is no such observation, action or type.
    """

    scenario: Scenario
    observation: str = "flat"
    action: str = "normalized"
    nearest: int = NEAREST
    rays: int = 0
    dtype: str = "float32"

    def __post_init__(self) -> None:
        check_view(self.observation, self.action, self.nearest, self.rays, self.dtype)

    @property
    def observation_space(self) -> spaces.Space[Any]:
        """The space of the observations of one world."""
        if self.observation == "flat":
            return self.box(*flat_bounds(self.scenario))
        if self.observation == "lidar":
            lidar = self.scenario.rules.sensor.lidar or DEFAULT_LIDAR
            own = np.full(OWN_NUMBERS, np.inf)
            return self.box(np.append(-own, np.zeros(lidar.beams)), np.append(own, np.full(lidar.beams, lidar.range)))
        k = self.nearest
        parts = {
            "vehicle": self._unbounded(VEHICLE_FEATURES),
            "pedestrians": self._unbounded(k, PEDESTRIAN_FEATURES),
            "mask": self.box(np.zeros(k), np.ones(k)),
        }
        if self.rays:
            parts |= {
                "motion": self._unbounded(MOTION + 4),
                "rays": self.box(np.zeros(self.rays), np.full(self.rays, REACH)),
            }
        if self.observation == "dict":
            given = self.scenario.rules.sensor.lidar
            if given is not None:
                parts["lidar"] = self.box(np.zeros(given.beams), np.full(given.beams, given.range))
            return spaces.Dict({**parts, "history": self._unbounded(HISTORY, k, 2)})
        size = VEHICLE_FEATURES + k * (PEDESTRIAN_FEATURES + 1)
        if self.rays:
            size += MOTION + 4 + self.rays
        return self._unbounded(size)

    @property
    def action_space(self) -> Box:
        """The space of the vehicle's actions in one world, [-1, 1] for normalized actions.

        Each axis of a velocity is within the preferred speed. In a corner the speed is larger: the simulator limits it.
        """
        speed = np.array(self.scenario.vehicle.preferred_speed)
        axes, normalized = ACTIONS[self.action]
        return self._actions(*(self.scenario.rules.dynamics if axes == "native" else FREE).space(speed), normalized)

    @property
    def pedestrian_action_space(self) -> Box:
        """The space of a pedestrian's actions. The largest preferred speed of the scenario bounds velocities."""
        speed = np.array(self.scenario.crowd.largest_preferred_speed)
        return self._actions(*FREE.space(speed), ACTIONS[self.action].normalized)

    def _actions(self, low: np.ndarray, high: np.ndarray, normalized: bool) -> Box:
        return Box(-1.0, 1.0, (2,), np.float32) if normalized else self.box(low, high)

    def _unbounded(self, *shape: int) -> Box:
        return Box(-np.inf, np.inf, shape, np.dtype(self.dtype).type)

    def box(self, low: np.ndarray, high: np.ndarray) -> Box:
        """Return a space whose bounds are rounded as its numbers are, so that no number is outside by rounding."""
        return Box(low.astype(self.dtype), high.astype(self.dtype), dtype=np.dtype(self.dtype).type)

    def observe(self, worlds: World) -> Observed:
        """Return the observation of each world."""
        if self.observation == "flat":
            return self.rounded(flatten_vehicle(worlds))
        return self.rounded(encode(observe(worlds), self.observation, self.nearest, self.rays))

    def rounded(self, observed: Observed) -> Observed:
        """Return an observation in the type of its space."""
        return as_dtype(observed, self.dtype)

    def commands(
        self, position: Vectors, goal: Vectors, speed: Numbers, action: Vectors, is_vehicle: Flags | None = None
    ) -> Vectors:
        """Return actions as velocities in m/s along the axes of the world, or as native commands.

        Args:
            position: Positions of the agents in metres.
            goal: Their goals in metres.
            speed: Their preferred speeds in m/s.
            action: Their actions.
            is_vehicle: True for vehicles, False for pedestrians; all are vehicles if None.
        """
        axes, normalized = ACTIONS[self.action]
        if normalized:
            low, high = FREE.space(speed)
            if axes == "native":
                chosen = np.True_ if is_vehicle is None else is_vehicle[:, None]
                slowest, fastest = self.scenario.rules.dynamics.space(speed)
                low, high = np.where(chosen, slowest, low), np.where(chosen, fastest, high)
            action = scale(action, low, high)
        return to_world(action, direction(position, goal)) if axes == "goal" else action

    def to_command(self, worlds: World, velocity: Vectors) -> Vectors:
        """Return the commands that drive the vehicles of worlds at velocities in m/s; native commands unchanged."""
        if ACTIONS[self.action].axes == "native":
            return velocity
        state = State(worlds.position[:, 0], worlds.velocity[:, 0], worlds.heading, worlds.angular_speed)
        return worlds.rules.dynamics.follow(state, velocity, worlds.preferred_speed[:, 0], worlds.rules.dt)


def check_view(observation: str, action: str, nearest: int, rays: int, dtype: str = "float32") -> None:
    """Raise InputError unless observation, action and type exist and the numbers are valid."""
    named = {"observation": (observation, OBSERVATIONS), "action": (action, ACTIONS), "dtype": (dtype, DTYPES)}
    for name, (value, known) in named.items():
        require(name, value, isinstance(value, str) and value in known, f"one of {', '.join(known)}")
    if observation == "lidar":
        require("nearest", nearest, nearest == NEAREST, "left out where the observation is lidar")
    require_count("nearest", nearest, MAX_PEDESTRIANS)
    most = MAX_RAYS if observation in ("goal_frame", "dict") else 0
    right = f"a whole number from 0 to {MAX_RAYS}, 0 where the observation is flat or lidar"
    require("rays", rays, is_integer(rays) and 0 <= rays <= most, right)


def encode(obs: Observation, observation: str, nearest: int, rays: int = 0) -> Observed:
    """Return the observation of a policy, computed from a planner's observation.

    Args:
        observation: One of `OBSERVATIONS`.
        nearest: Largest number of pedestrians in an observation in the frame of the goal.
        rays: Number of rays to walls.
    """
    if observation == "flat":
        return flatten(obs)
    if observation == "lidar":
        return lidar_features(obs)
    numbers = features(obs, nearest)
    mask = numbers.seen.astype(np.float64)
    ahead = {}
    if rays:
        distances = wall_distances(obs.vehicle.position, numbers.axis, obs.obstacles, rays, REACH)
        ahead = {"motion": motion(obs, numbers.axis), "rays": distances}
    if observation == "goal_frame":
        pedestrians = np.concatenate([numbers.pedestrians, mask[..., None]], axis=2)
        return np.concatenate([numbers.vehicle, pedestrians.reshape(len(obs), -1), *ahead.values()], axis=1)
    parts = {"vehicle": numbers.vehicle, "pedestrians": numbers.pedestrians, "mask": mask, **ahead}
    if obs.lidar is not None:
        parts["lidar"] = obs.lidar
    return {**parts, "history": histories(obs, numbers)}


def as_dtype(observed: Observed, dtype: str) -> Observed:
    """Return an observation as an array of a type, or as a dictionary of such arrays."""
    if isinstance(observed, dict):
        return {name: part.astype(dtype, copy=False) for name, part in observed.items()}
    return observed.astype(dtype, copy=False)


def row_of(seen: Observed, index: int) -> Observed:
    """Return the observation of one of several worlds."""
    if isinstance(seen, dict):
        return {name: part[index] for name, part in seen.items()}
    return seen[index]


def flat_bounds(scenario: Scenario) -> tuple[Float[np.ndarray, "features"], Float[np.ndarray, "features"]]:
    """Return the lowest and the highest flat observation of any agent, see `crowdbench.views.ego`."""
    speed, radius = largest_speed(scenario), largest_radius(scenario)
    # The difference of two coordinates is at most twice the largest coordinate.
    offset = 2 * position_bound(scenario)
    viewer = np.array([offset, offset, speed, speed, radius, speed])
    sensor = scenario.rules.sensor
    measured = speed + MOST_NORMAL * sensor.noise.velocity
    away = offset + MOST_NORMAL * sensor.noise.position + measured * sensor.remember
    other = np.array([away, away, measured, measured, radius, 1.0])
    if sensor.detector is not None:  # estimates of a filter
        other = np.array([np.inf, np.inf, np.inf, np.inf, max(radius, sensor.detector.radius), 1.0])
    signed = np.array([True, True, True, True, False, False])
    others = sensor.columns(scenario.max_agents - 1)
    high = np.concatenate([viewer, np.tile(other, others)])
    return np.where(np.tile(signed, len(high) // AGENT_FEATURES), -high, 0.0), high


def layout_bound(scenario: Scenario) -> float:
    """Return a bound in metres on the coordinates of starts and goals, loose enough to hold for every layout.

    For a built-in layout it is twice the sum of the numbers in its options, plus the distance of one second at the
    highest speed, because layouts shift starts by up to half of it. For a layout of points, or one that is not built
    in, it is the bound for all layouts. For recorded pedestrians it is the largest recorded coordinate.
    """
    if scenario.tracks:
        return scenario.tracks.extent
    layout = scenario.layout
    if layout is None or layout.func not in LAYOUTS.values():
        return EXTENT
    options = layout.keywords.values()
    if any(isinstance(option, list | Mapping) for option in options):
        return EXTENT
    return 2 * sum(abs(option) for option in options if is_number(option)) + largest_speed(scenario)


def position_bound(scenario: Scenario) -> float:
    """Return a bound in metres on positions: the bound on starts, plus the longest path until the time limit."""
    return layout_bound(scenario) + largest_speed(scenario) * scenario.rules.max_steps * scenario.rules.dt


def largest_radius(scenario: Scenario) -> float:
    """Return the largest radius in metres of an agent, of the vehicle the one of a disc around its body."""
    body = scenario.rules.body
    radius = max(scenario.vehicle.radius + (body[-1] - body[0]) / 2, scenario.crowd.largest_radius)
    return max(radius, scenario.tracks.largest_radius) if scenario.tracks else radius


def largest_speed(scenario: Scenario) -> float:
    """Return a bound in m/s on the speed of an agent."""
    pedestrians = scenario.crowd.largest_preferred_speed * (FASTEST if scenario.rules.intentions else 1.0)
    return max(scenario.vehicle.preferred_speed, pedestrians) * (1 + SPEED_TOLERANCE)
