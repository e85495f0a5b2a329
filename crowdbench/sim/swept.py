"""How close a vehicle on wheels comes to pedestrians and obstacles in a step. Compiled.

It drives an arc, which is swept disc by disc and chord by chord, so that no point of it is off by more than a
millimetre. (A holonomic vehicle is a disc that moves straight: `nearest_in_step` and `wall_gap_in_step` tell all.)
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np

from crowdbench.core.dynamics.motion import along_arc, chords
from crowdbench.core.geometry import Discs, nearest_in_step
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.utils.compiled import njit


@no_type_check
@njit(nogil=True)
def gaps_on_arc(body, heading, speed, turn_rate, dt, discs, obstacles):
    """The smallest distances between the vehicle's rim and those of pedestrians, and obstacles, during a step.

    Compiled, for one world.

    Args:
        body (array): Where the centres of its discs are, in metres ahead of its position.
        heading (float): Its heading before the step in radians.
        speed (float): Its speed during the step in m/s.
        turn_rate (float): Its turn rate during the step in rad/s.
        dt (float): Duration of the step in seconds.
        discs (Discs): The vehicle, whose motion is not read, and the pedestrians.
        obstacles (array): `[polygon, corner, 2]`, in metres, NaN after the last corner.

    Returns:
        gap (float): To pedestrians, in metres; negative where discs overlap, infinite without pedestrians.
        wall_gap (float): To obstacles, likewise.
    """
    position, motion = discs.position, discs.motion
    x, y = position[0, 0], position[0, 1]
    number = chords(speed, turn_rate, max(abs(body[0]), abs(body[-1])), dt)
    # By hand: numba takes seconds to compile expressions of arrays.
    begin, chord = np.empty(position.shape), np.empty(motion.shape)
    on_chord = Discs(begin, chord, discs.radius, discs.counts)
    for agent in range(1, len(position)):
        for axis in range(2):
            chord[agent, axis] = motion[agent, axis] / number
    gap, wall_gap = math.inf, math.inf
    for k in range(number):
        x0, y0, before = along_arc(x, y, heading, speed, turn_rate, dt * k / number)
        x1, y1, after = along_arc(x, y, heading, speed, turn_rate, dt * (k + 1) / number)
        for agent in range(1, len(position)):
            for axis in range(2):
                begin[agent, axis] = position[agent, axis] + k * chord[agent, axis]
        for ahead in body:
            begin[0, 0], begin[0, 1] = x0 + ahead * math.cos(before), y0 + ahead * math.sin(before)
            chord[0, 0] = x1 + ahead * math.cos(after) - begin[0, 0]
            chord[0, 1] = y1 + ahead * math.sin(after) - begin[0, 1]
            nearest, _ = nearest_in_step(0, on_chord)
            gap = min(gap, nearest)
            wall = wall_gap_in_step(begin[0, 0], begin[0, 1], chord[0, 0], chord[0, 1], discs.radius[0], obstacles)
            wall_gap = min(wall_gap, wall)
    return gap, wall_gap


@no_type_check
@njit(nogil=True)
def stopping_gap(body, deceleration, x, y, vx, vy, heading, radius, obstacles):
    """The smallest distance to obstacles while the vehicle brakes to a standstill, straight ahead. Compiled.

    A vehicle that cannot stop in front of a wall is in an inevitable collision state (Fraichard and Asama 2004).

    Args:
        body (array): Where the centres of its discs are, in metres ahead of its position.
        deceleration (float): How hard it can brake, in m/s^2; infinite if it can stop at once.
        x (float): x of its position in metres.
        y (float): Its y.
        vx (float): x of its velocity in m/s.
        vy (float): Its y.
        heading (float): Its heading in radians.
        radius (float): The radius of its discs in metres.
        obstacles (array): `[polygon, corner, 2]`, in metres, NaN after the last corner.

    Returns:
        gap (float): In metres; negative where it would hit an obstacle.
    """
    gap = math.inf
    if deceleration == math.inf:
        return gap
    time = math.hypot(vx, vy) / (2.0 * deceleration)
    c, s = math.cos(heading), math.sin(heading)
    for ahead in body:
        gap = min(gap, wall_gap_in_step(x + ahead * c, y + ahead * s, vx * time, vy * time, radius, obstacles))
    return gap
