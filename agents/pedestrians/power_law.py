"""The power law of the time to collision (Karamouzas et al. 2014), with the paper's parameters.

Karamouzas, Skinner and Guy, "Universal Power Law Governing Pedestrian Interactions", Physical Review Letters 113, 2014.
The model is held out for tests: no shipped planner was trained with its pedestrians.

A pedestrian accelerates towards its desired velocity within a relaxation time. With each agent with which it would
collide after the time tau at constant velocities, it has the energy E = k tau^-2 exp(-tau / tau0) per mass. This causes
an acceleration that is minus the gradient of E with respect to its position.

The paper has no walls. Here, as in the authors' published code, a wall counts as a standing agent: tau is the time
after which the pedestrian's disc would touch it. Further differences from the paper:

- The speed limit is the preferred speed, and over the last metre the desired speed decreases with the distance to the
  goal, as everywhere in crowdbench.
- In the paper, forces are unbounded and tend to infinity as tau tends to 0. Here the sum of the forces of other agents
  and walls has the bound of the authors' code. As in that code, overlapping discs count as almost touching.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench import PedestrianPolicy, World
from crowdbench.sim import (
    Parameters,
    Velocities,
    Walkers,
    compile_model,
    fill_traits,
    integrate,
    number_of_corners,
    walkers_of,
)
from crowdbench.utils import njit

AgentNumbers = Float[np.ndarray, "world agent"]
AgentPoints = Float[np.ndarray, "world agent 2"]

_OVERLAPPING = 0.99
"""For overlapping discs, this share of the distance between the centres replaces the sum of the radii."""

SUB_STEP = 0.0125
"""Longest step of the integration in seconds. Near a collision the force changes fast: in steps of 0.05 s pedestrians
oscillate. In power_law_16 with antipodal goals and without limits, the 99th percentile of their acceleration is then
1.9 m/s^2, with 1.8 reversals per person and minute. In these steps, and in steps of 0.003 s: 0.7 m/s^2 and none."""

_SHORTEST = 1e-3
"""Lower bound of times to collision in seconds; the force at this time exceeds any bound."""

_SMALLEST_HORIZON = 1e-9
"""Lower bound of the interaction horizon in seconds, by which the force divides."""


PARAMETERS: Mapping[str, float] = {
    "relaxation_time": 0.54,
    "interaction_energy": 1.5,
    "interaction_horizon": 3.0,
    "max_acceleration": 20.0,
}
"""The parameters with their defaults, which are the paper's."""


