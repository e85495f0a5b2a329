"""Whom walls may hide: where somebody is expected, and what it costs to come near."""

import dataclasses
import math

import numpy as np
import pytest
from lookahead_scenes import crowded

from crowdbench.core.types import PERFECT_SENSOR, Detector, Sensor
from crowdbench.planners.hidden import RADIUS, SPEED, STEP, UNTRACKED, hidden_scene
from crowdbench.planners.mppi import MPPIPlanner
from crowdbench.planners.scene import scene_of
from crowdbench.predict.linear import ConstantVelocity

BLOCK = np.array([[0.5, 0.5], [1.5, 0.5], [1.5, 3.0], [0.5, 3.0]])


def at_a_corner(sensor=PERFECT_SENSOR):
    """Two worlds without people: a route around the block, and one that stays before it."""
    obs = crowded(2, 1)
    vehicle = dataclasses.replace(
        obs.vehicle,
        position=np.zeros((2, 2)),
        velocity=np.zeros((2, 2)),
        goal=np.array([[2.0, 3.0], [2.0, -1.0]]),
        route=np.array([[[2.0, 0.0], [np.nan] * 2]] * 2),
        waypoint=np.zeros(2, np.int64),
        radius=np.full(2, 0.3),
    )
    crowd = dataclasses.replace(obs.pedestrians, seen=np.zeros_like(obs.pedestrians.seen))
    return dataclasses.replace(
        obs, vehicle=vehicle, pedestrians=crowd, obstacles=np.stack([BLOCK[None]] * 2), sensor=sensor
    )


def scenes(obs, steps=3):
    """The scene that is seen, and the one with whom walls may hide."""
    scene = scene_of(obs, ConstantVelocity().predict(obs, steps), 0, obs.vehicle, steps)
    return scene, hidden_scene(obs, scene)


def test_somebody_stands_where_the_route_leaves_the_sight():
    _, hidden = scenes(at_a_corner(Sensor(occlusion=True)))
    np.testing.assert_array_equal(hidden.crowd.present[:, 0], [True, False])
    x, y = hidden.crowd.position[0, 0, 0, 0]
    assert (hidden.crowd.position[0] == [x, y]).all()
    assert x == pytest.approx(2.0)
    assert hidden.crowd.radius[0, 0] == 2.0 * RADIUS

    def sees(y):
        """Whether the line to the end of a person's diameter that is farther from the block passes its corner."""
        angle = math.atan2(y, 2.0) - math.atan2(RADIUS, math.hypot(2.0, y))
        return angle < math.atan2(0.5, 1.5)

    assert not sees(y)
    assert sees(y - STEP)


def test_a_tracker_shows_late_who_comes_out_of_hiding():
    seen, tracked = (scenes(at_a_corner(Sensor(occlusion=True, detector=each)))[1] for each in (None, Detector()))
    farther = UNTRACKED * seen.dt * SPEED
    np.testing.assert_allclose(tracked.crowd.radius, seen.crowd.radius + farther)


def test_nobody_is_expected_by_a_sensor_that_sees_through_walls_or_without_walls():
    assert scenes(at_a_corner())[1] is None
    obs = at_a_corner(Sensor(occlusion=True))
    assert scenes(dataclasses.replace(obs, obstacles=np.empty((2, 0, 0, 2))))[1] is None


def test_to_come_near_costs_what_it_costs_beside_a_person():
    planner = MPPIPlanner(ConstantVelocity())
    scene, hidden = scenes(at_a_corner(Sensor(occlusion=True)))
    near = hidden.crowd.position[0, 0, 0, 0] - [0.0, 2.0 * RADIUS + 0.3 + 0.01]
    vehicle = dataclasses.replace(scene.vehicle, position=np.stack([near, near]))
    scene, hidden = (dataclasses.replace(each, vehicle=vehicle) for each in (scene, hidden))
    still = np.zeros((2, 1, 3, 2))
    with_, without = (planner.costs(scene, still, np.zeros((1, 1, 1)), each)[0][:, 0] for each in (hidden, None))
    weights, time = planner.weights, np.arange(3)
    inside = 1.0 - 0.01 / (weights.margin + weights.growth * scene.dt * time)
    np.testing.assert_allclose(with_ - without, [weights.near * (weights.fading**time * inside**2).sum(), 0.0])
