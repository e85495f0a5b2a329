"""The social force model of pedestrians (Helbing and Molnár 1995), compiled.

Phys. Rev. E 51, 4282; equation numbers are that paper's. A pedestrian accelerates towards the velocity it
desires within a relaxation time (eq. 2), is pushed away by the others, each surrounded by elliptical
equipotential lines that reach ahead over its next steps (eqs. 3 and 4), less by those out of its sight
(eqs. 7 and 8), and fluctuates (eq. 10). Borders and attractions (eqs. 5 and 6) are left out.

Where this differs from the paper, and why:

- Pedestrians there are points, here discs: repulsion acts on the distance less the radii, see `_rim_vector`.
- The ellipse of a pedestrian points there in its desired direction, here in the direction in which it walks:
  a vehicle cannot see where others want to go, and discs that want to pass each other would stay locked in
  pairs (in circle_crossing_5_social_force 34 % would come within 0.3 m of their goals in time, now 97 % do).
- The speed limit there is 1.3 times the preferred speed and applies to the velocity walked, not to the one
  that forces accumulate (eqs. 11 and 12). Here it is the preferred speed, as everywhere in crowdbench, and
  there is one velocity, because it is all that a world keeps.
- In the last metre the desired speed sinks with the distance to the goal, so that pedestrians come to rest.
- The paper gives no size for the fluctuation: it is ours.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float
from numba import njit, prange

from crowdbench.sim.kernels import serial_and_parallel

SUB_STEP = 0.05
"""Longest step of the integration, in seconds."""

SIGHT_ANGLE = math.radians(200.0)
"""The paper's 2 phi."""

FLUCTUATION = 0.05
"""Our size of the fluctuation, in m/s: enough to choose a side, a heading of 3 degrees at 1 m/s."""

SOFTNESS = 0.025
"""Metres that rims which touch are apart for the repulsion. Of circle_crossing_5_social_force's 500 cases,
43 have pedestrians that overlap at 0.1, 3 at 0.05, and none at 0.025 or 0.01."""

PARALLEL_PAIRS = 1000
"""Pairs of agents in a batch from which the 110 microseconds that starting threads costs are worth paying."""

_TINY = 1e-9
"""What stands for zero where a formula divides by a parameter."""

_HEAD_ON = 1e-7
"""Semi-minor axis in metres, a few times its rounding error, below which the way is blocked head-on."""


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
    seen: Bool[np.ndarray, "world agent"] | None = None,
    moves: Bool[np.ndarray, "world agent"] | None = None,
) -> Float[np.ndarray, "world agent 2"]:
    """The velocity that each agent has at the end of the step, in m/s.

    The end and not the mean, because the simulator keeps it as the velocity from which the next step
    starts: so an agent alone gains speed with exactly the relaxation time. Within the step everybody
    moves at once, in equal sub-steps no longer than `sub_step` seconds; agents that do not move
    (`moves`) go on with their velocity, and zero is returned for them. Agents that are not `seen`
    repel nobody.

    Defaults are the paper's: `relaxation_time` tau in seconds, `repulsion_strength` V0 in m^2/s^2,
    `repulsion_range` sigma in metres, `look_ahead` Delta t in seconds, `sight_angle` 2 phi in radians,
    `behind_weight` c. All belong to the agent that feels the force: one number, or one per agent. `noise`
    is standard normal and held during the step. It is scaled so that, whatever the time step, the velocity
    of an agent alone across its way has the standard deviation `fluctuation`, in m/s, and it fades while
    the agent slows down for its goal.
    """
    shape = radius.shape
    everybody = np.ones(shape, np.bool_)
    relaxation = np.maximum(relaxation_time, _TINY)
    traits = np.empty((*shape, 7))
    traits[..., 0] = relaxation
    traits[..., 1] = repulsion_strength
    traits[..., 2] = np.maximum(repulsion_range, _TINY)
    traits[..., 3] = look_ahead
    traits[..., 4] = np.cos(np.multiply(sight_angle, 0.5))
    traits[..., 5] = behind_weight
    traits[..., 6] = fluctuation * _acceleration(relaxation, time_step)
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
        time_step,
        max(1, math.ceil(time_step / sub_step - 1e-9)),
        everybody if seen is None else np.ascontiguousarray(seen),
        everybody if moves is None else np.ascontiguousarray(moves),
        out,
    )
    return out