class PowerLaw(PedestrianPolicy):
    """The power law of the time to collision (Karamouzas et al. 2014), with the paper's parameters."""

    parameters: ClassVar[Mapping[str, float]] = PARAMETERS

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`, and `power_law_velocities` for the parameters."""
        dt = world.rules.dt
        return power_law_velocities(walkers_of(world), time_step=dt, parameters=parameters)[:, 1:]


def power_law_velocities(
    walkers: Walkers, *, time_step: float = 0.25, parameters: Mapping[str, float | AgentNumbers] = PARAMETERS
) -> AgentPoints:
    """Return the velocity that each agent has at the end of the step, see `forces.integrate`.

    Args:
        walkers: The agents.
        time_step: Length of the step in seconds.
        parameters: Parameters of `PARAMETERS` that differ from the defaults, of the agent on which the force acts, one
            number or one per agent: xi in seconds, k in m^2, tau0 in seconds, and the bound of the sum of the forces of
            other agents and walls in m/s^2.

    Returns:
        Velocities in m/s; 0 for agents that do not move.
    """
    traits = fill_traits(PARAMETERS, parameters, walkers.radius.shape)
    return integrate(_MODEL, walkers, traits, time_step, longest=SUB_STEP)


# Inlined: passing its arrays takes 10 % of a step.
@no_type_check
@njit(forceinline=True)
def _power_law(i, position, velocity, desired, radius, seen, traits, obstacles, w, noise, group):
    """Return the force on agent i and the share of it that acts, see `compile_model`; the bound reduces the share."""
    k, tau0, bound = traits[i, 1], max(traits[i, 2], _SMALLEST_HORIZON), traits[i, 3]
    fx, fy, x, y, vx, vy = 0.0, 0.0, position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1]
    for j in range(len(position)):
        if j == i or not seen[j]:
            continue
        wx, wy = position[j, 0] - x, position[j, 1] - y
        tau, tx, ty = _until_discs_touch(wx, wy, vx - velocity[j, 0], vy - velocity[j, 1], radius[i] + radius[j])
        force = _force(tau, k, tau0)
        fx, fy = fx + force * tx, fy + force * ty
    for polygon in obstacles:
        bx, by = _from_wall(x, y, vx, vy, radius[i], polygon, k, tau0)
        fx, fy = fx + bx, fy + by
    return fx, fy, bound / max(math.sqrt(fx * fx + fy * fy), bound, 1e-9)


_MODEL = compile_model(_power_law)


@no_type_check
@njit
def _from_wall(x, y, vx, vy, radius, polygon, k, tau0):
    """Return the force of an obstacle, at the corner or side that the agent would touch first.

    Args:
        x, y: The agent's centre in metres.
        vx, vy: Its velocity in m/s.
        radius: Its radius in metres.
        polygon: `[corner, 2]`, in metres, NaN after the last corner.
        k: In m^2.
        tau0: In seconds.

    Returns:
        x and y of an acceleration in m/s^2.
    """
    corners = number_of_corners(polygon)
    first, ax, ay = math.inf, 0.0, 0.0
    for c in range(corners):
        tau, tx, ty = _until_discs_touch(polygon[c, 0] - x, polygon[c, 1] - y, vx, vy, radius)
        if tau < first:
            first, ax, ay = tau, tx, ty
    for c in range(corners if corners > 2 else corners - 1):
        begin, end = polygon[c], polygon[(c + 1) % corners]
        sx, sy = end[0] - begin[0], end[1] - begin[1]
        tau, tx, ty = _until_side_touched(x - begin[0], y - begin[1], vx, vy, radius, sx, sy)
        if tau < first:
            first, ax, ay = tau, tx, ty
    force = _force(first, k, tau0)
    return force * ax, force * ay


@no_type_check
@njit
def _force(tau, k, tau0):
    """Return minus the derivative of the energy with respect to tau.

    Args:
        tau: Time to collision in seconds; infinite without a collision.
        k: In m^2.
        tau0: In seconds.

    Returns:
        In m^2/s^3.
    """
    if tau == math.inf:
        return 0.0
    tau = max(tau, _SHORTEST)
    return k / (tau * tau) * math.exp(-tau / tau0) * (2.0 / tau + 1.0 / tau0)


@no_type_check
@njit
def _until_discs_touch(wx, wy, vx, vy, reach):
    """Return the time until an agent touches another disc at constant velocities, and the gradient of this time.

    Args:
        wx, wy: Vector from the agent's centre to the other's, in metres.
        vx, vy: The agent's velocity, relative to the other's, in m/s.
        reach: The sum of the radii in metres.

    Returns:
        tau in seconds, and x and y of its gradient with respect to the agent's position, in s/m; infinite, 0 and 0 if
        they do not touch.
    """
    reach = min(reach, _OVERLAPPING * math.sqrt(wx * wx + wy * wy))
    a, b = vx * vx + vy * vy, wx * vx + wy * vy
    root = b * b - a * (wx * wx + wy * wy - reach * reach)
    if a <= 0.0 or b <= 0.0 or root <= 0.0:
        return math.inf, 0.0, 0.0
    root = math.sqrt(root)
    return (b - root) / a, -(vx - (b * vx - a * wx) / root) / a, -(vy - (b * vy - a * wy) / root) / a


@no_type_check
@njit
def _until_side_touched(x, y, vx, vy, radius, sx, sy):
    """Return the same as `_until_discs_touch` for a side of an obstacle without its ends.

    Args:
        x, y: The agent's centre in metres, relative to the beginning of the side.
        vx, vy: Its velocity in m/s.
        radius: Its radius in metres.
        sx, sy: Vector from the beginning to the end of the side, in metres.

    Returns:
        tau, and x and y of its gradient.
    """
    length = math.sqrt(sx * sx + sy * sy)
    if length == 0.0:
        return math.inf, 0.0, 0.0
    nx, ny = -sy / length, sx / length
    distance = nx * x + ny * y
    if distance < 0.0:
        nx, ny, distance = -nx, -ny, -distance
    approach = -(nx * vx + ny * vy)
    if approach <= 0.0:
        return math.inf, 0.0, 0.0
    tau = (distance - min(radius, _OVERLAPPING * distance)) / approach
    along = ((x + tau * vx) * sx + (y + tau * vy) * sy) / length
    if along < 0.0 or along > length:
        return math.inf, 0.0, 0.0
    return tau, nx / approach, ny / approach


def policy() -> PowerLaw:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.power_law]`.

    Parameters:
        relaxation_time: Time in which a pedestrian regains its preferred velocity: xi in the authors' code [s].
        interaction_energy: The paper's k: the energy per mass is k exp(-tau / tau0) / tau^2 for a time to collision
            tau [m^2].
        interaction_horizon: Time beyond which collisions hardly count: the paper's tau0 [s].
        max_acceleration: Bound of the sum of the forces of other agents and walls, from the authors' code [m/s^2].

    Returns:
        The policy.
    """
    return PowerLaw()
