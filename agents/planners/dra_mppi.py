"""Dynamic Risk-Aware MPPI (DRA-MPPI): sampled sequences of commands, rejected where a collision is too probable.

Trevisan, Mustafa, Notten, Wang and Alonso-Mora, "Dynamic risk-aware MPPI for mobile robots in crowds via efficient
Monte Carlo approximations", IROS 2025, arXiv:2506.21205.

From the paper are the mixture of Gaussians of each person (section III-A), the joint probability of a collision (III-D)
and its approximation for all samples at once (IV-A), the cost omega_soft P + omega_hard 1(P > sigma) in each step
(IV-B), splines through a Halton sequence, the adapted temperature, the sample that brakes and the shifted last plan
(IV-C), a horizon of 4 s and people's noise of 0.3 m/s (V).

The displayed equations of the paper were not at hand. The joint probability is that of its text and of a published
review of it, one minus the product over people of the probability of no contact. Costs other than the risk are ours.

Differs from the paper in that
- sigma is 0.17 and not 0.05 (V), chosen with the weights of the costs on validation cases (`studies/tuning.py`);
- the modes are futures of Social GAN, around which the variance grows with time as that of the paper's pedestrians;
- the points of the approximation are a lattice with a random offset, whose points in a circle are quickly found, and
  2000 instead of 20000;
- the temperature is solved for in each decision, not adapted from one decision to the next;
- the terms of tracking and speed are relative to a point that moves along the route at the preferred speed, in place of
  a corridor's centreline, and changes of the velocity cost in place of the turn rate, which a holonomic vehicle lacks;
- a collision with a wall costs, because the paper has no walls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import make_interp_spline
from scipy.special import ndtri
from scipy.stats import qmc

from crowdbench import InputError, Observation, along_route, distance_to_walls, load_predictor
from crowdbench.planners import AheadPlanner, LastPlans, PredictingPlanner

Sequences = Float[np.ndarray, "world sample time 2"]
Probabilities = Float[np.ndarray, "world sample"]
Points = Float[np.ndarray, "world point 2"]

KNOTS = 5
"""Points of a Halton sequence through which the spline of a sample goes."""

BATCH = 2
"""Worlds that are planned for at once."""

WALL = 1e4
"""Cost of a collision with a wall."""

ROUNDING = 0.05
"""By how much a vehicle is nearer to a corner within a step than at its ends, in metres, and a little more."""


@dataclass(eq=False)
class DraMppi(PredictingPlanner, AheadPlanner):
    """Drives the weighted mean of sampled sequences; see `planner` for the attributes.

    Raises:
        InputError: A number is impossible.
    """

    samples: int
    horizon: int
    points: int
    threshold: float
    soft: float
    hard: float
    speed: float
    change: float
    spread: float
    noise: float
    effective: float

    def __post_init__(self) -> None:
        super().__post_init__()
        least = {"samples": 3, "horizon": 1, "points": 4, "effective": 1.01, "threshold": 1e-6, "noise": 1e-6}
        for name, value in least.items():
            if getattr(self, name) < value:
                raise InputError(f"{name} is {getattr(self, name)}, but must be {value:g} or more")
        self.deviation = self.spread * halton_splines(self.samples, self.horizon)
        self.last = LastPlans(self.horizon)

    def reset(self, rows: np.ndarray) -> None:
        """See `Planner`."""
        self.last.reset(rows)

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """See `Planner`. After the horizon, the last command is kept."""
        futures = self.predictor.predict(obs, self.horizon).position
        last = self.last.remaining(obs, np.zeros((len(obs), self.horizon, 2)))
        best = np.empty_like(last)
        for w in range(0, len(obs), BATCH):
            part = slice(w, w + BATCH)
            best[part] = self._search(obs.take(part), futures[part], last[part])
        self.last.store(obs, best)
        obs.log("predicted", futures)
        return best[:, np.minimum(np.arange(steps), self.horizon - 1)]

    def _search(
        self, obs: Observation, futures: np.ndarray, last: Float[np.ndarray, "world time 2"]
    ) -> Float[np.ndarray, "world time 2"]:
        """Return the mean of the samples, with the weights exp(-(S - min S) / temperature) (section III-C)."""
        high = obs.vehicle.dynamics.space(obs.vehicle.preferred_speed)[1]
        commands = limited(obs, last[:, None] + high[:, None, None] * self.deviation)
        commands[:, 0], commands[:, 1] = last, 0.0
        cost = self.costs(obs, futures, commands)
        excess = cost - cost.min(axis=1, keepdims=True)
        weight = np.exp(-excess / temperature(excess, self.effective))
        mean = (weight[..., None, None] * commands).sum(axis=1) / weight.sum(axis=1)[:, None, None]
        return limited(obs, mean[:, None])[:, 0]

    def costs(self, obs: Observation, futures: np.ndarray, commands: Sequences) -> Probabilities:
        """Return the cost of each sequence, summed over its steps up to the goal.

        Args:
            obs: The present.
            futures: Positions of people in metres, `[world, mode, time, pedestrian, 2]`.
            commands: Commands of the vehicle's dynamics.
        """
        vehicle, dt = obs.vehicle, obs.dt
        worlds, samples, steps, _ = commands.shape
        speed, radius = vehicle.preferred_speed[:, None], vehicle.radius[:, None]
        tolerance = vehicle.goal_tolerance or radius
        people = np.where(obs.pedestrians.seen, obs.pedestrians.radius, 0.0).max(axis=1, initial=0.0)
        sigma = np.sqrt(np.arange(1, steps + 1)[:, None] * (self.noise * dt) ** 2 + _variance(obs, steps))
        reference = along_route(obs, speed * dt * np.arange(1, steps + 1))
        offset = obs.noise("dra_mppi", (steps, 2)) % 1.0
        state = type(vehicle.state)(*(np.repeat(each[:, None], samples, axis=1) for each in vehicle.state))
        total, running, crashed = np.zeros((worlds, samples)), np.ones((worlds, samples)), np.zeros((worlds, samples))
        for t in range(steps):
            before = state
            state = vehicle.dynamics.step(before, commands[:, :, t], np.repeat(speed, samples, axis=1), dt)
            risk = np.zeros((worlds, samples))
            for disc in vehicle.body:
                facing = np.stack([np.cos(state.heading), np.sin(state.heading)], axis=-1)
                centre = state.position + disc * facing if disc else state.position
                crowd = futures[:, :, t], sigma[:, t], obs.pedestrians.seen
                probable = collision_probability(centre, radius[:, 0] + people, *crowd, offset[:, t], self.points)
                risk = np.maximum(risk, probable)
                crashed = np.maximum(crashed, distance_to_walls(centre, obs.obstacles) < radius + ROUNDING)
            step = np.linalg.norm(state.position - reference[:, None, t], axis=2)
            step += self.speed * ((np.linalg.norm(state.velocity, axis=2) - speed) / speed) ** 2
            step += self.change * (((state.velocity - before.velocity) / speed[..., None]) ** 2).sum(axis=2)
            step += self.soft * risk + self.hard * (risk > self.threshold) + WALL * crashed
            total += running * step
            running *= np.linalg.norm(state.position - vehicle.goal[:, None], axis=2) >= tolerance
        return total


def _variance(obs: Observation, steps: int) -> Float[np.ndarray, "world #time #pedestrian"]:
    """Return the variance of people's positions that a filter estimates, in m^2; 0 without one."""
    if obs.pedestrians.deviation is None:
        return np.zeros((len(obs), 1, 1))
    position, velocity = np.moveaxis(obs.pedestrians.deviation[:, None], -1, 0)
    return position**2 + (obs.dt * np.arange(1, steps + 1)[:, None] * velocity) ** 2


