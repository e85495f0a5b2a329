"""Model predictive control among pedestrians who move on at constant velocity, solved by IPOPT.

Andersson et al., "CasADi: a software framework for nonlinear optimization and optimal control", Mathematical
Programming Computation 11, 2019. Wächter and Biegler, "On the implementation of an interior-point filter line-search
algorithm for large-scale nonlinear programming", Mathematical Programming 106, 2006.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from crowdbench import Observation, Outcome, Prediction, load_predictor
from crowdbench.core import norm
from crowdbench.planners import (
    AheadPlanner,
    LastPlans,
    PredictingPlanner,
    RadiusInflation,
    Sequence,
    limit_commands,
    radius_inflation,
    scene_of,
    time_left,
    try_sequences,
)
from crowdbench.predict import predict
from crowdbench.utils import require_count

from .mpc_program import PEOPLE, TERMS, WALLS, Terms, build_program, import_casadi

LOST = 10.0
"""Seconds that a guess is worse for each step by which it ends earlier in a collision."""

FAR = 1e3
"""Position in metres of absent people in the arrays of a program."""


def planner(
    predictor: str = "constant_velocity", terms: Terms = TERMS, horizon: int = 14, iterations: int = 80
) -> MPCPlanner:
    """Make the planner. It needs CasADi: pip install 'crowdbench[mpc]'.

    Args:
        predictor: Predictor of the pedestrians: a name (`crowdbench list predictors`) or a file.
        terms: Weights of a program.
        horizon: Number of steps [1].
        iterations: Of IPOPT, at most [1].

    Returns:
        The planner.
    """
    return MPCPlanner(load_predictor(predictor), terms, horizon, iterations)


@dataclasses.dataclass(eq=False)
class MPCPlanner(PredictingPlanner, AheadPlanner):
    """Drives the first command of the sequence that a program finds best among people who move on as predicted.

    The distance to the local goal over all steps is made small. Distances to people and obstacles are constraints with
    slack, so that there always is a solution. Where IPOPT does not converge within `iterations`, its last commands are
    driven, and the vehicle brakes where they are no numbers.

    It decides for one world after the other.

    Attributes:
        predictor: Of several futures the first one counts.
        terms: Weights of a program.
        horizon: Number of steps [1].
        iterations: Of IPOPT, at most [1].

    Raises:
        InputError: A number is impossible, or CasADi is not installed.
    """

    terms: Terms = TERMS
    horizon: int = 14
    iterations: int = 80

    def __post_init__(self) -> None:
        super().__post_init__()
        require_count("horizon", self.horizon)
        require_count("iterations", self.iterations)
        import_casadi()
        self.last = LastPlans(self.horizon)

    def reset(self, rows: np.ndarray) -> None:
        """See `Planner`."""
        self.last.reset(rows)

    def plan_ahead(self, obs: Observation, steps: int) -> Sequence:
        """See `Planner`."""
        self.last.check_length(steps)
        prediction = predict(self.predictor, obs, self.horizon)
        vehicle, crowd = obs.vehicle, obs.pedestrians
        program = build_program(vehicle.dynamics, vehicle.body, obs.dt, self.horizon, self.terms, self.iterations)
        inflation = radius_inflation(obs, self.horizon, self.terms.sigma_factor)
        inflation = np.broadcast_to(inflation, (len(obs), self.horizon, crowd.radius.shape[1]))
        guesses = self._guess(obs, prediction, inflation)
        brake = vehicle.dynamics.follow(vehicle.state, np.zeros((len(obs), 2)), vehicle.preferred_speed, obs.dt)
        bounds = vehicle.dynamics.space(vehicle.preferred_speed)
        commands = np.empty((len(obs), self.horizon, 2))
        for w in range(len(obs)):
            situation = _situation(obs, prediction.position[w, 0], inflation[w], w)
            found = program.run(guesses[w], (bounds[0][w], bounds[1][w]), situation)
            commands[w] = np.where(np.isfinite(found).all(), found, brake[w])
        commands = limit_commands(commands[:, None], vehicle)[:, 0]
        self.last.store(obs, commands)
        if obs.logs is not None:
            obs.log("predicted", prediction.position)
        return commands[:, :steps]

    def _guess(self, obs: Observation, prediction: Prediction, inflation: RadiusInflation) -> Sequence:
        """Return the initial guess of a program: the rest of the last solution or one command throughout.

        Of these it is the one that touches nobody for longest, and of several that which leads nearest to the goal:
        from a guess that goes through somebody, IPOPT finds no way around.
        """
        guesses = self.last.guesses(obs, np.zeros((len(obs), self.horizon, 2)))
        scene = scene_of(obs, prediction, 0, obs.vehicle, self.horizon)
        result = try_sequences(scene, guesses, inflation + self.terms.margin)
        arrives = result.outcome[:, :, 0] == Outcome.SUCCESS
        left = np.where(arrives, 0.0, time_left(scene, result))
        lost = np.where(arrives, 0.0, (self.horizon - result.steps[:, :, 0]) * LOST)
        return guesses[np.arange(len(obs)), (lost + left).argmin(axis=1)]


def _situation(
    obs: Observation,
    ahead: Float[np.ndarray, "time pedestrian 2"],
    inflation: Float[np.ndarray, "time pedestrian"],
    w: int,
) -> Float[np.ndarray, "number"]:
    """Return the parameters of a program: vehicle, goal, people in each step, edges of obstacles."""
    vehicle, crowd = obs.vehicle, obs.pedestrians
    now = [*vehicle.position[w], *vehicle.velocity[w], vehicle.heading[w], vehicle.angular_speed[w]]
    own = [*vehicle.local_goal[w], vehicle.radius[w], vehicle.preferred_speed[w]]
    steps = len(ahead)
    people = np.full((steps, PEOPLE, 3), FAR)
    nearest = np.argsort(np.where(crowd.seen[w], norm(crowd.position[w] - vehicle.position[w]), np.inf), kind="stable")
    nearest = nearest[: min(PEOPLE, int(crowd.seen[w].sum()))]
    people[:, : len(nearest), :2] = ahead[:, nearest]
    people[:, : len(nearest), 2] = crowd.radius[w, nearest] + inflation[:, nearest]
    people[:, len(nearest) :, 2] = 0.0
    return np.concatenate([now, own, people.ravel(), _edges(obs.obstacles[w], vehicle.position[w]).ravel()])


def _edges(obstacles: Float[np.ndarray, "polygon corner 2"], position: Float[np.ndarray, "2"]) -> np.ndarray:
    """Return the nearest edges of obstacles, `[WALLS, 4]`: the two ends of each in metres."""
    found = []
    for polygon in obstacles:
        corners = polygon[~np.isnan(polygon[:, 0])]
        ends = np.roll(corners, -1, axis=0)
        found += [np.append(*pair) for pair in zip(corners, ends, strict=True)][: len(corners) - (len(corners) == 2)]
    edges = np.full((WALLS, 4), FAR)
    edges[:, 2] += 1.0
    if found:
        all_edges = np.array(found)
        a, b = all_edges[:, :2], all_edges[:, 2:]
        along = b - a
        share = ((position - a) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
        away = norm(a + np.clip(share, 0.0, 1.0)[:, None] * along - position)
        order = np.argsort(away, kind="stable")[:WALLS]
        edges[: len(order)] = all_edges[order]
    return edges
