"""The social force model of pedestrians (Helbing and Molnár 1995), compiled. Equation numbers are that paper's.

A pedestrian accelerates towards its desired velocity within a relaxation time (equation 2). The others repel it: each
is surrounded by elliptical equipotential lines that reach ahead over its next step (equations 3 and 4), and repels
less where the pedestrian does not see it (equations 7 and 8). Borders repel with their nearest point (equation 5). A
fluctuation is added (equation 10). Attractions (equation 6) are left out.

This differs from the paper:

- Pedestrians are discs here and points there: repulsion depends on the distance less the radii, see `_rim_vector`. Only
  borders repel the centre, as there: with the paper's numbers a pedestrian that walks at 1 m/s against a wall stops
  0.64 m before it, and the nearer one of two walls would close a doorway to a disc that its rim repels.
- The ellipse points in the direction in which a pedestrian walks, there in its desired direction. A vehicle cannot
  see where others want to go, and discs that want to pass each other would stay locked in pairs: in
  circle_crossing_5_social_force 34 % of the pedestrians would come within 0.3 m of their goals in time, now 97 % do.
- The speed limit is the preferred speed, as everywhere in crowdbench, there 1.3 times as much. It applies to the only
  velocity that a world keeps; there it applies to the walked velocity, and forces accumulate in another one
  (equations 11 and 12).
- Over the last metre the desired speed decreases with the distance to the goal, so that pedestrians come to rest.
- The size of the fluctuation is ours, because the paper gives none.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.compiled import njit, prange
from crowdbench.sim.group_force import ATTRACTION, GAZE, REPULSION, anybody_in, group_force
from crowdbench.sim.kernels import serial_and_parallel
from crowdbench.sim.obstacles import nearest_on_segment, number_of_corners

SUB_STEP = 0.05
"""Longest step of the integration, in seconds."""

SIGHT_ANGLE = math.radians(200.0)
"""The paper's 2 phi in radians."""

FLUCTUATION = 0.05
"""Size of the fluctuation in m/s. It turns a pedestrian at 1 m/s by 3 degrees, enough to choose a side."""

SOFTNESS = 0.025
"""Distance in metres at which repulsion acts between two rims that touch. Pedestrians overlap in 43 of the 500 cases of
circle_crossing_5_social_force if this is 0.1, in 3 if it is 0.05, and in none if it is 0.025 or 0.01."""

PARALLEL_PAIRS = 1000
"""Batches with at least this many pairs of agents run on several threads, whose start takes 110 microseconds."""

_TINY = 1e-9
"""Takes the place of 0 where a formula divides by a parameter."""

_HEAD_ON = 1e-7
"""Semi-minor axis in metres below which two pedestrians meet head-on: a few times its rounding error."""