def collision_probability(
    centre: Points,
    radius: Float[np.ndarray, "world"],
    mean: Float[np.ndarray, "world mode pedestrian 2"],
    sigma: Float[np.ndarray, "world #pedestrian"],
    present: Bool[np.ndarray, "world pedestrian"],
    offset: Float[np.ndarray, "world 2"],
    points: int,
) -> Probabilities:
    """Return the probability that somebody is in the circle around each vehicle's centre, for one step.

    The joint density 1 - prod_o (1 - p_o(x, y)) is computed at `points` points of the rectangle around all circles. Its
    mean over the points in a circle, times the area pi r^2, approximates its integral (sections III-D and IV-A).

    Args:
        centre: In metres.
        radius: Of the circles: that of the vehicle and that of a person, in metres.
        mean: Of the Gaussians of which a person's density is the mean, in metres.
        sigma: Their standard deviation in metres.
        present: True for agents that exist.
        offset: Of the lattice of points, in parts of its spacing.
        points: Number of points, about [1].
    """
    grid = int(np.sqrt(points))
    low, high = centre.min(axis=1) - radius[:, None], centre.max(axis=1) + radius[:, None]
    spacing = (high - low) / grid
    lattice = low[:, None] + spacing[:, None] * (np.arange(grid)[:, None] + offset[:, None])
    scale = sigma[:, :, None, None, None]
    away = ((lattice.swapaxes(1, 2)[:, None, None] - mean.swapaxes(1, 2)[..., None]) / scale).astype(np.float32)
    density = np.exp(-0.5 * away * away) / (np.sqrt(2.0 * np.pi) * scale).astype(np.float32)
    density[..., 0, :] *= (present / mean.shape[1])[:, :, None, None]
    x, y = density[..., 0, :], density[..., 1, :]
    nobody = np.subtract(1.0, np.matmul(x.swapaxes(2, 3), y), dtype=np.float32)
    joint = 1.0 - np.multiply.reduce(nobody, axis=1)
    # Sums along y up to each point: the sum over a column of a circle is a difference of two.
    below = np.concatenate([np.zeros((*joint.shape[:2], 1)), joint.cumsum(axis=2, dtype=float)], axis=2)
    half = radius[:, None, None] ** 2 - (centre[:, :, :1] - lattice[:, None, :, 0]) ** 2
    reach = np.sqrt(np.maximum(half, 0.0)) / spacing[:, None, 1:]
    middle = (centre[:, :, 1:] - lattice[:, None, :1, 1]) / spacing[:, None, 1:]
    first = np.clip(np.ceil(middle - reach), 0, grid).astype(int)
    end = np.clip(np.floor(middle + reach) + 1, first, grid).astype(int)
    end = np.where(half > 0.0, end, first)
    row = np.arange(grid) * (grid + 1)
    flat = below.reshape(len(below), 1, -1)
    above, under = (np.take_along_axis(flat, (row + index).reshape(len(flat), 1, -1), axis=2) for index in (end, first))
    total = (above - under).reshape(half.shape).sum(axis=2)
    area = np.pi * radius[:, None] ** 2
    return np.clip(area * total / np.maximum((end - first).sum(axis=2), 1), 0.0, 1.0)