def _acceleration(relaxation: float | np.ndarray, time_step: float) -> float | np.ndarray:
    """The standard deviation of the acceleration that gives the velocity a standard deviation of 1.

    Held during a step, an acceleration moves the velocity by itself times relaxation * (1 - decay), while what
    earlier steps did decays: the balance is an Ornstein-Uhlenbeck process, seen at every step.
    """
    decay = np.exp(-time_step / relaxation)
    return np.sqrt((1.0 + decay) / (1.0 - decay)) / relaxation


@no_type_check
def _social_force(
    position, velocity, goal, radius, preferred_speed, noise, traits, time_step, sub_steps, seen, moves, out
):
    """The loop over worlds, compiled twice: for one thread and for all."""
    worlds, agents = radius.shape
    h = time_step / sub_steps
    for w in prange(worlds):
        x, v, new = position[w].copy(), velocity[w].copy(), velocity[w].copy()
        for _ in range(sub_steps):
            for i in range(agents):
                if not moves[w, i]:
                    continue
                limit, tau, push = preferred_speed[w, i], traits[w, i, 0], traits[w, i, 6]
                gx, gy, eagerness = _desired(x[i], goal[w, i], limit)
                fx, fy = _repulsion(i, x, v, gx, gy, radius[w], seen[w], traits[w, i])
                fx, fy = fx + eagerness * push * noise[w, i, 0], fy + eagerness * push * noise[w, i, 1]
                # Exact for constant forces: explicit Euler steps of 0.05 s shorten a relaxation time of 0.5 s by 5 %.
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
@njit(cache=True)
def _desired(position, goal, preferred_speed):
    """The desired velocity (eqs. 1 and 2), and its share of the preferred speed; `geometry.toward_goal` in a loop."""
    x, y = goal[0] - position[0], goal[1] - position[1]
    distance = math.sqrt(x * x + y * y)
    scale = preferred_speed / max(distance, preferred_speed)
    return scale * x, scale * y, scale * distance / preferred_speed


@no_type_check
@njit(cache=True)
def _repulsion(i, position, velocity, gx, gy, radius, seen, traits):
    """What agent i feels from all others, weighted by whether it sees them (eqs. 7 and 8)."""
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
@njit(cache=True)
def _rim_vector(x, y, radii):
    """The vector between two centres shortened by the radii: the paper's r for pedestrians that are discs.

    Its length is nearly the gap where there is one, SOFTNESS where the rims touch, and goes smoothly to zero,
    never through it, the deeper they overlap.
    """
    distance = math.sqrt(x * x + y * y)
    if distance == 0.0:
        return 0.0, 0.0
    gap = distance - radii
    length = 0.5 * (gap + math.sqrt(gap * gap + 4.0 * SOFTNESS * SOFTNESS))
    return x * (length / distance), y * (length / distance)


@no_type_check
@njit(cache=True)
def _force(x, y, sx, sy, strength, reach):
    """The repulsion at (x, y) from a pedestrian at the origin who walks by (sx, sy) within the look-ahead.

    Minus the gradient of strength * exp(-b / reach) (eq. 3), b being the semi-minor axis of the ellipse
    through (x, y) with the foci (0, 0) and (sx, sy) (eq. 4).
    """
    tx, ty = x - sx, y - sy
    here, there = math.sqrt(x * x + y * y), math.sqrt(tx * tx + ty * ty)
    total = here + there
    b = 0.5 * math.sqrt(max(total * total - (sx * sx + sy * sy), 0.0))
    # Exactly in the other's way the gradient does not exist: no side is better, and the fluctuation decides.
    if b < _HEAD_ON or here == 0.0 or there == 0.0:
        return 0.0, 0.0
    scale = strength / reach * math.exp(-b / reach) * total / (4.0 * b)
    return scale * (x / here + tx / there), scale * (y / here + ty / there)