def social_force_velocities(
    position: Float[np.ndarray, "world agent 2"],
    velocity: Float[np.ndarray, "world agent 2"],
    goal: Float[np.ndarray, "world agent 2"],
    radius: Float[np.ndarray, "world agent"],
    preferred_speed: Float[np.ndarray, "world agent"],
    noise: Float[np.ndarray, "world agent 2"],
    *,
    time_step: float = 0.25,
    sub_step: float = SUB_STEP,
    relaxation_time: float | Float[np.ndarray, "world agent"] = 0.5,
    repulsion_strength: float | Float[np.ndarray, "world agent"] = 2.1,
    repulsion_range: float | Float[np.ndarray, "world agent"] = 0.3,
    look_ahead: float | Float[np.ndarray, "world agent"] = 2.0,
    sight_angle: float | Float[np.ndarray, "world agent"] = SIGHT_ANGLE,
    behind_weight: float | Float[np.ndarray, "world agent"] = 0.5,
    fluctuation: float | Float[np.ndarray, "world agent"] = FLUCTUATION,
    obstacles: Float[np.ndarray, "world polygon corner 2"] | None = None,
    wall_strength: float | Float[np.ndarray, "world agent"] = 10.0,
    wall_range: float | Float[np.ndarray, "world agent"] = 0.2,
    group: Int[np.ndarray, "world pedestrian"] | None = None,
    group_gaze: float | Float[np.ndarray, "world agent"] = GAZE,
    group_attraction: float | Float[np.ndarray, "world agent"] = ATTRACTION,
    group_repulsion: float | Float[np.ndarray, "world agent"] = REPULSION,
    seen: Bool[np.ndarray, "world agent"] | None = None,
    moves: Bool[np.ndarray, "world agent"] | None = None,
) -> Float[np.ndarray, "world agent 2"]:
    """The velocity that each agent has at the end of the step.

    It is not the mean velocity of the step, because the next step starts from it: thus an agent that is alone gains
    speed with exactly the relaxation time. Within the step all agents move at once, in equal sub-steps.

    The parameters from `relaxation_time` on are of the agent that feels the force, one number or one per agent. Their
    defaults are the paper's, except that of `fluctuation`.

    Args:
        position: Centres in metres.
        velocity: Current velocities in m/s.
        goal: Goals in metres.
        radius: Radii in metres.
        preferred_speed: Preferred and largest speeds in m/s.
        noise: Standard normal numbers, one per agent and axis, for the fluctuation during this step.
        time_step: Length of the step in seconds.
        sub_step: Longest sub-step in seconds.
        relaxation_time: tau, in seconds.
        repulsion_strength: V0, in m^2/s^2.
        repulsion_range: sigma, in metres.
        look_ahead: Delta t, in seconds: an ellipse reaches over the way of this time.
        sight_angle: 2 phi, the angle of sight, in radians.
        behind_weight: c, the weight of repulsion from outside that angle.
        fluctuation: Standard deviation, in m/s, of the velocity of an agent alone, across its way. It does not depend
            on the time step, and decreases over the last metre as the desired speed does.
        obstacles: Polygons in metres, NaN after the last corner; two corners are a wall.
        wall_strength: U0, in m^2/s^2.
        wall_range: R, in metres.
        group: The number of each pedestrian's group, negative for those who walk alone, as all do if None.
        group_gaze: In 1/(rad s); see `crowdbench.sim.group_force` for this and the next two.
        group_attraction: In m/s^2.
        group_repulsion: In m/s^2.
        seen: Whether the agent repels others; all do if None.
        moves: Whether the agent's velocity is computed; all are if None. The others keep their velocity in this step.

    Returns:
        Velocities in m/s; 0 for agents that do not move.
    """
    shape = radius.shape
    everybody = np.ones(shape, np.bool_)
    relaxation = np.maximum(relaxation_time, _TINY)
    traits = np.empty((*shape, 9))
    traits[..., 0] = relaxation
    traits[..., 1] = repulsion_strength
    traits[..., 2] = np.maximum(repulsion_range, _TINY)
    traits[..., 3] = look_ahead
    traits[..., 4] = np.cos(np.multiply(sight_angle, 0.5))
    traits[..., 5] = behind_weight
    traits[..., 6] = fluctuation * _acceleration(relaxation, time_step)
    traits[..., 7] = wall_strength
    traits[..., 8] = np.maximum(wall_range, _TINY)
    numbers = bonds = None
    if group is not None and anybody_in(group):
        numbers, bonds = np.full(shape, -1), np.empty((*shape, 3))
        numbers[:, 1:] = group
        bonds[..., 0], bonds[..., 1], bonds[..., 2] = group_gaze, group_attraction, group_repulsion
    out = np.zeros((*shape, 2))
    compute = _social_force_parallel if radius.size * shape[1] >= PARALLEL_PAIRS else _social_force_serial
    compute(
        np.ascontiguousarray(position),
        np.ascontiguousarray(velocity),
        np.ascontiguousarray(goal),
        np.ascontiguousarray(radius),
        np.maximum(preferred_speed, _TINY),
        np.ascontiguousarray(noise),
        traits,
        np.empty((shape[0], 0, 0, 2)) if obstacles is None else np.ascontiguousarray(obstacles),
        numbers,
        bonds,
        time_step,
        max(1, math.ceil(time_step / sub_step - 1e-9)),
        everybody if seen is None else np.ascontiguousarray(seen),
        everybody if moves is None else np.ascontiguousarray(moves),
        out,
    )
    return out


