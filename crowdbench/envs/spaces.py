"""The environments' spaces: float64, so that nothing is rounded on the way, with bounds from the scenario."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box

from crowdbench.envs.observations import AGENT_FEATURES
from crowdbench.scenario.scenario import Quantity, Scenario
from crowdbench.sim.simulator import SPEED_TOLERANCE


def vehicle_action_space(scenario: Scenario) -> Box:
    """The vehicle's velocity in m/s; a velocity in a corner, too fast, is slowed down to the preferred speed."""
    return _action_space(scenario.vehicle_speed)


def pedestrian_action_space(scenario: Scenario) -> Box:
    """A pedestrian's velocity in m/s, bounded by the fastest that the scenario draws."""
    return _action_space(_largest(scenario.preferred_speed))


def observation_space(scenario: Scenario) -> Box:
    """What any agent may see, in the form of `crowdbench.envs.observations`."""
    speed = _max_speed(scenario)
    radius = max(scenario.vehicle_radius, _largest(scenario.radius))
    # Two positions, or a position and a goal, are at most twice as far apart as each from the origin.
    offset = 2 * position_bound(scenario)
    viewer = np.array([offset, offset, speed, speed, radius, speed])
    other = np.array([offset, offset, speed, speed, radius, 1.0])
    signed = np.array([True, True, True, True, False, False])
    high = np.concatenate([viewer, *[other] * (scenario.max_agents - 1)])
    low = np.where(np.tile(signed, len(high) // AGENT_FEATURES), -high, 0.0)
    return Box(low, high, dtype=np.float64)


def place_bound(scenario: Scenario) -> float:
    """A coordinate, in metres, that nobody's start or goal exceeds.

    It is generous, so that it holds for every generator (and a test holds every generator to it): twice the
    sum of the lengths in the layout, plus a second at the highest speed, by which some shift their places.
    """
    return 2 * sum(scenario.layout.values()) + _max_speed(scenario)


def position_bound(scenario: Scenario) -> float:
    """A coordinate, in metres, that nobody's position exceeds: one walks from the start until the time limit."""
    return place_bound(scenario) + _max_speed(scenario) * scenario.rules.max_steps * scenario.rules.dt


def _action_space(speed: float) -> Box:
    return Box(-speed, speed, (2,), np.float64)


def _max_speed(scenario: Scenario) -> float:
    return max(scenario.vehicle_speed, _largest(scenario.preferred_speed)) * (1 + SPEED_TOLERANCE)


def _largest(quantity: Quantity) -> float:
    return quantity.high if quantity.std > 0.0 else quantity.mean
