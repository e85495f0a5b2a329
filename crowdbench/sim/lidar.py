"""Scans of a lidar: distances to walls, people and the vehicle's body along beams. Compiled.

A person is a disc or a pair of legs. Legs are discs with the radius `LEG_RADIUS`: leg detectors expect diameters from
0.1 to 0.25 m (Xavier et al. 2005). They step `STEP_RATE` times per second at any speed, about the rate of free walking
(Weidmann 1993), so that the length of a step is proportional to the speed and a standing foot stays in place.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.arrays import Walls, WorldPoints
from crowdbench.core.rng import philox, purpose_bits
from crowdbench.core.types import Lidar, Observation, World
from crowdbench.sim.obstacles import number_of_corners
from crowdbench.utils.compiled import njit

DEFAULT_LIDAR = Lidar(beams=180, range=10.0)
"""The lidar of policies that need one in scenarios without `[sensor.lidar]`."""

LEG_RADIUS = 0.07
"""Radius of a leg in metres."""

LEG_OFFSET = 0.1
"""Distance of each leg's centre from the line of walking, in metres."""

STEP_RATE = 1.9
"""Steps per second of a person, one with each leg by turns."""

_GOLDEN = 0.6180339887498949
"""Difference between the gait phases of two successive persons, in cycles."""

_CERTAIN = 1e-6
"""Margin in beams and in metres, so that rounding excludes no beam."""

_NOISE = purpose_bits("lidar")


def scan(world: World, lidar: Lidar, agents: int = 1) -> Float[np.ndarray, "world agent beam"]:
    """Scan from the positions of agents.

    The first beam of the vehicle points along its heading, that of a pedestrian along its velocity. An agent is not in
    its own scan. Pedestrians scan the discs of the vehicle's body, unless the vehicle is invisible to them.

    Args:
        world: The worlds.
        lidar: The lidar.
        agents: Number of agents that scan, the vehicle first.

    Returns:
        Distances in metres.
    """
    rules, heading, distance = world.rules, headings(world, agents), np.empty((len(world), agents, lidar.beams))
    seconds = world.step * rules.dt if lidar.legs else np.zeros(0)
    body = np.array(rules.body if rules.visible and agents > 1 else (), np.float64)
    people = world.position, world.velocity, world.radius, world.present, world.person
    measure_beams(heading, *people, seconds, body, world.obstacles, lidar.range, distance)
    chances = lidar.noise or 0.0, lidar.dropout or 0.0, lidar.false_returns or 0.0
    if any(chances):
        _disturb(world.key, world.step, *chances, lidar.range, distance)
    return distance


def headings(world: World, agents: int) -> Float[np.ndarray, "world agent"]:
    """Return the headings in radians of the first agents. That of a pedestrian is the direction of its velocity."""
    velocity = world.velocity[:, 1:agents]
    return np.column_stack([world.heading, np.arctan2(velocity[..., 1], velocity[..., 0])])


def scan_of(obs: Observation) -> Float[np.ndarray, "world beam"]:
    """Return the scan of an observation: that of the scenario's lidar, or else of `DEFAULT_LIDAR`.

    The default lidar measures the pedestrians in the observation, as discs, and the obstacles.
    """
    if obs.lidar is not None:
        return obs.lidar
    vehicle, crowd, lidar = obs.vehicle, obs.pedestrians, DEFAULT_LIDAR
    position = np.concatenate([vehicle.position[:, None], crowd.position], axis=1)
    radius = np.concatenate([vehicle.radius[:, None], crowd.radius], axis=1)
    present = np.concatenate([np.ones((len(obs), 1), bool), crowd.seen], axis=1)
    person, distance = np.zeros(crowd.seen.shape, np.int64), np.empty((len(obs), 1, lidar.beams))
    people = position, np.zeros_like(position), radius, present, person
    measure_beams(vehicle.heading[:, None], *people, np.zeros(0), np.zeros(0), obs.obstacles, lidar.range, distance)
    return distance[:, 0]


def wall_distances(
    position: WorldPoints, axis: WorldPoints, obstacles: Walls, rays: int, reach: float
) -> Float[np.ndarray, "world ray"]:
    """Return the distances in metres from points to walls along rays, the first along `axis`; at most `reach`."""
    distance = np.empty((len(position), 1, rays))
    angle, point, nobody = np.arctan2(axis[:, 1], axis[:, 0])[:, None], position[:, None], np.zeros((len(position), 1))
    person = np.zeros((len(position), 0), np.int64)
    people = np.ascontiguousarray(point), np.zeros_like(point), nobody, nobody.astype(bool), person
    measure_beams(angle, *people, np.zeros(0), np.zeros(0), obstacles, reach, distance)
    return distance[:, 0]


