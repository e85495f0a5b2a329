"""The compiled motion of one vehicle in one step.

A vehicle with wheels drives an arc: during a step, its speed and its turn rate are constant.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

from crowdbench.core.geometry import turn
from crowdbench.utils.compiled import njit

HOLONOMIC, UNICYCLE, BICYCLE = 0, 1, 2
"""Codes of the dynamics: kernels take a code and an array of limits, so that they are compiled once for all."""

SPEED_TOLERANCE = 1e-6
"""Relative tolerance for rounding: a speed is limited only if it exceeds the preferred speed by more than this."""

CHORD_ERROR = 1e-3
"""Largest distance in metres between an arc and the chords that approximate it."""


class Motion(NamedTuple):
    """Position and motion of one vehicle. For kernels.

    Attributes:
        x: x of its position in metres.
        y: Its y.
        vx: x of its velocity at the end of the last step, in m/s.
        vy: Its y.
        heading: Direction in which it faces, in radians.
        turn_rate: In the last step, in rad/s.
    """

    x: float
    y: float
    vx: float
    vy: float
    heading: float
    turn_rate: float


@no_type_check
@njit(nogil=True)
def drive(code, limits, before, command, max_speed, dt):
    """Move a vehicle by one step. Limits are enforced by clipping. Compiled.

    Args:
        code (int): `HOLONOMIC`, `UNICYCLE` or `BICYCLE`.
        limits (array): `Dynamics.limits`.
        before (Motion): Its motion before the step.
        command (tuple): The two numbers of the command, see `Dynamics`.
        max_speed (float): In m/s.
        dt (float): Duration of the step in seconds.

    Returns:
        after (Motion): Its motion after the step.
    """
    x, y, vx, vy, heading, turn_rate = before
    first, second = command
    if code == HOLONOMIC:
        x, y, vx, vy = _move_freely(limits[0] * dt, x, y, vx, vy, first, second, max_speed, dt)
        after = math.atan2(vy, vx) if vx != 0.0 or vy != 0.0 else heading
        return Motion(x, y, vx, vy, after, turn(heading, after) / dt)
    forward, change = vx * math.cos(heading) + vy * math.sin(heading), limits[0] * dt
    slowest = 0.0 - min(limits[3], max_speed)
    speed = min(max(min(max(first, forward - change), forward + change), slowest), max_speed)
    if code == UNICYCLE:
        change = limits[2] * dt
        turn_rate = min(max(second, turn_rate - change), turn_rate + change)
        turn_rate = min(max(turn_rate, -limits[1]), limits[1])
    else:
        turn_rate = speed * math.tan(min(max(second, -limits[1]), limits[1])) / limits[2]
    x, y, heading = along_arc(x, y, heading, speed, turn_rate, dt)
    return Motion(x, y, speed * math.cos(heading), speed * math.sin(heading), heading, turn_rate)


@no_type_check
@njit(nogil=True)
def signed_speed(vx, vy, heading):
    """Return the speed of a vehicle on wheels, negative if it drives backwards. Compiled.

    Args:
        vx (float): x of its velocity in m/s.
        vy (float): Its y.
        heading (float): Its heading at the end of the step in radians.

    Returns:
        speed (float): In m/s.
    """
    return math.copysign(math.hypot(vx, vy), vx * math.cos(heading) + vy * math.sin(heading))


@no_type_check
@njit(nogil=True)
def drive_without_heading(code, limits, before, command, max_speed, dt):
    """Drive with the arguments of `drive`, but keep the heading of a holonomic vehicle. Compiled.

    Its turn rate is 0. The computation of this heading takes most of the time, and no planner needs it.
    """
    if code == HOLONOMIC:
        x, y, vx, vy, heading, _ = before
        x, y, vx, vy = _move_freely(limits[0] * dt, x, y, vx, vy, command[0], command[1], max_speed, dt)
        return Motion(x, y, vx, vy, heading, 0.0)
    return drive(code, limits, before, command, max_speed, dt)


@no_type_check
@njit(nogil=True)
def _move_freely(max_change, x, y, vx, vy, wanted_x, wanted_y, max_speed, dt):
    """Move a holonomic vehicle, whose velocity changes by at most `max_change` in m/s; returns x, y, vx and vy."""
    wanted_x, wanted_y = limit_speed(wanted_x, wanted_y, max_speed)
    if max_change < math.inf:
        dx, dy = wanted_x - vx, wanted_y - vy
        change = math.sqrt(dx * dx + dy * dy)
        if change > max_change:
            wanted_x, wanted_y = vx + dx * (max_change / change), vy + dy * (max_change / change)
    return x + wanted_x * dt, y + wanted_y * dt, wanted_x, wanted_y


@no_type_check
@njit(nogil=True)
def limit_speed(vx, vy, limit):
    """Reduce a velocity to a limit if it is faster. Compiled.

    Args:
        vx (float): x of the velocity in m/s.
        vy (float): Its y.
        limit (float): The largest speed in m/s.

    Returns:
        velocity (tuple): x and y.
    """
    speed = math.sqrt(vx * vx + vy * vy)
    if speed == math.inf and math.isfinite(vx) and math.isfinite(vy):  # the squares are too large for a float
        largest = max(abs(vx), abs(vy))
        vx, vy = vx / largest, vy / largest
        speed = math.sqrt(vx * vx + vy * vy)
        return vx * (limit / speed), vy * (limit / speed)
    if speed > limit * (1.0 + SPEED_TOLERANCE):
        return vx * (limit / speed), vy * (limit / speed)
    return vx, vy


@no_type_check
@njit(nogil=True)
def limit_change(vx, vy, before_x, before_y, limits, dt):
    """Shorten the change of a pedestrian's velocity in a step to what its limits allow. Compiled.

    The change keeps its direction. The largest changes form two halves of an ellipse around the direction of walking.
    A pedestrian that stops within the step can accelerate in the rest of it. From standing, all directions are equal.

    Args:
        vx (float): x of the requested velocity in m/s.
        vy (float): Its y.
        before_x (float): x of the velocity before the step, in m/s.
        before_y (float): Its y.
        limits (WalkingLimits): The limits.
        dt (float): Duration of the step in seconds.

    Returns:
        velocity (tuple): x and y.
    """
    if limits.acceleration == math.inf:
        return vx, vy
    dx, dy, speed = vx - before_x, vy - before_y, math.sqrt(before_x * before_x + before_y * before_y)
    ux, uy = (before_x / speed, before_y / speed) if speed > 0.0 else (1.0, 0.0)
    walks = min(speed / (limits.braking * dt), 1.0)
    forward, left = dx * ux + dy * uy, dy * ux - dx * uy
    behind = limits.acceleration + walks * (limits.braking - limits.acceleration)
    beside = limits.acceleration + walks * (limits.sideways - limits.acceleration)
    excess = math.hypot(forward / (limits.acceleration if forward > 0.0 else behind), left / beside) / dt
    return (before_x + dx / excess, before_y + dy / excess) if excess > 1.0 else (vx, vy)


@no_type_check
@njit(nogil=True)
def along_arc(x, y, heading, speed, turn_rate, time):
    """Return the pose of a vehicle with wheels after some time at constant speed and turn rate. Compiled.

    Args:
        x (float): x of its position in metres.
        y (float): Its y.
        heading (float): In radians.
        speed (float): In m/s, negative if it drives backwards.
        turn_rate (float): In rad/s.
        time (float): In seconds.

    Returns:
        pose (tuple): x, y and heading.
    """
    # The chord of the arc, which is accurate also for small turn rates.
    half = 0.5 * turn_rate * time
    chord = speed * time * (math.sin(half) / half if half != 0.0 else 1.0)
    after = turn(0.0, heading + turn_rate * time) if turn_rate != 0.0 else heading
    return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), after


@no_type_check
@njit(nogil=True)
def chords(speed, turn_rate, reach, time):
    """Return the number of equal chords that replace an arc with an error of at most `CHORD_ERROR` at every moment.

    A point at a distance of `reach` ahead of or behind the centre has the acceleration |w| sqrt(v^2 + (reach w)^2). A
    straight line over a time t is off by at most an eighth of that times t^2. Compiled.

    Args:
        speed (float): v, in m/s; its sign has no effect.
        turn_rate (float): w, in rad/s.
        reach (float): Largest distance in metres of a disc of the body from the vehicle's position.
        time (float): Duration of the arc in seconds.

    Returns:
        number (int): At least 1.
    """
    acceleration = abs(turn_rate) * math.sqrt(speed * speed + (reach * turn_rate) ** 2)
    return max(1, math.ceil(time * math.sqrt(acceleration / (8.0 * CHORD_ERROR))))
