"""Goals of pedestrians, inferred online from where they head."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit, logit, ndtr

from crowdbench import InputError, Observation

from .geodesics import Geodesics, find_geodesics

Velocities = Float[np.ndarray, "world pedestrian 2"]

JUMP = 1.0
"""Somebody farther than this from where the same index was expected is another person, in metres."""

SLOW = 0.2
"""Speed in m/s below which a heading is no evidence."""

DEVIATION = 0.2
"""Standard deviation of the velocity of a person from the one that was foreseen, in m/s."""

NOTICES = 0.6
"""Time in s before which nobody has noticed a vehicle that has come into view, a visuomotor delay (Rio, Rhea and
Warren, "Follow the leader: visual control of speed in pedestrian following", Journal of Vision 14(2), 2014)."""

UNLIKELY = 2.0
"""By how much the logarithm of the weight of a candidate is smaller for each metre that it is too near [1/m]."""


@dataclasses.dataclass(frozen=True)
class Inference:
    """How goals are inferred.

    Attributes:
        concentration: Kappa of the von Mises distribution of headings around the way to the goal, per second [1/s].
        memory: Time in which evidence is forgotten to 1 / e [s].
        near: Candidates nearer than this are the less likely, the nearer they are: few people are about to stop [m].
        slowing: How fast the largest speed that was seen is forgotten [m/s^2].

    Raises:
        InputError: A number is impossible.
    """

    concentration: float = 12.0
    memory: float = 3.0
    near: float = 6.0
    slowing: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (value >= 0.0 and (value > 0.0 or name != "memory")):
                raise InputError(
                    f"{name} is {value}, but must be a number, {'above 0' if name == 'memory' else '0 or more'}"
                )


INFERENCE = Inference()


class GoalBelief:
    """The posterior of the goal of each pedestrian over candidates, and the largest speed at which each was seen.

    A heading theta at a place x is evidence for the candidate g by the von Mises likelihood
    exp(kappa cos(theta - phi(x, g))) / (2 pi I0(kappa)), where phi(x, g) is the direction of the shortest way to it.
    The logarithm of the posterior is that of a uniform prior plus the sum of this evidence. Evidence of t seconds ago
    is weighted by exp(-t / memory) (a power prior), because people leave their ways to avoid others.

    Args:
        inference: How goals are inferred.
        futures: Number of goals that are sampled of each pedestrian [1].
    """

    def __init__(self, inference: Inference, futures: int) -> None:
        self.inference, self.futures = inference, futures
        self.geodesics: Geodesics | None = None

    def reset(self) -> None:
        """Forget everybody."""
        self.geodesics = None

    def ways(self) -> Geodesics:
        """Return the candidates, and the ways to them; raises AssertionError before the first observation."""
        assert self.geodesics is not None
        return self.geodesics

    def update(self, obs: Observation) -> None:
        """Take an observation as evidence, once for each step."""
        geodesics = self.geodesics or self._start(obs)
        row, crowd, inference = self.index[obs.row], obs.pedestrians, self.inference
        if (obs.time <= self.time[row]).all():
            return
        elapsed = np.maximum(obs.time - self.time[row], 0.0)[:, None]
        speed = np.hypot(crowd.velocity[..., 0], crowd.velocity[..., 1])
        expected = self.last[row] + elapsed[..., None] * crowd.velocity
        is_new = ~(np.abs(crowd.position - expected).max(axis=2) < JUMP)
        kept = np.where(is_new, 0.0, np.exp(-elapsed / inference.memory))
        log = self.log[row] * kept[:, None]
        here = crowd.position[:, None]
        way = geodesics.ahead(row, here, np.arange(log.shape[1])[None, :, None]) - here
        length = np.hypot(way[..., 0], way[..., 1]) * speed[:, None]
        cosine = (way * crowd.velocity[:, None]).sum(axis=3) / np.maximum(length, 1e-9)
        measured = crowd.seen & (crowd.age <= obs.sensor.delay + 1e-6) & (speed > SLOW)
        kappa = np.where(measured, inference.concentration, 0.0)
        if crowd.deviation is not None:  # a heading is as uncertain as the velocity across it, over the speed
            kappa /= 1.0 + inference.concentration * (crowd.deviation[..., 1] / np.maximum(speed, SLOW)) ** 2
        self.since[row] = np.where(is_new, obs.time[:, None], self.since[row])
        self.log[row] = log + obs.dt * kappa[:, None] * cosine
        aware, blind = ((crowd.velocity - each) ** 2 for each in self.foreseen[:, row])
        variance = DEVIATION**2 + (0.0 if crowd.deviation is None else crowd.deviation[..., 1] ** 2)
        blinder = np.where(measured & ~is_new, np.nansum(aware - blind, axis=2), 0.0) / (2.0 * variance)
        self.blinder[row] = self.blinder[row] * kept + blinder
        fastest = np.where(is_new, 0.0, self.speed[row] - inference.slowing * elapsed)
        self.speed[row] = np.where(crowd.seen, np.maximum(fastest, speed), self.speed[row])
        self.last[row] = np.where(crowd.seen[..., None], crowd.position, np.nan)
        self.time[row] = obs.time

    def _start(self, obs: Observation) -> Geodesics:
        """Place candidates in the worlds of a batch, at their first observation."""
        crowd, vehicle = obs.pedestrians, obs.vehicle
        people = np.where(crowd.seen[..., None], crowd.position, np.nan)
        points = np.concatenate([vehicle.position[:, None], vehicle.goal[:, None], people], axis=1)
        self.geodesics = geodesics = find_geodesics(obs.obstacles, points)
        worlds, pedestrians = crowd.seen.shape
        self.index = np.zeros(obs.row.max() + 1, np.int64)
        self.index[obs.row] = np.arange(worlds)
        self.log = np.zeros((worlds, geodesics.goal.shape[1], pedestrians))
        self.speed, self.last = np.zeros((worlds, pedestrians)), np.full((worlds, pedestrians, 2), np.nan)
        self.blinder, self.since = np.zeros((worlds, pedestrians)), np.full((worlds, pedestrians), np.inf)
        self.foreseen = np.full((2, worlds, pedestrians, 2), np.nan)
        self.time = obs.time - obs.dt
        # The same in a whole episode, so that goals that are sampled change with the posterior alone.
        noise = obs.noise("goals", (pedestrians, self.futures + 1))
        stratum = noise[..., 1:].argsort(axis=2)
        self.quantile = ((stratum + ndtr(noise[..., :1])) / self.futures).swapaxes(1, 2)
        self.order = obs.noise("ignores", (pedestrians, self.futures)).argsort(axis=2).swapaxes(1, 2)
        return geodesics

    def posterior(self, obs: Observation) -> Float[np.ndarray, "world goal pedestrian"]:
        """Return the probability of each candidate."""
        row, geodesics = self.index[obs.row], self.ways()
        away = geodesics.goal[row][:, :, None] - obs.pedestrians.position[:, None]
        log = self.log[row] - UNLIKELY * np.maximum(self.inference.near - np.hypot(away[..., 0], away[..., 1]), 0.0)
        log = np.where(geodesics.exists[row][..., None], log, -np.inf)
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        return weight / weight.cumsum(axis=1)[:, -1:]  # a cumulative sum has the same bits with any padding

    def sample(self, obs: Observation) -> Int[np.ndarray, "world mode pedestrian"]:
        """Return a goal of each pedestrian in each future: indices of candidates, stratified over the posterior."""
        below = self.posterior(obs).cumsum(axis=1)
        quantile = np.minimum(self.quantile[self.index[obs.row]], 1.0 - 1e-9)[:, :, None]
        return np.asarray((below[:, None] <= quantile * below[:, None, -1:]).sum(axis=2))

    def ignores(self, obs: Observation, share: float) -> Bool[np.ndarray, "world mode pedestrian"]:
        """Return who ignores the vehicle in which future.

        Each person does so in a share of the futures, rounded up: the posterior of two hypotheses, that it avoids the
        vehicle and that it ignores it. The evidence is how much better its velocities were foreseen by one of them.
        Somebody who has just come into view ignores it with a prior probability of a half at least, unless nobody does.

        Args:
            obs: The observation.
            share: The prior probability that a person ignores the vehicle.
        """
        row = self.index[obs.row]
        unaware = (obs.time[:, None] - self.since[row] < NOTICES) & (share > 0.0)
        probability = expit(logit(np.where(unaware, max(share, 0.5), share)) + self.blinder[row])
        return np.asarray(self.order[row] < np.ceil(probability * self.futures)[:, None])

    def foresee(self, obs: Observation, aware: Velocities, blind: Velocities) -> None:
        """Keep the velocities in m/s that people will have in the next step if they avoid or ignore the vehicle."""
        self.foreseen[:, self.index[obs.row]] = aware, blind
