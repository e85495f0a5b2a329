"""The filter before a planner: the same as a textbook's Kalman filter, on time, with a memory."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from lookahead_scenes import DT, crowded

from crowdbench.catalog import load_planner
from crowdbench.core.kalman import ACCELERATION
from crowdbench.core.types import HISTORY, Noise, Sensor
from crowdbench.planners.planner import Planner
from crowdbench.planners.reactive import ORCAPlanner
from studies.filtered import EXACT, MEMORY, FilteredPlanner, KalmanFilter

NOISE = Noise(position=0.2, velocity=0.4)


def seen_at(step, position, velocity, sensor, seen=True, observed=None):
    """What a sensor shows of one person in one world, whose last two positions lie on a line."""
    obs = crowded(2, 1).take(slice(0, 1))
    position, velocity = np.array(position, float), np.array(velocity, float)
    back = DT * np.arange(1 - HISTORY, 1)[:, None]
    crowd = dataclasses.replace(
        obs.pedestrians,
        position=position[None, None],
        velocity=velocity[None, None],
        seen=np.array([[seen]]),
        history=(position + back * velocity)[None, :, None],
        observed=np.array([[min(step + 1, HISTORY) if observed is None else observed]]),
        age=np.array([[sensor.delay if seen else np.inf]]),
    )
    return dataclasses.replace(obs, pedestrians=crowd, step=np.array([step]), sensor=sensor)


def test_estimates_are_those_of_the_textbook():
    rng = np.random.default_rng(0)
    ours, sensor = KalmanFilter(), Sensor(noise=NOISE)
    ours.reset(np.arange(1))
    move = np.array([[1.0, DT], [0.0, 1.0]])
    process = ACCELERATION * np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]])
    error = np.diag([NOISE.position**2, NOISE.velocity**2])
    mean = covariance = last = None
    for step in range(12):
        truth = np.array([0.3 * step, 1.0 - 0.1 * step])
        position, velocity = truth + 0.2 * rng.normal(size=2), np.array([1.2, -0.4]) + 0.4 * rng.normal(size=2)
        obs = seen_at(step, position, velocity, sensor)
        if last is not None:
            obs.pedestrians.history[0, -2, 0] = last
        last = position
        measured = np.stack([position, velocity])  # rows: position, velocity; columns: x, y
        if mean is None:
            mean, covariance = measured, error
        else:
            mean, covariance = move @ mean, move @ covariance @ move.T + process
            gain = covariance @ np.linalg.inv(covariance + error)
            mean, covariance = mean + gain @ (measured - mean), (np.eye(2) - gain) @ covariance
        crowd = ours.filter(obs).pedestrians
        np.testing.assert_allclose(crowd.position[0, 0], mean[0], atol=1e-12)
        np.testing.assert_allclose(crowd.velocity[0, 0], mean[1], atol=1e-12)
        np.testing.assert_allclose(crowd.deviation[0, 0], np.sqrt(np.diag(covariance)), atol=1e-12)
        np.testing.assert_allclose(crowd.history[0, -1] - crowd.history[0, -2], DT * crowd.velocity[0])


def test_what_is_seen_exactly_stays():
    obs = crowded()
    shown = KalmanFilter().filter(obs).pedestrians
    seen = obs.pedestrians.seen
    np.testing.assert_array_equal(shown.seen, seen)
    np.testing.assert_allclose(shown.position[seen], obs.pedestrians.position[seen])
    np.testing.assert_allclose(shown.velocity[seen], obs.pedestrians.velocity[seen])
    np.testing.assert_allclose(shown.deviation[seen], EXACT)


def test_a_late_measurement_is_moved_on_to_now():
    shown = KalmanFilter().filter(seen_at(4, [1.0, 2.0], [0.5, -1.0], Sensor(delay=2 * DT))).pedestrians
    np.testing.assert_allclose(shown.position[0, 0], [1.0 + 0.5 * 2 * DT, 2.0 - 2 * DT])
    assert (shown.deviation[0, 0] > EXACT).all()


def test_who_is_hidden_is_remembered_for_a_while_and_ever_less_certain():
    ours, sensor = KalmanFilter(), Sensor(range=5.0)
    ours.filter(seen_at(0, [1.0, 2.0], [0.5, -1.0], sensor))
    deviations = []
    for step in range(1, int(MEMORY / DT) + 1):
        crowd = ours.filter(seen_at(step, [0.0, 0.0], [0.0, 0.0], sensor, seen=False)).pedestrians
        assert crowd.seen.all()
        assert crowd.age[0, 0] == pytest.approx(step * DT)
        np.testing.assert_allclose(crowd.position[0, 0], [1.0 + 0.5 * step * DT, 2.0 - step * DT])
        deviations.append(crowd.deviation[0, 0])
    assert np.all(np.diff(deviations, axis=0) > 0.0)
    assert not ours.filter(seen_at(step + 1, [0.0, 0.0], [0.0, 0.0], sensor, seen=False)).pedestrians.seen.any()


@pytest.mark.parametrize("observed", [1, HISTORY])
def test_another_person_in_the_same_place_is_estimated_anew(observed):
    """A scenario with `nearest` shows other people in the same row, each with its own history."""
    ours, sensor = KalmanFilter(), Sensor(noise=NOISE)
    ours.filter(seen_at(6, [1.0, 2.0], [0.5, -1.0], sensor))
    crowd = ours.filter(seen_at(7, [5.0, 5.0], [0.0, 1.0], sensor, observed=observed)).pedestrians
    np.testing.assert_array_equal(crowd.position[0, 0], [5.0, 5.0])
    np.testing.assert_array_equal(crowd.velocity[0, 0], [0.0, 1.0])


class Shown(Planner):
    """Drives to the right, and remembers what it was shown."""

    def plan(self, obs):
        self.obs = obs
        return np.tile([1.0, 0.0], (len(obs), 1))


def test_a_vehicle_stands_until_the_first_measurements_can_arrive():
    planner = FilteredPlanner(Shown())
    planner.reset(np.arange(1))
    sensor = Sensor(delay=2 * DT)
    first = [planner.plan(seen_at(step, [1.0, 2.0], [0.0, 0.0], sensor))[0, 0] for step in range(4)]
    assert first == [0.0, 0.0, 1.0, 1.0]
    assert planner.planner.obs.pedestrians.deviation is not None


def test_the_filtered_planner_of_studies_is_the_named_one_behind_the_filter():
    file = str(Path(__file__).parents[2] / "studies" / "filtered.py")
    assert isinstance(load_planner(file, {"name": "orca"}).planner, ORCAPlanner)
