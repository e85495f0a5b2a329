"""Action and observation spaces, in float64 so that nothing is rounded, with bounds from the scenario."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box

from crowdbench.dynamics import SPEED_TOLERANCE
from crowdbench.envs.observations import AGENT_FEATURES
from crowdbench.numbers import is_number
from crowdbench.rng import MOST_NORMAL
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.people import Quantity
from crowdbench.scenario.placing import EXTENT
from crowdbench.scenario.scenario import Scenario


def vehicle_action_space(scenario: Scenario, native: bool = False) -> Box:
    """Velocities of the vehicle in m/s, each axis within its preferred speed, or the commands of its dynamics.

    In a corner the speed is larger than the preferred speed; the simulator limits it.

    Args:
        scenario: The scenario.
        native: Whether actions are commands of the dynamics.
    """
    if native:
        low, high = scenario.rules.dynamics.space(np.array([scenario.vehicle_speed]))
        return Box(low[0], high[0], dtype=np.float64)
    return _action_space(scenario.vehicle_speed)


def pedestrian_action_space(scenario: Scenario) -> Box:
    """Velocities of a pedestrian in m/s, each axis within the largest preferred speed that the scenario draws."""
    return _action_space(_largest(scenario.preferred_speed))


def observation_space(scenario: Scenario) -> Box:
    """Bounds of the observations of any agent, see `crowdbench.envs.observations`."""
    speed = _max_speed(scenario)
    body = scenario.rules.body
    radius = max(scenario.vehicle_radius + (body[-1] - body[0]) / 2, _largest(scenario.radius))
    if scenario.tracks:
        radius = max(radius, scenario.tracks.largest_radius)
    # The difference of two coordinates is at most twice the largest coordinate.
    offset = 2 * position_bound(scenario)
    viewer = np.array([offset, offset, speed, speed, radius, speed])
    sensor = scenario.rules.sensor
    measured = speed + MOST_NORMAL * sensor.noise.velocity
    away = offset + MOST_NORMAL * sensor.noise.position + measured * sensor.remember
    other = np.array([away, away, measured, measured, radius, 1.0])
    signed = np.array([True, True, True, True, False, False])
    others = scenario.max_agents - 1
    high = np.concatenate([viewer, *[other] * min(scenario.rules.sensor.nearest or others, others)])
    low = np.where(np.tile(signed, len(high) // AGENT_FEATURES), -high, 0.0)
    return Box(low, high, dtype=np.float64)


def layout_bound(scenario: Scenario) -> float:
    """A bound in metres on the coordinates of starts and goals, loose enough to hold for every layout.

    Of a built-in layout it is twice the sum of the numbers in its options, plus the way of one second at the highest
    speed, because layouts shift starts by up to half of it. Of another layout it is what any layout must keep, and of
    recorded people the largest coordinate of anybody.
    """
    if scenario.tracks:
        return scenario.tracks.extent
    if scenario.layout not in LAYOUTS.values():
        return EXTENT
    lengths = [value for value in scenario.layout_options.values() if is_number(value)]
    return 2 * sum(lengths) + _max_speed(scenario)


def position_bound(scenario: Scenario) -> float:
    """A bound in metres on the coordinates of all positions: of a start, plus the way until the time limit."""
    return layout_bound(scenario) + _max_speed(scenario) * scenario.rules.max_steps * scenario.rules.dt


def _action_space(speed: float) -> Box:
    return Box(-speed, speed, (2,), np.float64)


def _max_speed(scenario: Scenario) -> float:
    return max(scenario.vehicle_speed, _largest(scenario.preferred_speed)) * (1 + SPEED_TOLERANCE)


def _largest(quantity: Quantity) -> float:
    return quantity.mean if quantity.std == 0.0 else quantity.high