def halton_splines(samples: int, steps: int) -> Float[np.ndarray, "sample time 2"]:
    """Return cubic splines through normally distributed knots from a Halton sequence, with a deviation of about 1."""
    sequence = qmc.Halton(2 * KNOTS, scramble=True, rng=np.random.default_rng(0)).random(samples)
    knots = ndtri(np.clip(sequence, 1e-6, 1.0 - 1e-6)).reshape(samples, KNOTS, 2)
    return make_interp_spline(np.linspace(0.0, 1.0, KNOTS), knots, k=3, axis=1)(np.linspace(0.0, 1.0, steps))


def temperature(excess: Probabilities, effective: float) -> Probabilities:
    """Return the temperature at which the weights exp(-excess / temperature) sum up to `effective`.

    Args:
        excess: Costs, less the smallest one of each world.
        effective: Above 1.
    """
    low, high = np.full((len(excess), 1), 1e-6), np.full((len(excess), 1), 1e6)
    for _ in range(40):
        middle = np.sqrt(low * high)
        many = np.exp(-excess / middle).sum(axis=1, keepdims=True) > effective
        low, high = np.where(many, low, middle), np.where(many, middle, high)
    return high


def limited(obs: Observation, commands: Sequences) -> Sequences:
    """Return the commands within the limits of the vehicle's dynamics."""
    speed = obs.vehicle.preferred_speed
    low, high = (each[:, None, None] for each in obs.vehicle.dynamics.space(speed))
    commands = np.clip(commands, low, high)
    if obs.vehicle.dynamics.name == "holonomic":
        size = np.linalg.norm(commands, axis=3, keepdims=True)
        commands *= np.minimum(speed[:, None, None, None] / np.maximum(size, 1e-9), 1.0)
    return commands


def planner(
    predictor: str = "sgan",
    samples: int = 200,
    horizon: int = 16,
    points: int = 2000,
    threshold: float = 0.17,
    soft: float = 47.0,
    hard: float = 375.0,
    speed: float = 0.24,
    change: float = 1.18,
    spread: float = 0.42,
    noise: float = 0.3,
    effective: float = 1.5,
) -> DraMppi:
    """Make the planner.

    Args:
        predictor: Predictor of the modes of people's motion: a name (`crowdbench list predictors`) or a file.
        samples: Number of sequences of commands, the paper's K, which is 400 there [1].
        horizon: Number of steps of a sequence, the paper's T [1].
        points: Number of points at which the density of people is computed in each step, the paper's N_mc [1].
        threshold: Probability of a collision in a step above which a sample is rejected, the paper's sigma [1].
        soft: Cost of a probability of 1, the paper's omega_soft, relative to 1 m off the reference in a step [1].
        hard: Cost of a probability above the threshold, the paper's omega_hard [1].
        speed: Cost of the squared difference from the preferred speed, in parts of it [1].
        change: Cost of the squared change of the velocity in a step, in parts of the preferred speed [1].
        spread: Standard deviation of the samples, in parts of the range of commands [1].
        noise: Standard deviation of people's velocities in each step [m/s].
        effective: Sum of the samples' weights, the best one's being 1, to which the temperature is adapted [1].

    Returns:
        The planner.
    """
    chosen = load_predictor(predictor)
    return DraMppi(chosen, samples, horizon, points, threshold, soft, hard, speed, change, spread, noise, effective)
