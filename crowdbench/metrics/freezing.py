"""The metric of a vehicle that stands although it could go."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import Discs, nearest_in_step, norm
from crowdbench.core.types import DISCOMFORT_GAP, Trace
from crowdbench.metrics.info import describe
from crowdbench.metrics.motion import STANDSTILL
from crowdbench.metrics.sums import total
from crowdbench.sim.obstacles import touches_in_step
from crowdbench.sim.routes import goals_in_trace
from crowdbench.utils.compiled import njit

OPEN_TIME = 2.0
"""For so many seconds the way ahead must be free where a vehicle that stands is frozen."""


@describe("frozen time", "less", over_all=True)
def frozen_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time that the vehicle stood although its way was open for the next 2 s [s].

    It stands below 0.05 m/s. Its way was open if at its preferred speed, straight ahead on its route and from then on,
    it would have kept 0.2 m from all pedestrians, as they really walked, and touched no obstacle, for 2 s or up to its
    goal. Where the route bends within these 2 s, the straight way often ends at a wall, and is not open. The last 2 s
    of an episode do not count, because nobody knows where pedestrians would have walked after its end. Freezing is
    described by Trautman and Krause (2010); this measure of it is ours.
    """
    ahead = math.ceil(OPEN_TIME / trace.rules.dt - 1e-9)
    stands = norm(trace.velocity[:, 1:, 0]) < STANDSTILL
    row, t = np.nonzero(stands & (np.arange(stands.shape[1]) + ahead <= trace.steps[:, None]))
    way = goals_in_trace(trace)[row, t] - trace.position[row, t, 0]
    stride, body = trace.preferred_speed[row, 0] * trace.rules.dt, np.array(trace.rules.body)
    person, obstacles = np.ascontiguousarray(trace.person), np.ascontiguousarray(trace.obstacles)
    radius = trace.radius[row, t]
    frozen = np.zeros(stands.shape, bool)
    is_open = norm(way) > 0.0
    if is_open.any():
        _keep_clear_of_people(row, t, way, stride, ahead, body, trace.position, radius, person, is_open)
    if obstacles.shape[1] and is_open.any():
        _keep_clear_of_walls(row, way, ahead * stride, body, trace.position[row, t, 0], radius, obstacles, is_open)
    frozen[row, t] = is_open
    return total(1.0 * frozen) * trace.rules.dt


@no_type_check
@njit
def _keep_clear_of_people(row, t, way, stride, ahead, body, position, radius, person, is_open):
    """Keep those of the open states in which nobody comes near.

    Args:
        row: `[state]`, the world of each state.
        t: `[state]`, its time.
        way: `[state, 2]`, the straight way to the local goal in metres.
        stride: `[state]`, the way of a step at the preferred speed in metres.
        ahead: The number of steps for which the way must be open.
        body: `[disc]`, see `crowdbench.core.dynamics.body`.
        position: `[world, time, agent, 2]`, in metres.
        radius: `[state, agent]`, in metres.
        person: `[world, time, pedestrian]`.
        is_open: `[state]`, changed.
    """
    agents = radius.shape[1]
    begin, motion, counts = np.empty((agents, 2)), np.empty((agents, 2)), np.zeros(agents, np.bool_)
    for s in range(len(row)):
        if not is_open[s]:
            continue
        w = row[s]
        length = math.hypot(way[s, 0], way[s, 1])
        ux, uy = way[s, 0] / length, way[s, 1] / length
        x, y = position[w, t[s], 0, 0], position[w, t[s], 0, 1]
        for k in range(ahead):
            first, last = k * stride[s], min((k + 1) * stride[s], length)
            if first >= length or not is_open[s]:
                break
            now = t[s] + k
            for a in range(1, agents):
                begin[a, 0], begin[a, 1] = position[w, now, a, 0], position[w, now, a, 1]
                motion[a, 0] = position[w, now + 1, a, 0] - begin[a, 0]
                motion[a, 1] = position[w, now + 1, a, 1] - begin[a, 1]
                is_same = person[w, now, a - 1] == person[w, now + 1, a - 1]
                counts[a] = is_same and not math.isnan(motion[a, 0])
            motion[0, 0], motion[0, 1] = (last - first) * ux, (last - first) * uy
            for centre in body:
                begin[0, 0], begin[0, 1] = x + (centre + first) * ux, y + (centre + first) * uy
                gap, _ = nearest_in_step(0, Discs(begin, motion, radius[s], counts))
                if gap < DISCOMFORT_GAP:
                    is_open[s] = False


@no_type_check
@njit
def _keep_clear_of_walls(row, way, reach, body, position, radius, obstacles, is_open):
    """Keep those of the open states in which no wall is in the way.

    Args:
        row: `[state]`, the world of each state.
        way: `[state, 2]`, the straight way to the local goal in metres.
        reach: `[state]`, how far the way must be open at most, in metres.
        body: `[disc]`, see `crowdbench.core.dynamics.body`.
        position: `[state, 2]`, of the vehicle in metres.
        radius: `[state, agent]`, in metres.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        is_open: `[state]`, changed.
    """
    for s in range(len(row)):
        if is_open[s]:
            length = math.hypot(way[s, 0], way[s, 1])
            ux, uy, far = way[s, 0] / length, way[s, 1] / length, min(length, reach[s])
            for centre in body:
                x, y = position[s, 0] + centre * ux, position[s, 1] + centre * uy
                if touches_in_step(x, y, far * ux, far * uy, radius[s, 0], obstacles[row[s]]):
                    is_open[s] = False
