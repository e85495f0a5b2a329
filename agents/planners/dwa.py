"""The dynamic window approach among pedestrians who move on at constant velocity.

Fox et al., "The dynamic window approach to collision avoidance", IEEE Robotics & Automation Magazine 4(1), 1997.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from crowdbench import Observation, Outcome, load_predictor
from crowdbench.core import norm
from crowdbench.planners import (
    Commands,
    PredictingPlanner,
    radius_inflation,
    scene_of,
    time_left,
    try_sequences,
)
from crowdbench.predict import predict
from crowdbench.utils import require, require_count, require_not_negative


@dataclasses.dataclass(frozen=True)
class Objective:
    """Objective of a command: a weighted sum of numbers up to 1 (Fox et al. 1997).

    Attributes:
        heading: Weight of how much nearer the goal is at the end of the horizon, as part of what can be [1].
        clearance: Weight of the time until it would touch somebody or something, as part of the horizon [1].
        room: Weight of the smallest gap to people until then, as part of `free` [1].
        speed: Weight of the speed, as part of the preferred one [1].
        free: A gap beyond which more room is not better [m].
        margin: Enlargement of people's radii [m].
        sigma_factor: Standard deviations of future positions by which a filter enlarges people's radii [1].

    Raises:
        InputError: A number is impossible.
    """

    heading: float = 1.0
    clearance: float = 12.0
    room: float = 1.7
    speed: float = 0.1
    free: float = 1.0
    margin: float = 0.09
    sigma_factor: float = 0.27

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require_not_negative(name, value)
        require("free", self.free, self.free > 0.0, "above 0")


OBJECTIVE = Objective()


@dataclasses.dataclass(eq=False)
class DWAPlanner(PredictingPlanner):
    """Takes the best of the commands that the vehicle can reach in a step and could keep.

    People move on as predicted. A command is admissible where the vehicle, if it keeps it for a step, can still stop
    before it would touch somebody or a wall. Where no command is, it brakes as hard as it can.

    Attributes:
        objective: The objective.
        horizon: Number of steps for which a command is kept [1].

    Raises:
        InputError: `horizon` is not a whole number above 0.
    """

    objective: Objective = OBJECTIVE
    horizon: int = 14

    def __post_init__(self) -> None:
        super().__post_init__()
        require_count("horizon", self.horizon)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        vehicle = obs.vehicle
        window = vehicle.dynamics.commands(vehicle.state, vehicle.preferred_speed, obs.dt)
        rated = self.rate(obs, window)
        best = window[np.arange(len(obs)), rated.argmax(axis=1)]
        brake = vehicle.dynamics.follow(vehicle.state, np.zeros_like(best), vehicle.preferred_speed, obs.dt)
        return np.where(np.isfinite(rated).any(axis=1)[:, None], best, brake)

    def rate(self, obs: Observation, window: Commands) -> Float[np.ndarray, "world action"]:
        """Return how good each command is; minus infinity where it is not admissible."""
        prediction = predict(self.predictor, obs, self.horizon)
        scene, objective = scene_of(obs, prediction, 0, obs.vehicle, self.horizon), self.objective
        inflation = objective.margin + radius_inflation(obs, self.horizon, objective.sigma_factor)
        sequences = np.repeat(window[:, :, None], self.horizon, axis=2)
        result = try_sequences(scene, sequences, inflation)
        # Over several futures, the worst.
        steps, gap = result.steps.min(axis=2), result.gap.min(axis=(2, 3))
        collides = ((result.outcome == Outcome.COLLISION) | (result.outcome == Outcome.WALL_COLLISION)).any(axis=2)
        speed = norm(result.motion[:, :, 1, 2:4])
        stops = np.ceil(speed / (obs.vehicle.dynamics.limits[0] * obs.dt))  # all have max_acceleration first
        admissible = ~collides | (steps > 1 + stops)
        arrives = (result.outcome == Outcome.SUCCESS).all(axis=2)
        left = np.where(arrives, 0.0, time_left(scene, result))
        now = norm(obs.vehicle.local_goal - obs.vehicle.position)[:, None] / obs.vehicle.preferred_speed[:, None]
        nearer = (now - left) / (self.horizon * obs.dt)
        clear = np.where(collides, (steps - 1) / self.horizon, 1.0)
        goodness = objective.heading * nearer + objective.clearance * clear
        goodness += objective.room * np.clip(gap / objective.free, 0.0, 1.0)
        goodness += objective.speed * speed / obs.vehicle.preferred_speed[:, None]
        return np.where(admissible, goodness, -np.inf)


def planner(predictor: str = "constant_velocity", objective: Objective = OBJECTIVE, horizon: int = 14) -> DWAPlanner:
    """Make the planner.

    Args:
        predictor: Predictor of the pedestrians: a name (`crowdbench list predictors`) or a file.
        objective: The objective.
        horizon: Number of steps for which a command is kept [1].

    Returns:
        The planner.
    """
    return DWAPlanner(load_predictor(predictor), objective, horizon)
