"""MPPI among people who walk by ORCA among walls, towards goals that are inferred from where they head.

At each decision, in each world:

1. The posterior of the goal of each person is updated (`goal_belief`): candidates on a grid, the von Mises likelihood
   of the heading around the shortest way to each, with forgetting.
2. Futures are foreseen: in each one every person has a goal that is sampled from the posterior, and walks there
   around walls by ORCA (van den Berg et al., "Reciprocal n-body collision avoidance", 2011), at the largest speed at
   which it was seen lately. Each person ignores the vehicle in some futures, drawn for each, and avoids it, as it last
   planned, in the others: the more it has walked as if it ignored it, the more of them.
3. Sequences of commands are sampled as `mppi` does (Williams et al., "Information theoretic MPC for model-based
   reinforcement learning", ICRA 2017). A sequence costs the mean of the costs in the worst futures for it, the
   conditional value at risk (Rockafellar and Uryasev, "Optimization of conditional value-at-risk", 2000).

The planner has no knowledge of goals, of policies and of who has noticed the vehicle.

Sources of the inference: Mardia and Jupp, "Directional Statistics", 2000 (the von Mises distribution, section 3.5.4);
Ibrahim and Chen, "Power prior distributions for regression models", Statistical Science 15(1), 2000 (forgetting).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from crowdbench import ORCA, InputError, MPPIPlanner, Observation, Prediction, Predictor
from crowdbench.planners import RadiusInflation, radius_inflation

from .goal_belief import INFERENCE, GoalBelief, Inference
from .roll_out import roll_out

Positions = Float[np.ndarray, "world mode pedestrian 2"]

KEEP = 0.75
"""Time in which people turn from where they head now to their goals: the difference falls to 1 / e [s]."""

SLOWEST = 0.5
"""Smallest speed in m/s at which people are assumed to walk, who may only wait now."""

PARAMETERS = {"line_of_sight": 1.0}
"""Parameters of ORCA that are not CrowdNav's: people do not avoid those who are behind walls."""

LIMITS = 1.5, 3.0, 2.0
"""Largest acceleration, braking and sideways acceleration of people in m/s^2: of the size of gait initiation and rapid
stops of young adults."""


COSTS = dataclasses.replace(MPPIPlanner.weights, fading=0.75)
"""Contacts fade less than in `mppi`, whose prediction is less certain."""


class GoalRollOuts(Predictor):
    """Foresees people who walk by ORCA towards goals that it infers.

    Args:
        inference: How goals are inferred.
        futures: Number of futures [1].
        ignoring: The prior probability that a person ignores the vehicle [1].
    """

    def __init__(self, inference: Inference, futures: int, ignoring: float) -> None:
        self.ignoring, self.belief = ignoring, GoalBelief(inference, futures)

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`: the vehicle stands."""
        return self.predict_given(obs, steps, np.zeros((len(obs), steps, 2)))

    def predict_given(self, obs: Observation, steps: int, plan: Float[np.ndarray, "world time 2"]) -> Prediction:
        """See `Predictor`."""
        self.belief.update(obs)
        goal = self.belief.sample(obs)
        blind = self._walk(obs, goal, steps, None)
        if self.ignoring == 1.0:
            return blind
        aware = self._walk(obs, goal, steps, plan)
        ignores = self.belief.ignores(obs, self.ignoring)[:, :, None, :, None]
        self.belief.foresee(obs, *(each.velocity[:, :, 0].mean(axis=1) for each in (aware, blind)))
        pairs = (blind.position, aware.position), (blind.velocity, aware.velocity)
        return Prediction(*(np.where(ignores, *pair) for pair in pairs))

    def _walk(
        self,
        obs: Observation,
        goal: Int[np.ndarray, "world mode pedestrian"],
        steps: int,
        plan: Float[np.ndarray, "world time 2"] | None,
    ) -> Prediction:
        """Return futures towards goals. People see the vehicle where its plan is given."""
        geodesics, row = self.belief.ways(), self.belief.index[obs.row]
        speed = np.broadcast_to(np.maximum(self.belief.speed[row], SLOWEST)[:, None], goal.shape)
        now, step = obs.pedestrians.velocity[:, None], itertools.count()

        def ahead(position: Positions) -> Positions:
            way = geodesics.ahead(row, position, goal) - position
            toward = way * (speed / np.maximum(np.hypot(way[..., 0], way[..., 1]), speed))[..., None]
            kept = np.exp(-next(step) * obs.dt / KEEP)
            return position + kept * now + (1.0 - kept) * toward  # a point is approached at its distance per second

        return roll_out(ORCA(), obs, ahead, speed, steps, plan=plan, parameters=PARAMETERS, limits=LIMITS)


class InteractiveMPPI(MPPIPlanner):
    """`MPPIPlanner` whose predictor has a memory of each episode."""

    predictor: GoalRollOuts

    def halo(self, obs: Observation) -> RadiusInflation:
        """See `MPPIPlanner`: the futures differ by goals, so that only an error of the present motion is left."""
        return radius_inflation(obs, self.horizon, self.weights.sigma_factor, KEEP)

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        super().reset(rows)
        self.predictor.belief.reset()


def planner(
    futures: int = 6,
    ignoring: float = 0.15,
    worst: float = 0.75,
    horizon: int = 18,
    samples: int = 100,
    inference: Inference = INFERENCE,
    weights: Mapping[str, float] | None = None,
) -> InteractiveMPPI:
    """Make the planner.

    Args:
        futures: Number of futures [1].
        ignoring: The prior probability that a person ignores the vehicle [1].
        worst: The share of the futures, the worst for a sequence, of which the mean counts (CVaR); 1 for all [1].
        horizon: Number of steps of a sequence [1].
        samples: Number of sequences that are sampled in a round [1].
        inference: How goals are inferred.
        weights: Costs of a sequence that differ from `COSTS`, as a table.

    Returns:
        The planner.

    Raises:
        InputError: A number is impossible.
    """
    if not (futures >= 1 and 0.0 <= ignoring <= 1.0):
        right = "futures must be 1 or more, and ignoring from 0 to 1"
        raise InputError(f"futures is {futures} and ignoring is {ignoring}, but {right}")
    predictor = GoalRollOuts(inference, futures, ignoring)
    costs = dataclasses.replace(COSTS, **(weights or {}))
    search = dataclasses.replace(MPPIPlanner.search, samples=samples)
    return InteractiveMPPI(predictor, search, costs, horizon, worst)
