"""The vehicle and the predicted pedestrians, as input of lookaheads over one or many steps, also in compiled code."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.dynamics.kernels import Motion
from crowdbench.core.types import Observation, Vehicle
from crowdbench.predict.predictor import Prediction
from crowdbench.utils.compiled import njit

Velocities = Float[np.ndarray, "world 2"]
Commands = Float[np.ndarray, "world action 2"]
Sequence = Float[np.ndarray, "world time 2"]
Sequences = Float[np.ndarray, "world sequence time 2"]
"""Commands of the vehicle's dynamics: one per world, several to choose from, sequences of steps, several sequences."""


class Crowd(NamedTuple):
    """The pedestrians now and in each mode of a prediction.

    Attributes:
        position: Their centres in metres. Time 0 is before the first step, and time t is after t steps.
        velocity: Their velocities after the last step, in m/s.
        radius: Their radii in metres.
        present: True for pedestrians that are present. The others have no effect.
    """

    position: Float[np.ndarray, "world mode time pedestrian 2"]
    velocity: Float[np.ndarray, "world mode pedestrian 2"]
    radius: Float[np.ndarray, "world pedestrian"]
    present: Bool[np.ndarray, "world pedestrian"]


class VehicleArrays(NamedTuple):
    """The vehicles of a batch as arguments of kernels, see `Vehicle`.

    Attributes:
        code: `Dynamics.code`.
        limits: `Dynamics.limits`.
        body: The centres of its discs, in metres ahead of its position.
        motion: The numbers of `Motion`.
        goal: In metres.
        local_goal: In metres, see `Vehicle.local_goal`.
        radius: In metres.
        goal_tolerance: Distance in metres to the goal below which the vehicle has arrived.
        preferred_speed: In m/s.
    """

    code: int
    limits: Float[np.ndarray, "4"]
    body: Float[np.ndarray, "disc"]
    motion: Float[np.ndarray, "world 6"]
    goal: Float[np.ndarray, "world 2"]
    local_goal: Float[np.ndarray, "world 2"]
    radius: Float[np.ndarray, "world"]
    goal_tolerance: Float[np.ndarray, "world"]
    preferred_speed: Float[np.ndarray, "world"]


@dataclass(frozen=True)
class Scene:
    """The vehicle before a step, and the pedestrians before it and after one or several steps.

    Attributes:
        vehicle: The vehicle of each world.
        crowd: The pedestrians.
        obstacles: Polygons in metres, NaN after the last corner.
        dt: Length of a step in seconds.
    """

    vehicle: Vehicle
    crowd: Crowd
    obstacles: Float[np.ndarray, "world polygon corner 2"]
    dt: float

    @cached_property
    def arrays(self) -> VehicleArrays:
        """The vehicle as argument of kernels."""
        vehicle, tolerance = self.vehicle, self.vehicle.goal_tolerance
        return VehicleArrays(
            vehicle.dynamics.code,
            vehicle.dynamics.limits,
            np.array(vehicle.body),
            np.column_stack(vehicle.state),
            vehicle.goal,
            vehicle.local_goal,
            vehicle.radius,
            np.full_like(vehicle.radius, tolerance) if tolerance else vehicle.radius,
            vehicle.preferred_speed,
        )

    def velocities(self, commands: Commands) -> Commands:
        """Return the velocities in m/s that the vehicle has after a step with each of the commands."""
        vehicle = self.vehicle
        return vehicle.dynamics.velocities(vehicle.state, commands, vehicle.preferred_speed, self.dt)


def scene_of(obs: Observation, prediction: Prediction, step: int, vehicle: Vehicle, steps: int = 1) -> Scene:
    """Return the scene of some steps of a prediction.

    Args:
        obs: The present observation.
        prediction: The pedestrians' next steps.
        step: The first of these steps, 0 for the next one.
        vehicle: The vehicle as it is before that step.
        steps: Number of steps.
    """
    after = prediction.position[:, :, step : step + steps]
    before = prediction.position[:, :, step - 1 : step] if step else obs.pedestrians.position[:, None, None]
    before = np.broadcast_to(before, (*after.shape[:2], 1, *after.shape[3:]))
    # Always in the same memory layout, since numba compiles a function again for each layout.
    position = np.concatenate([before, after], axis=2)
    velocity = np.ascontiguousarray(prediction.velocity[:, :, step + steps - 1])
    crowd = Crowd(position, velocity, obs.pedestrians.radius, obs.pedestrians.seen)
    return Scene(vehicle, crowd, obs.obstacles, obs.dt)


def mean_future(scene: Scene) -> Scene:
    """Return the scene with a single future: the mean of the predicted positions, and the mean velocities."""
    position, velocity = (array.mean(axis=1, keepdims=True) for array in scene.crowd[:2])
    return dataclasses.replace(scene, crowd=scene.crowd._replace(position=position, velocity=velocity))


@no_type_check
@njit(nogil=True)
def motion_of(numbers, row):
    """Return the `Motion` in one row `[row, 6]`. Compiled."""
    x, y, vx, vy = numbers[row, 0], numbers[row, 1], numbers[row, 2], numbers[row, 3]
    return Motion(x, y, vx, vy, numbers[row, 4], numbers[row, 5])


@no_type_check
@njit(nogil=True, inline="always")
def fill_crowd(position, w, m, t, start, motion):
    """Fill in the start and the displacement of pedestrians in a step, in metres. Compiled.

    Args:
        position (array): `Crowd.position`.
        w (int): The world.
        m (int): The mode.
        t (int): The step.
        start (array): `[agent, 2]`, filled except for the vehicle, which comes first.
        motion (array): `[agent, 2]`, filled except for the vehicle.
    """
    # Element by element: reference counting of slices takes as long as all other operations.
    for p in range(position.shape[3]):
        for k in range(2):
            start[p + 1, k] = position[w, m, t, p, k]
            motion[p + 1, k] = position[w, m, t + 1, p, k] - position[w, m, t, p, k]
