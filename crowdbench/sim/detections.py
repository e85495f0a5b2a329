"""Measurements of the vehicle's sensor in one step: of known pedestrians, or the detections of a detector of people.

A measurement is x, y, vx, vy and radius, NaN without one. Noise and missed detections are determined by case, step and
person. They are drawn from the key of the case, which is not part of observations.
"""

from __future__ import annotations

import math
import operator
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.rng import four_normal, purpose_bits, uniform
from crowdbench.core.types import World
from crowdbench.sim.lines_of_sight import is_hidden
from crowdbench.utils.compiled import njit

_SCENE = operator.attrgetter(
    "key", "step", "position", "velocity", "heading", "radius", "present", "person", "obstacles"
)
"""Arrays of a world that `_measure` takes."""

_NOISE, _MISSED = purpose_bits("sensor"), purpose_bits("missed detections")
_FALSE, _FALSE_VELOCITY = purpose_bits("false detections"), purpose_bits("velocities of false detections")

FALSE_RANGE = 8.0
"""Largest distance in metres of a false detection by a sensor without a range: that of Spinello and Arras (2011)."""


def measure(world: World) -> Float[np.ndarray, "world pedestrian 5"]:
    """Return measurements of each pedestrian, NaN for undetected ones."""
    sensor, detector = world.rules.sensor, world.rules.sensor.detector
    measured = np.full((*world.person.shape, 5), np.nan)
    reach = np.inf if sensor.range is None else sensor.range
    least_cosine = -2.0 if sensor.field_of_view >= 360.0 else math.cos(math.radians(sensor.field_of_view / 2.0))
    errors = sensor.noise.position, sensor.noise.velocity, sensor.missed
    if detector is not None:
        errors = detector.position, detector.velocity or 0.0, detector.missed
    _measure(measured, reach, least_cosine, sensor.occlusion, *errors, *_SCENE(world))
    return measured


def detect(
    world: World,
) -> tuple[Float[np.ndarray, "world column 5"], Bool[np.ndarray, "world pedestrian"]]:
    """Return the detections of a detector of people, and the pedestrians that are detected.

    The detections are sorted by their distance from the vehicle: their order shows nothing else about identities. False
    detections lie uniformly in the field of view of the sensor, where no wall hides them if there is occlusion. There
    are at most `Detector.spare`. Their number has a Poisson distribution.
    """
    sensor, detector = world.rules.sensor, world.rules.sensor.detector
    assert detector is not None
    measured = measure(world)
    is_detected = ~np.isnan(measured[..., 0])
    false = np.full((len(world), detector.spare, 5), np.nan)
    reach = FALSE_RANGE if sensor.range is None else sensor.range
    view = reach, math.radians(sensor.field_of_view), sensor.occlusion
    errors = detector.false_detections, detector.radius, detector.velocity or 0.0
    _add_false(false, *view, *errors, *_SCENE(world))
    detections = np.concatenate([measured, false], axis=1)
    is_there = ~np.isnan(detections[..., 0])
    detections[is_there, 4] = detector.radius
    if detector.velocity is None:
        detections[is_there, 2:4] = 0.0
    away = detections[..., :2] - world.position[:, :1]
    order = np.argsort(away[..., 0] ** 2 + away[..., 1] ** 2, axis=1, kind="stable")
    return np.take_along_axis(detections, order[..., None], axis=1), is_detected


@no_type_check
@njit(error_model="numpy")
def _measure(measured, reach, least_cosine, occlusion, position_noise, velocity_noise, missed, *scene):
    """Measure pedestrians that can be seen and are not missed.

    Args:
        measured: `[world, pedestrian, 5]`, filled with measurements.
        reach: Largest distance in metres between the rims of the vehicle and of a person that is seen.
        least_cosine: Smallest cosine of the angle between the heading and a person that is seen.
        occlusion: True if walls and other pedestrians hide pedestrians.
        position_noise: Standard deviation in metres.
        velocity_noise: Standard deviation in m/s.
        missed: Probability that a person is not detected.
        *scene: `_SCENE` of the worlds.
    """
    key, step, position, velocity, heading, radius, present, person, obstacles = scene
    for w in range(len(key)):
        for p in range(person.shape[1]):
            a = p + 1
            if not present[w, a]:
                continue
            dx, dy = position[w, a, 0] - position[w, 0, 0], position[w, a, 1] - position[w, 0, 1]
            distance = math.sqrt(dx * dx + dy * dy)
            if distance - radius[w, 0] - radius[w, a] > reach:
                continue
            if dx * math.cos(heading[w]) + dy * math.sin(heading[w]) < least_cosine * distance:
                continue
            if occlusion and is_hidden(a, position[w], radius[w], present[w], obstacles[w]):
                continue
            if missed > 0.0 and uniform(person[w, p], step[w], key[w], _MISSED) < missed:
                continue
            row = measured[w, p]
            row[0], row[1] = position[w, a, 0], position[w, a, 1]
            row[2], row[3], row[4] = velocity[w, a, 0], velocity[w, a, 1], radius[w, a]
            if position_noise > 0.0 or velocity_noise > 0.0:
                noise = four_normal(0, person[w, p], step[w], np.uint64(0), key[w], _NOISE)
                row[0], row[1] = row[0] + position_noise * noise[0], row[1] + position_noise * noise[1]
                row[2], row[3] = row[2] + velocity_noise * noise[2], row[3] + velocity_noise * noise[3]


@no_type_check
@njit(error_model="numpy")
def _add_false(false, reach, field_of_view, occlusion, mean, radius, velocity_noise, *scene):
    """Draw false detections.

    Args:
        false: `[world, spare, 5]`, filled with false detections.
        reach: Largest distance in metres between the rims of the vehicle and of a false detection.
        field_of_view: In radians.
        occlusion: True if there are no false detections behind walls.
        mean: Mean number in a step.
        radius: Radius of a detection in metres.
        velocity_noise: Standard deviation in m/s of the measured velocities, whose mean is zero.
        *scene: `_SCENE` of the worlds.
    """
    key, step, position, _, heading, radii, _, _, obstacles = scene
    pair, discs, present = np.empty((2, 2)), np.full(2, radius), np.ones(2, np.bool_)
    for w in range(len(key)):
        share, chance, n = uniform(0, step[w], key[w], _FALSE), math.exp(-mean), 0
        nearest = radii[w, 0] + radius
        while share >= chance and n < false.shape[1]:
            share -= chance
            n += 1
            chance *= mean / n
            squared = nearest**2 + uniform(2 * n, step[w], key[w], _FALSE) * ((reach + nearest) ** 2 - nearest**2)
            angle = heading[w] + (uniform(2 * n + 1, step[w], key[w], _FALSE) - 0.5) * field_of_view
            pair[0] = position[w, 0]
            pair[1, 0] = pair[0, 0] + math.sqrt(squared) * math.cos(angle)
            pair[1, 1] = pair[0, 1] + math.sqrt(squared) * math.sin(angle)
            if occlusion and is_hidden(1, pair, discs, present, obstacles[w]):
                continue
            noise = four_normal(0, n, step[w], np.uint64(0), key[w], _FALSE_VELOCITY)
            false[w, n - 1, :2] = pair[1]
            false[w, n - 1, 2], false[w, n - 1, 3] = velocity_noise * noise[0], velocity_noise * noise[1]
            false[w, n - 1, 4] = radius