@no_type_check
@njit(error_model="numpy")
def measure_beams(heading, position, velocity, radius, present, person, seconds, body, obstacles, reach, distance):
    """Measure the lengths of beams. Compiled.

    Args:
        heading (array): `[world, agent]`, direction of each first beam in radians; the others follow counter-clockwise.
        position (array): `[world, agent, 2]`, in metres.
        velocity (array): `[world, agent, 2]`, in m/s.
        radius (array): `[world, agent]`, in metres.
        present (array): `[world, agent]`; agents that are not present do not stop beams.
        person (array): `[world, pedestrian]`, numbers of the persons, which determine the phases of their gaits.
        seconds (array): `[world]`, the time, if people are pairs of legs; empty if they are discs.
        body (array): Offsets of the discs of the vehicle's body ahead of its position, in metres; empty if it stops no
            beam.
        obstacles (array): `[world, polygon, corner, 2]`, in metres.
        reach (float): The longest distance in metres.
        distance (array): `[world, agent, beam]`, filled: to the nearest person or edge in metres, `reach` without one.
    """
    worlds, agents, beams = distance.shape
    disc, owner = np.empty((2 * radius.shape[1] + len(body), 3)), np.empty(2 * radius.shape[1] + len(body), np.int64)
    beam_x, beam_y = np.empty(beams), np.empty(beams)
    for w in range(worlds):
        number = _place_people(position[w], velocity[w], radius[w], present[w], person[w], w, seconds, disc, owner)
        for offset in body:
            x, y = (
                position[w, 0, 0] + offset * math.cos(heading[w, 0]),
                position[w, 0, 1] + offset * math.sin(heading[w, 0]),
            )
            disc[number, 0], disc[number, 1], disc[number, 2], owner[number] = x, y, radius[w, 0], 0
            number += 1
        for a in range(agents):
            x, y, row = position[w, a, 0], position[w, a, 1], distance[w, a]
            beam_x[:] = np.nan
            row[:] = 1.0
            _meet_walls(x, y, heading[w, a], obstacles[w], reach, beam_x, beam_y, row)
            for k in range(beams):
                row[k] *= reach
            for d in range(number):
                if owner[d] != a:
                    _meet_disc(disc[d, 0] - x, disc[d, 1] - y, disc[d, 2], heading[w, a], reach, beam_x, beam_y, row)


@no_type_check
@njit(error_model="numpy")
def _place_people(position, velocity, radius, present, person, world, seconds, disc, owner):
    """Fill the discs `[disc, 3]` and the agents that own them with the people of one world. Return their number."""
    number = 0
    for a in range(1, len(radius)):
        if not present[a]:
            continue
        if len(seconds) == 0:
            disc[number, 0], disc[number, 1], disc[number, 2] = position[a, 0], position[a, 1], radius[a]
            owner[number] = a
            number += 1
            continue
        speed = math.hypot(velocity[a, 0], velocity[a, 1])
        c, s = (velocity[a, 0] / speed, velocity[a, 1] / speed) if speed > 0.0 else (1.0, 0.0)
        cycle = (seconds[world] * STEP_RATE / 2.0 + person[a - 1] * _GOLDEN) % 1.0
        # A triangular wave: relative to the body, the foot on the ground moves back at the speed of walking.
        ahead = (abs(4.0 * cycle - 2.0) - 1.0) * speed / (2.0 * STEP_RATE)
        for side in (1.0, -1.0):
            disc[number, 0] = position[a, 0] + side * (ahead * c - LEG_OFFSET * s)
            disc[number, 1] = position[a, 1] + side * (ahead * s + LEG_OFFSET * c)
            disc[number, 2], owner[number] = LEG_RADIUS, a
            number += 1
    return number