def _acceleration(relaxation: float | np.ndarray, time_step: float) -> float | np.ndarray:
    """The standard deviation of the acceleration that gives the velocity a standard deviation of 1.

    The acceleration is constant during a step and changes the velocity by itself times relaxation * (1 - decay). The
    effect of earlier steps decays: an Ornstein-Uhlenbeck process, sampled at every step.

    Args:
        relaxation: Relaxation time in seconds, a number or `[world, agent]`.
        time_step: Length of a step in seconds.

    Returns:
        In 1/s: an acceleration per velocity.
    """
    decay = np.exp(-time_step / relaxation)
    return np.sqrt((1.0 + decay) / (1.0 - decay)) / relaxation


@no_type_check
def _social_force(
    position,
    velocity,
    goal,
    radius,
    preferred_speed,
    noise,
    traits,
    obstacles,
    group,
    bonds,
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
        noise: `[world, agent, 2]`, standard normal.
        traits: `[world, agent, 9]`, the parameters of each agent: relaxation time, strength, range, look-ahead, cosine
            of half the angle of sight, weight behind, standard deviation of the fluctuating acceleration, strength and
            range of borders.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        group: `[world, agent]`, the number of each agent's group, negative for those who walk alone; None where all do.
        bonds: `[world, agent, 3]`, gaze, attraction and repulsion within a group; None where all walk alone.
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
                limit, tau, push = preferred_speed[w, i], traits[w, i, 0], traits[w, i, 6]
                gx, gy, eagerness = desired_velocity(x[i], goal[w, i], limit)
                fx, fy = _repulsion(i, x, v, gx, gy, radius[w], seen[w], traits[w, i])
                if obstacles.shape[1] > 0:
                    bx, by = _border_repulsion(x[i, 0], x[i, 1], obstacles[w], traits[w, i, 7], traits[w, i, 8])
                    fx, fy = fx + bx, fy + by
                if group is not None:  # for None, another kernel is compiled
                    gaze, attraction, repulsion = bonds[w, i]
                    bx, by = group_force(i, x, v, radius[w], seen[w], group[w], gaze, attraction, repulsion)
                    fx, fy = fx + bx, fy + by
                fx, fy = fx + eagerness * push * noise[w, i, 0], fy + eagerness * push * noise[w, i, 1]
                # The exact solution for constant forces. Explicit Euler steps of 0.05 s would act like a relaxation
                # time 5 % shorter.
                gain = 1.0 - math.exp(-h / tau)
                vx, vy = v[i, 0] + gain * (gx + tau * fx - v[i, 0]), v[i, 1] + gain * (gy + tau * fy - v[i, 1])
                slower = limit / max(math.sqrt(vx * vx + vy * vy), limit)
                new[i, 0], new[i, 1] = slower * vx, slower * vy
            for i in range(agents):
                v[i, 0], v[i, 1] = new[i, 0], new[i, 1]
                x[i, 0], x[i, 1] = x[i, 0] + h * v[i, 0], x[i, 1] + h * v[i, 1]
        for i in range(agents):
            if moves[w, i]:
                out[w, i, 0], out[w, i, 1] = v[i, 0], v[i, 1]


_social_force_serial, _social_force_parallel = serial_and_parallel(_social_force)


@no_type_check
@njit
def desired_velocity(position, goal, preferred_speed):
    """The desired velocity (equations 1 and 2), as `geometry.toward_goal` computes it.

    `position` and `goal` are `[2]` in metres, the preferred speed is in m/s. Returns x and y of the velocity in m/s,
    and the ratio of its length to the preferred speed.
    """
    x, y = goal[0] - position[0], goal[1] - position[1]
    distance = math.sqrt(x * x + y * y)
    scale = preferred_speed / max(distance, preferred_speed)
    return scale * x, scale * y, scale * distance / preferred_speed


@no_type_check
@njit
def _repulsion(i, position, velocity, gx, gy, radius, seen, traits):
    """The sum of the repulsion of all others on agent i, weighted by whether it sees them (equations 7 and 8).

    Args:
        i: Index of the agent.
        position: `[agent, 2]`, in metres.
        velocity: `[agent, 2]`, in m/s.
        gx, gy: The agent's desired velocity in m/s.
        radius: `[agent]`, in metres.
        seen: `[agent]`, whether the agent repels others.
        traits: `[9]`, the parameters of agent i, see `_social_force`.

    Returns:
        x and y of an acceleration in m/s^2.
    """
    strength, reach, look_ahead, sight, behind = traits[1], traits[2], traits[3], traits[4], traits[5]
    ax, ay = 0.0, 0.0
    desired = math.sqrt(gx * gx + gy * gy)
    for j in range(len(position)):
        if j == i or not seen[j]:
            continue
        x, y = _rim_vector(position[i, 0] - position[j, 0], position[i, 1] - position[j, 1], radius[i] + radius[j])
        fx, fy = _force(x, y, look_ahead * velocity[j, 0], look_ahead * velocity[j, 1], strength, reach)
        toward = -(gx * fx + gy * fy)
        weight = 1.0 if toward >= desired * math.sqrt(fx * fx + fy * fy) * sight else behind
        ax, ay = ax + weight * fx, ay + weight * fy
    return ax, ay


@no_type_check
@njit
def _rim_vector(x, y, radii):
    """The vector between two centres, shortened by the radii: the paper's r for pedestrians that are discs.

    Its length is almost the gap between the rims where there is one, `SOFTNESS` where they touch, and goes smoothly
    to 0 the more they overlap.

    Args:
        x, y: The vector between the centres in metres.
        radii: Sum of the radii in metres.

    Returns:
        x and y of the shortened vector in metres.
    """
    distance = math.sqrt(x * x + y * y)
    if distance == 0.0:
        return 0.0, 0.0
    gap = distance - radii
    length = 0.5 * (gap + math.sqrt(gap * gap + 4.0 * SOFTNESS * SOFTNESS))
    return x * (length / distance), y * (length / distance)


@no_type_check
@njit
def _force(x, y, sx, sy, strength, reach):
    """The repulsion at (x, y) by a pedestrian at the origin.

    It is minus the gradient of strength * exp(-b / reach) (equation 3), where b is the semi-minor axis of the ellipse
    through (x, y) with the foci (0, 0) and (sx, sy) (equation 4).

    Args:
        x, y: Where the repulsion acts, in metres.
        sx, sy: The displacement of that pedestrian within the look-ahead, in metres.
        strength: V0, in m^2/s^2.
        reach: sigma, in metres.

    Returns:
        x and y of an acceleration in m/s^2.
    """
    tx, ty = x - sx, y - sy
    here, there = math.sqrt(x * x + y * y), math.sqrt(tx * tx + ty * ty)
    total = here + there
    b = 0.5 * math.sqrt(max(total * total - (sx * sx + sy * sy), 0.0))
    # Exactly in front of the other the gradient does not exist. No side is better, and the fluctuation decides.
    if b < _HEAD_ON or here == 0.0 or there == 0.0:
        return 0.0, 0.0
    scale = strength / reach * math.exp(-b / reach) * total / (4.0 * b)
    return scale * (x / here + tx / there), scale * (y / here + ty / there)


@no_type_check
@njit
def _border_repulsion(x, y, polygons, strength, reach):
    """The sum of the repulsion of all borders (equation 5), each from its point nearest to the centre.

    It is minus the gradient of strength * exp(-distance / reach).

    Args:
        x, y: The agent's centre in metres.
        polygons: `[polygon, corner, 2]`, in metres, NaN after the last corner.
        strength: U0, in m^2/s^2.
        reach: R, in metres.

    Returns:
        x and y of an acceleration in m/s^2.
    """
    ax, ay = 0.0, 0.0
    for polygon in polygons:
        corners = number_of_corners(polygon)
        least, dx, dy = math.inf, 0.0, 0.0
        for k in range(corners if corners > 2 else corners - 1):
            first, second = polygon[k], polygon[(k + 1) % corners]
            px, py = nearest_on_segment(x, y, first[0], first[1], second[0], second[1])
            distance = math.sqrt((x - px) * (x - px) + (y - py) * (y - py))
            if distance < least:
                least, dx, dy = distance, x - px, y - py
        # On the border itself there is no direction away from it.
        if 0.0 < least < math.inf:
            scale = strength / reach * math.exp(-least / reach) / least
            ax, ay = ax + scale * dx, ay + scale * dy
    return ax, ay
