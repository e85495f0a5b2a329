"""The score of an episode and its parts: the least time to the goal, and the seconds close to pedestrians.

    score = success T_empty / (T + t_close)

A second close to a pedestrian costs as much as a second of travel time.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics.kernels import HOLONOMIC, along_arc, signed_speed
from crowdbench.core.geometry import turn
from crowdbench.core.types import Rules, Trace
from crowdbench.metrics.info import describe
from crowdbench.metrics.outcomes import success_rate, t_empty
from crowdbench.utils.compiled import njit

CLOSE, FAR = 0.3, 0.6
"""Gaps in metres up to which a second counts fully, and from which it does not count, see `closeness`."""

SAMPLE = 0.02
"""Largest relative motion in metres between two of the times at which the weight is sampled."""


@describe("time close to pedestrians", "less", of_successes=True)
def t_close(trace: Trace) -> Float[np.ndarray, "world"]:
    """Seconds close to pedestrians, summed over them, over successes [s].

    A second counts fully at gaps up to 0.3 m, and not at all from 0.6 m on, with a linear weight between them. The
    weight is integrated over the motion in each step. It is sampled whenever vehicle and pedestrian have moved by 2 cm.
    """
    return _seconds_close(trace)


@describe("score", "more", over_all=True)
def score(trace: Trace) -> Float[np.ndarray, "world"]:
    """Least time divided by the sum of the actual time and the seconds close to pedestrians, 0 for a failure [1].

    `t_empty` / (time + `t_close`). It is 1 at most.
    """
    least = t_empty(trace)
    # A recorded robot may be faster than its stated speed.
    time = np.maximum(trace.steps * trace.rules.dt, least)
    return success_rate(trace) * least / (time + _seconds_close(trace))


@describe("score of the worst vehicle", "more", over_all=True, among_all=True)
def worst_score(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest score of the vehicles of the case [1]."""
    vehicles = trace.rules.vehicles
    return np.repeat(score(trace).reshape(-1, vehicles).min(axis=1), vehicles)


def _seconds_close(trace: Trace) -> Float[np.ndarray, "world"]:
    """Return the seconds close to pedestrians, see `t_close`."""
    states = trace.position, trace.velocity, trace.heading, trace.radius
    return close_seconds(*states, trace.person, trace.steps, trace.rules)


def close_seconds(
    position: Float[np.ndarray, "world time agent 2"],
    velocity: Float[np.ndarray, "world time agent 2"],
    heading: Float[np.ndarray, "world time"],
    radius: Float[np.ndarray, "world time agent"],
    person: Int[np.ndarray, "world time pedestrian"],
    steps: Int[np.ndarray, "world"],
    rules: Rules,
) -> Float[np.ndarray, "world"]:
    """Return the seconds close to pedestrians of each world, see `t_close`.

    Args:
        position: In metres, of the vehicle (agent 0) and the pedestrians; NaN without a pedestrian.
        velocity: In m/s.
        heading: Of the vehicle, in radians.
        radius: In metres.
        person: See `Trace`.
        steps: Number of steps that count, from the first one.
        rules: The rules of the simulation.
    """
    seconds, numbers = np.zeros(len(steps)), rules.numbers
    states = position, velocity, heading, np.ascontiguousarray(radius), np.ascontiguousarray(person)
    fill_close_seconds(*states, steps, numbers.body, numbers.code != HOLONOMIC, numbers.dt, seconds)
    return seconds


@no_type_check
@njit(nogil=True)
def closeness(gap):
    """Return the weight of a second at a gap in metres between the rims of two agents. Compiled.

    It is 1 up to 0.3 m and falls linearly to 0 at 0.6 m. Both lie around the 0.45 m of Hall's intimate distance (1966),
    and were never measured for robots.
    """
    return min(max((FAR - gap) / (FAR - CLOSE), 0.0), 1.0)


@no_type_check
@njit(nogil=True)
def fill_close_seconds(position, velocity, heading, radius, person, steps, body, on_wheels, dt, seconds):
    """Fill in the seconds close to pedestrians of each world.

    Args:
        position (array): `[world, time, agent, 2]`, in metres.
        velocity (array): `[world, time, agent, 2]`, in m/s.
        heading (array): `[world, time]`, in radians.
        radius (array): `[world, time, agent]`, in metres.
        person (array): `[world, time, pedestrian]`, see `Trace`.
        steps (array): `[world]`.
        body (array): The centres of the vehicle's discs, in metres ahead of its position.
        on_wheels (bool): True if the vehicle drives arcs, False if it moves straight.
        dt (float): Length of a step in seconds.
        seconds (array): `[world]`, filled.
    """
    reach = max(abs(body[0]), abs(body[-1]))
    for w in range(len(seconds)):
        for t in range(steps[w]):
            x, y, speed, rate = position[w, t, 0, 0], position[w, t, 0, 1], 0.0, 0.0
            dx, dy = position[w, t + 1, 0, 0] - x, position[w, t + 1, 0, 1] - y
            moved = math.hypot(dx, dy)
            if on_wheels:
                speed = signed_speed(velocity[w, t + 1, 0, 0], velocity[w, t + 1, 0, 1], heading[w, t + 1])
                rate = turn(heading[w, t], heading[w, t + 1]) / dt
                moved = (abs(speed) + reach * abs(rate)) * dt
            for a in range(1, position.shape[2]):
                px, py = position[w, t, a, 0], position[w, t, a, 1]
                qx, qy = position[w, t + 1, a, 0] - px, position[w, t + 1, a, 1] - py
                size, way = radius[w, t, 0] + radius[w, t, a], moved + math.hypot(qx, qy)
                is_near = math.hypot(px - x, py - y) - reach - size - way < FAR  # False without a pedestrian: NaN
                if not is_near or person[w, t, a - 1] != person[w, t + 1, a - 1]:
                    continue
                samples = max(1, math.ceil(way / SAMPLE))
                for k in range(samples):
                    share = (k + 0.5) / samples
                    vx, vy, faces = x + share * dx, y + share * dy, heading[w, t]
                    if on_wheels:
                        vx, vy, faces = along_arc(x, y, faces, speed, rate, share * dt)
                    distance = math.inf
                    for ahead in body:
                        cx = px + share * qx - vx - ahead * math.cos(faces)
                        cy = py + share * qy - vy - ahead * math.sin(faces)
                        distance = min(distance, math.hypot(cx, cy))
                    seconds[w] += closeness(distance - size) * dt / samples