@no_type_check
@njit(error_model="numpy")
def _meet_walls(x, y, heading, obstacles, reach, beam_x, beam_y, share):
    """Shorten the shares of beams `[beam]` at which they first meet an edge."""
    for polygon in obstacles:
        corners = number_of_corners(polygon)
        for k in range(corners if corners > 2 else corners - 1):
            ax, ay = polygon[k, 0] - x, polygon[k, 1] - y
            ex, ey = polygon[(k + 1) % corners, 0] - x - ax, polygon[(k + 1) % corners, 1] - y - ay
            bx, by, far = ax + ex, ay + ey, 1.001 * reach
            if min(ax, bx) > far or max(ax, bx) < -far or min(ay, by) > far or max(ay, by) < -far:
                continue
            start = math.atan2(ay, ax)
            turn = (math.atan2(by, bx) - start + math.pi) % (2.0 * math.pi) - math.pi
            near = min(ax * ax + ay * ay, bx * bx + by * by) < 1e-12
            if near or abs(turn) > 3.1:  # the scanner is on the edge or close to it
                start, turn = 0.0, 2.0 * math.pi
            first, count = _arc(min(start, start + turn) - heading, abs(turn), len(share))
            for b in range(first, first + count):
                b -= len(share) if b >= len(share) else 0
                _aim(b, heading, beam_x, beam_y)
                dx, dy = reach * beam_x[b], reach * beam_y[b]
                across = dx * ey - dy * ex
                # An edge parallel to the beam is not hit, except at its end.
                if across == 0.0:
                    continue
                along, on_edge = (ax * ey - ay * ex) / across, (ax * dy - ay * dx) / across
                if 0.0 <= along < share[b] and 0.0 <= on_edge <= 1.0:
                    share[b] = along


@no_type_check
@njit(error_model="numpy")
def _meet_disc(dx, dy, radius, heading, reach, beam_x, beam_y, distance):
    """Shorten the beams `[beam]` that meet a disc at a relative position."""
    apart = math.sqrt(dx * dx + dy * dy)
    if not apart - radius < reach:
        return
    half = math.asin(radius / apart) if apart > radius else math.pi
    first, count = _arc(math.atan2(dy, dx) - half - heading, 2.0 * half, len(distance))
    for b in range(first, first + count):
        b -= len(distance) if b >= len(distance) else 0
        if distance[b] < apart - radius - _CERTAIN:  # something nearer is in the way
            continue
        _aim(b, heading, beam_x, beam_y)
        along, aside = dx * beam_x[b] + dy * beam_y[b], dx * beam_y[b] - dy * beam_x[b]
        root = radius * radius - aside * aside
        root = math.sqrt(max(root, 0.0))
        if root > 0.0 and along + root > 0.0:  # not behind
            distance[b] = min(distance[b], max(along - root, 0.0))


@no_type_check
@njit
def _arc(start, angle, beams):
    """Return the first beam in an arc and the number of beams in it. Beams are counted on beyond the last one."""
    each = 2.0 * math.pi / beams
    first = math.ceil(start / each - _CERTAIN)
    last = math.floor((start + angle) / each + _CERTAIN)
    return first % beams, min(last - first + 1, beams)


@no_type_check
@njit
def _aim(beam, heading, beam_x, beam_y):
    """Compute the direction of a beam, unless that is done."""
    if math.isnan(beam_x[beam]):
        angle = heading + 2.0 * math.pi * beam / len(beam_x)
        beam_x[beam], beam_y[beam] = math.cos(angle), math.sin(angle)


@no_type_check
@njit
def _disturb(key, step, noise, dropout, false_returns, reach, distance):
    """Disturb scans `[world, agent, beam]`: Gaussian noise of echoes, lost echoes, and false ones.

    A beam that meets nothing has no noise. A false return is uniform between 0 and the distance.
    """
    worlds, agents, beams = distance.shape
    for w in range(worlds):
        for a in range(agents):
            for b in range(beams):
                c = philox(np.uint64(b), np.uint64(a), np.uint64(step[w]), np.uint64(0), key[w], _NOISE)
                u, v = (c[0] >> np.uint64(11)) * 2.0**-53, (c[1] >> np.uint64(11)) * 2.0**-53
                if v < false_returns:
                    distance[w, a, b] *= (c[2] >> np.uint64(11)) * 2.0**-53
                elif distance[w, a, b] < reach:
                    if u < dropout:
                        distance[w, a, b] = reach
                    elif noise > 0.0:
                        radial = math.sqrt(-2.0 * math.log(1.0 - (c[2] >> np.uint64(11)) * 2.0**-53))
                        angle = 2.0 * math.pi * ((c[3] >> np.uint64(11)) * 2.0**-53)
                        moved = distance[w, a, b] + noise * radial * math.cos(angle)
                        distance[w, a, b] = min(max(moved, 0.0), reach)
