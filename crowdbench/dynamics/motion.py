"""The compiled motion of one vehicle in one step.

A vehicle with wheels drives an arc: during a step, its speed and its turn rate are constant.
"""

from __future__ import annotations

import math
from typing import no_type_check

from crowdbench.compiled import njit
from crowdbench.geometry import heading_of, turn

HOLONOMIC, UNICYCLE, BICYCLE = 0, 1, 2
"""Codes of the dynamics: kernels take a code and an array of limits, so that they are compiled once for all."""

SPEED_TOLERANCE = 1e-6
"""Relative tolerance for rounding: a speed is limited only where it exceeds the preferred speed by more than this."""

CHORD_ERROR = 1e-3
"""Largest distance in metres between an arc and the chords that it is swept by."""


@no_type_check
@njit(nogil=True)
def drive(code, limits, x, y, vx, vy, heading, angular_speed, first, second, max_speed, dt):
    """Move a vehicle by one step. Limits are enforced by clipping. Compiled.

    Args:
        code (int): `HOLONOMIC`, `UNICYCLE` or `BICYCLE`.
        limits (array): `Dynamics.limits`.
        x (float): x of its position in metres.
        y (float): Its y.
        vx (float): x of its velocity in m/s.
        vy (float): Its y.
        heading (float): Direction in which it faces, in radians.
        angular_speed (float): Its turn rate before the step, in rad/s.
        first (float): The first number of the command, see `Dynamics`.
        second (float): The second one.
        max_speed (float): In m/s.
        dt (float): Duration of the step in seconds.

    Returns:
        state (tuple): x, y, vx, vy, heading and angular speed after the step. The velocity is the one at its end.
    """
    if code == HOLONOMIC:
        x, y, vx, vy = move_freely(limits[0] * dt, x, y, vx, vy, first, second, max_speed, dt)
        after = heading_of(vx, vy, heading)
        return x, y, vx, vy, after, turn(heading, after) / dt
    before, change = vx * math.cos(heading) + vy * math.sin(heading), limits[0] * dt
    speed = min(max(min(max(first, before - change), before + change), 0.0), max_speed)
    if code == UNICYCLE:
        change = limits[2] * dt
        turn_rate = min(max(second, angular_speed - change), angular_speed + change)
        turn_rate = min(max(turn_rate, -limits[1]), limits[1])
    else:
        turn_rate = speed * math.tan(min(max(second, -limits[1]), limits[1])) / limits[2]
    x, y, heading = along_arc(x, y, heading, speed, turn_rate, dt)
    return x, y, speed * math.cos(heading), speed * math.sin(heading), heading, turn_rate


@no_type_check
@njit(nogil=True)
def move_freely(max_change, x, y, vx, vy, wanted_x, wanted_y, max_speed, dt):
    """Move a holonomic vehicle by one step: `drive` without the heading, which takes most of its time. Compiled.

    Args:
        max_change (float): Largest change of velocity in the step, in m/s.
        x (float): x of its position in metres.
        y (float): Its y.
        vx (float): x of its velocity in m/s.
        vy (float): Its y.
        wanted_x (float): x of the velocity that it is commanded, in m/s.
        wanted_y (float): Its y.
        max_speed (float): In m/s.
        dt (float): Duration of the step in seconds.

    Returns:
        state (tuple): x, y, vx and vy after the step.
    """
    speed = math.sqrt(wanted_x * wanted_x + wanted_y * wanted_y)
    if speed > max_speed * (1.0 + SPEED_TOLERANCE):
        wanted_x, wanted_y = wanted_x * (max_speed / speed), wanted_y * (max_speed / speed)
    if max_change < math.inf:
        dx, dy = wanted_x - vx, wanted_y - vy
        change = math.sqrt(dx * dx + dy * dy)
        if change > max_change:
            wanted_x, wanted_y = vx + dx * (max_change / change), vy + dy * (max_change / change)
    return x + wanted_x * dt, y + wanted_y * dt, wanted_x, wanted_y


@no_type_check
@njit(nogil=True)
def along_arc(x, y, heading, speed, turn_rate, time):
    """Where a vehicle with wheels is after some time at constant speed and turn rate. Compiled.

    Args:
        x (float): x of its position in metres.
        y (float): Its y.
        heading (float): In radians.
        speed (float): In m/s.
        turn_rate (float): In rad/s.
        time (float): In seconds.

    Returns:
        pose (tuple): x, y and heading.
    """
    # The chord of the arc, which loses no digits where the turn rate is small.
    half = 0.5 * turn_rate * time
    chord = speed * time * (math.sin(half) / half if half != 0.0 else 1.0)
    after = turn(0.0, heading + turn_rate * time) if turn_rate != 0.0 else heading
    return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), after


@no_type_check
@njit(nogil=True)
def chords(speed, turn_rate, reach, time):
    """The number of equal chords that stand for an arc, with an error of at most `CHORD_ERROR` at every moment.

    A point at a distance of `reach` ahead of or behind the centre has the acceleration |w| sqrt(v^2 + (reach w)^2). A
    straight line over a time t is off by at most an eighth of that times t^2. Compiled.

    Args:
        speed (float): v, in m/s.
        turn_rate (float): w, in rad/s.
        reach (float): Largest distance in metres of a disc of the body from the vehicle's position.
        time (float): Duration of the arc in seconds.

    Returns:
        number (int): At least 1.
    """
    acceleration = abs(turn_rate) * math.sqrt(speed * speed + (reach * turn_rate) ** 2)
    return max(1, math.ceil(time * math.sqrt(acceleration / (8.0 * CHORD_ERROR))))
