"""The power law of pedestrian interactions (Karamouzas et al. 2014), compiled.

A pedestrian accelerates towards its desired velocity within a relaxation time. With everybody with whom it would
collide after the time tau, if both kept their velocities, it has the energy E = k tau^-2 exp(-tau / tau0) per mass, and
its acceleration is minus the gradient of E by its position.

The paper has no walls. Here, as in the code that its authors have published, a wall is somebody who stands: tau is the
time after which the pedestrian's disc would touch it.

This differs from the paper:

- The speed limit is the preferred speed, and over the last metre the desired speed decreases with the distance to the
  goal, as everywhere in crowdbench.
- Forces have no bound there, and go to infinity as tau goes to 0. The bound here is that of the authors' code; it holds
  for the sum of the forces of others and walls. As there, discs that overlap count as almost touching.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.compiled import njit, prange
from crowdbench.sim.kernels import at, per_agent, serial_and_parallel
from crowdbench.sim.obstacles import number_of_corners
from crowdbench.sim.social_force import PARALLEL_PAIRS, SUB_STEP, desired_velocity

_OVERLAPPING = 0.99
"""Discs that overlap count as if their radii added up to so much of the distance of their centres."""

_SHORTEST = 1e-3
"""Shorter times to collision in seconds count as this one, where the force is beyond any bound."""


def power_law_velocities(
    position: Float[np.ndarray, "world agent 2"],
    velocity: Float[np.ndarray, "world agent 2"],
    goal: Float[np.ndarray, "world agent 2"],
    radius: Float[np.ndarray, "world agent"],
    preferred_speed: Float[np.ndarray, "world agent"],
    *,
    time_step: float = 0.25,
    sub_step: float = SUB_STEP,
    relaxation_time: float | Float[np.ndarray, "world agent"] = 0.54,
    interaction_energy: float | Float[np.ndarray, "world agent"] = 1.5,
    interaction_horizon: float | Float[np.ndarray, "world agent"] = 3.0,
    max_acceleration: float | Float[np.ndarray, "world agent"] = 20.0,
    obstacles: Float[np.ndarray, "world polygon corner 2"] | None = None,
    seen: Bool[np.ndarray, "world agent"] | None = None,
    moves: Bool[np.ndarray, "world agent"] | None = None,
) -> Float[np.ndarray, "world agent 2"]:
    """The velocity that each agent has at the end of the step, see `social_force_velocities`.

    Args:
        position: Centres in metres.
        velocity: Current velocities in m/s.
        goal: Goals in metres.
        radius: Radii in metres.
        preferred_speed: Preferred and largest speeds in m/s.
        time_step: Length of the step in seconds.
        sub_step: Longest sub-step in seconds.
        relaxation_time: xi, in seconds. This and the next three are of the agent that feels the force, one number or
            one per agent.
        interaction_energy: k, in m^2.
        interaction_horizon: tau0, in seconds.
        max_acceleration: Bound of the sum of the forces of others and walls, in m/s^2.
        obstacles: Polygons in metres, NaN after the last corner; two corners are a wall.
        seen: Whether the agent repels others; all do if None.
        moves: Whether the agent's velocity is computed; all are if None. The others keep their velocity in this step.

    Returns:
        Velocities in m/s; 0 for agents that do not move.
    """
    shape = radius.shape
    everybody = np.ones(shape, np.bool_)
    out = np.zeros((*shape, 2))
    compute = _power_law_parallel if radius.size * shape[1] >= PARALLEL_PAIRS else _power_law_serial
    compute(
        np.ascontiguousarray(position),
        np.ascontiguousarray(velocity),
        np.ascontiguousarray(goal),
        np.ascontiguousarray(radius),
        np.maximum(preferred_speed, 1e-9),
        per_agent(relaxation_time),
        per_agent(interaction_energy),
        per_agent(interaction_horizon),
        per_agent(max_acceleration),
        np.empty((shape[0], 0, 0, 2)) if obstacles is None else np.ascontiguousarray(obstacles),
        time_step,
        max(1, math.ceil(time_step / sub_step - 1e-9)),
        everybody if seen is None else np.ascontiguousarray(seen),
        everybody if moves is None else np.ascontiguousarray(moves),
        out,
    )
    return out


@no_type_check
def _power_law(
    position,
    velocity,
    goal,
    radius,
    preferred_speed,
    relaxation_time,
    energy,
    horizon,
    bound,
    obstacles,
    time_step,
    sub_steps,
    seen,
    moves,
    out,
):
    """The loop over worlds, compiled twice: for one thread and for all.

    Args:
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, in m/s.
        goal: `[world, agent, 2]`, in metres.
        radius: `[world, agent]`, in metres.
        preferred_speed: `[world, agent]`, in m/s.
        relaxation_time: In seconds; this and the next three are read by `at`.
        energy: k, in m^2.
        horizon: tau0, in seconds.
        bound: In m/s^2.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        time_step: Length of the step in seconds.
        sub_steps: Number of sub-steps.
        seen: `[world, agent]`, whether the agent repels others.
        moves: `[world, agent]`, whether the agent's velocity is computed.
        out: `[world, agent, 2]`, zeros, filled: velocities in m/s.
    """
    worlds, agents = radius.shape
    h = time_step / sub_steps
    for w in prange(worlds):
        x, v, new = position[w].copy(), velocity[w].copy(), velocity[w].copy()
        for _ in range(sub_steps):
            for i in range(agents):
                if not moves[w, i]:
                    continue
                limit, xi = preferred_speed[w, i], max(at(relaxation_time, w, i), 1e-9)
                k, tau0 = at(energy, w, i), max(at(horizon, w, i), 1e-9)
                gx, gy, _ = desired_velocity(x[i], goal[w, i], limit)
                fx, fy = _from_others(i, x, v, radius[w], seen[w], k, tau0)
                for polygon in obstacles[w]:
                    bx, by = _from_wall(x[i, 0], x[i, 1], v[i, 0], v[i, 1], radius[w, i], polygon, k, tau0)
                    fx, fy = fx + bx, fy + by
                most = at(bound, w, i)
                weaker = most / max(math.sqrt(fx * fx + fy * fy), most, 1e-9)
                # The exact solution for constant forces, as for the social force.
                gain = 1.0 - math.exp(-h / xi)
                vx = v[i, 0] + gain * (gx + xi * weaker * fx - v[i, 0])
                vy = v[i, 1] + gain * (gy + xi * weaker * fy - v[i, 1])
                slower = limit / max(math.sqrt(vx * vx + vy * vy), limit)
                new[i, 0], new[i, 1] = slower * vx, slower * vy
            for i in range(agents):
                v[i, 0], v[i, 1] = new[i, 0], new[i, 1]
                x[i, 0], x[i, 1] = x[i, 0] + h * v[i, 0], x[i, 1] + h * v[i, 1]
        for i in range(agents):
            if moves[w, i]:
                out[w, i, 0], out[w, i, 1] = v[i, 0], v[i, 1]


_power_law_serial, _power_law_parallel = serial_and_parallel(_power_law)


@no_type_check
@njit
def _from_others(i, position, velocity, radius, seen, k, tau0):
    """The sum of the forces of all others on agent i.

    Args:
        i: Index of the agent.
        position: `[agent, 2]`, in metres.
        velocity: `[agent, 2]`, in m/s.
        radius: `[agent]`, in metres.
        seen: `[agent]`, whether the agent repels others.
        k: In m^2.
        tau0: In seconds.

    Returns:
        x and y of an acceleration in m/s^2.
    """
    ax, ay = 0.0, 0.0
    for j in range(len(position)):
        if j == i or not seen[j]:
            continue
        wx, wy = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
        vx, vy = velocity[i, 0] - velocity[j, 0], velocity[i, 1] - velocity[j, 1]
        tau, tx, ty = _until_discs_touch(wx, wy, vx, vy, radius[i] + radius[j])
        force = _force(tau, k, tau0)
        ax, ay = ax + force * tx, ay + force * ty
    return ax, ay


@no_type_check
@njit
def _from_wall(x, y, vx, vy, radius, polygon, k, tau0):
    """The force of an obstacle, at the corner or side that the agent would touch first.

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
        tau, tx, ty = _until_side_touched(
            x - begin[0], y - begin[1], vx, vy, radius, end[0] - begin[0], end[1] - begin[1]
        )
        if tau < first:
            first, ax, ay = tau, tx, ty
    force = _force(first, k, tau0)
    return force * ax, force * ay


@no_type_check
@njit
def _force(tau, k, tau0):
    """Minus the derivative of the energy by tau.

    Args:
        tau: Time to collision in seconds; infinite where there is none.
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
    """When an agent touches another disc if both keep their velocities, and how this depends on where it is.

    Args:
        wx, wy: From the agent's centre to the other's, in metres.
        vx, vy: The agent's velocity, relative to the other's, in m/s.
        reach: The sum of the radii in metres.

    Returns:
        tau in seconds, and x and y of its gradient by the agent's position, in s/m; infinite, 0 and 0 where they do not
        touch.
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
    """As `_until_discs_touch`, for the side of an obstacle without its ends.

    Args:
        x, y: The agent's centre in metres, from the beginning of the side.
        vx, vy: Its velocity in m/s.
        radius: Its radius in metres.
        sx, sy: The side in metres.

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
