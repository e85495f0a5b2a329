"""Bayesian Recursive Nash Equilibrium (BRNE): the vehicle and the people nearest to it negotiate the free space.

Each agent has a mixed strategy: trajectories sampled from a Gaussian process, and their weights. Bayesian updates
change the weights of one agent after the other by the expected risk of a collision with the others, until they are a
Nash equilibrium. The vehicle drives along the weighted mean of its trajectories.

Sun, Baldini, Hughes, Trautman and Murphey, "Mixed strategy Nash equilibrium for crowd navigation", International
Journal of Robotics Research, 2024, arXiv:2403.01537. The paper itself was not at hand. The formulas come from the
authors' code, MurpheyLab/brne on GitHub: `gaussian_process`, `risks` and `equilibrium` compute the same as
`get_Lmat_nb`, `costs_nb` and `brne_nav` of socnavbench/brne.py.

Differs from that code in that
- distances are relative to the sum of two radii, because agents have different sizes here;
- trajectories into walls have no weight (in brne_nav/brne_py: trajectories of the robot that leave a corridor), and the
  command goes along walls, because walls are left to another planner there;
- the samples of the vehicle are around its route, because walls may be in the straight way to the goal;
- the samples of a person are scaled by the person's speed, as in brne_nav/brne_py.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from crowdbench import InputError, Observation, along_route, along_walls, distance_to_walls
from crowdbench.planners import AheadPlanner

Points = Float[np.ndarray, "world point 2"]
Paths = Float[np.ndarray, "world agent sample time 2"]
Weights = Float[np.ndarray, "world agent sample"]
Risks = Float[np.ndarray, "world agent sample agent sample"]

USUAL = 0.6
"""Sum of two radii in metres for which the authors chose `zone`."""

BATCH = 2
"""Worlds whose risks are computed at once, few enough for them to stay in a core's cache."""


class Brne(AheadPlanner):
    """Drives along the weighted mean of sampled trajectories at the equilibrium; see `planner` for the parameters.

    Raises:
        InputError: A parameter is not above 0.
    """

    def __init__(
        self,
        samples: int,
        people: int,
        iterations: int,
        horizon: int,
        straightness: float,
        width: float,
        zone: float,
        penalty: float,
    ) -> None:
        numbers = {name: value for name, value in locals().items() if name != "self"}
        for name, value in numbers.items():
            if value <= 0:
                raise InputError(f"{name} is {value}, but must be above 0")
        self.samples, self.people, self.iterations, self.horizon = samples, people, iterations, horizon
        self.straightness, self.width, self.zone, self.penalty = straightness, width, zone, penalty

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """See `Planner`. After the horizon, the vehicle stands."""
        paths, radius, present = self._sample(obs)
        mean = np.empty((len(obs), self.horizon, 2))
        for start in range(0, len(obs), BATCH):
            part = slice(start, start + BATCH)
            free = is_free(paths[part], radius[part], obs.obstacles[part])
            risk = risks(paths[part], radius[part], present[part], self.zone, self.penalty)
            weight = equilibrium(risk, present[part], free, self.iterations)
            mean[part] = (weight[:, 0, :, None, None] * paths[part, 0]).mean(axis=1)
        ways = np.diff(np.concatenate([obs.vehicle.position[:, None], mean], axis=1), axis=1) / obs.dt
        length = np.linalg.norm(ways, axis=2, keepdims=True)
        ways *= np.minimum(obs.vehicle.preferred_speed[:, None, None] / np.maximum(length, 1e-9), 1.0)
        ways[:, 0] = along_walls(obs, ways[:, 0])
        obs.log("planned", mean[:, :, None])
        rest = np.zeros((len(obs), max(steps - self.horizon, 0), 2))
        return np.concatenate([ways, rest], axis=1)[:, :steps]

    def _sample(
        self, obs: Observation
    ) -> tuple[Paths, Float[np.ndarray, "world agent"], Bool[np.ndarray, "world agent"]]:
        """Return trajectories, radii and who is there, of the vehicle and of the people nearest to it."""
        position, velocity, radius, present = obs.everybody()
        away = np.where(present, np.linalg.norm(position - position[:, :1], axis=2), np.inf)
        away[:, 0] = -1.0
        order = np.argsort(away, axis=1, kind="stable")[:, : self.people + 1]
        position, velocity = (np.take_along_axis(each, order[..., None], axis=1) for each in (position, velocity))
        time = obs.dt * np.arange(1, self.horizon + 1)
        mean = position[:, :, None] + time[:, None] * velocity[:, :, None]
        mean[:, 0] = along_route(obs, obs.vehicle.preferred_speed[:, None] * time)
        factor = gaussian_process(time, self.straightness, self.width)
        shape = (position.shape[1], self.samples, self.horizon, 2)
        # The authors widen a person's samples by the speed in m/s: who stands is not expected to make room.
        scale = np.linalg.norm(velocity, axis=2)
        scale[:, 0] = 1.0
        deviation = np.matmul(factor, obs.noise("brne", shape)) * scale[:, :, None, None, None]
        chosen = (np.take_along_axis(each, order, axis=1) for each in (radius, present))
        return mean[:, :, None] + deviation, *chosen


def gaussian_process(
    time: Float[np.ndarray, "time"], straightness: float, width: float, noise: float = 1e-2
) -> Float[np.ndarray, "time time"]:
    """Return the factor L of the covariance L L^T of a coordinate along a trajectory that starts at a known point.

    A Gaussian process with the kernel k(s, t) = width exp(-straightness (s - t)^2), given its value at time 0.

    Args:
        time: In seconds.
        straightness: In 1/s^2.
        width: Variance far from the start, in m^2.
        noise: Variance of the value at time 0, in m^2.
    """
    prior = width * np.exp(-straightness * (time[:, None] - time) ** 2)
    start = width * np.exp(-straightness * time**2)
    covariance = prior - np.outer(start, start) / (width + noise)
    return np.linalg.cholesky(covariance + 1e-6 * np.eye(len(time)))


def risks(
    paths: Paths,
    radius: Float[np.ndarray, "world agent"],
    present: Bool[np.ndarray, "world agent"],
    zone: float,
    penalty: float,
) -> Risks:
    """Return the risk of each trajectory of an agent with each of another: 0 for its own, and for the absent.

    It is penalty max_t (2 - 2 / (1 + exp(-zone d_t^2))), with the distance d_t in units of the sum of both radii and of
    `USUAL`.

    Args:
        paths: Trajectories in metres.
        radius: In metres.
        present: True for agents that exist.
        zone: In 1/m^2.
        penalty: The risk at a distance of 0 [1].
    """
    worlds, agents, samples, steps, _ = paths.shape
    one, other = np.triu_indices(agents, 1)
    nearest = np.full((worlds, len(one), samples, samples), np.inf)
    for t in range(steps):
        x, y = np.moveaxis(paths[:, :, :, t], -1, 0)
        squared = (x[:, one, :, None] - x[:, other, None]) ** 2
        squared += (y[:, one, :, None] - y[:, other, None]) ** 2
        np.minimum(nearest, squared, out=nearest)
    scale = (USUAL / (radius[:, one] + radius[:, other])) ** 2
    nearest *= zone * scale[:, :, None, None]
    # 2 - 2 / (1 + exp(-z)) = 2 / (1 + exp(z)), which does not cancel where the risk is small.
    risk = 2.0 * penalty / (1.0 + np.exp(np.minimum(nearest, 700.0)))
    risk *= (present[:, one] & present[:, other])[:, :, None, None]
    table = np.zeros((worlds, agents, agents, samples, samples))
    table[:, one, other], table[:, other, one] = risk, risk.swapaxes(2, 3)
    return table.swapaxes(2, 3)


def equilibrium(risk: Risks, present: Bool[np.ndarray, "world agent"], free: Weights, iterations: int) -> Weights:
    """Return weights of mean 1 after some rounds of Bayesian updates, in each of which all agents have their turn.

    An agent's weights become free exp(-r), with r the expected risk: the mean over the others and over their samples,
    by their weights as they are at that moment.

    Args:
        risk: See `risks`.
        present: True for agents that exist.
        free: 1 for the trajectories that an agent can take, and 0 for the others.
        iterations: Number of rounds [1].
    """
    worlds, agents, samples = free.shape
    weight = free / np.maximum(free.mean(axis=2, keepdims=True), 1e-9)
    table = risk.reshape(worlds, agents, samples, agents * samples)
    others = np.maximum(present.sum(axis=1) - 1, 1)[:, None] * samples
    for _ in range(iterations):
        for i in range(agents):  # in turn: each one knows what those before it have changed
            expected = np.matmul(table[:, i], weight.reshape(worlds, -1, 1))[..., 0] / others
            # Relative to the smallest one, so that some weight stays above 0 whatever the penalty is.
            smallest = np.where(free[:, i] > 0.0, expected, np.inf).min(axis=1, keepdims=True)
            updated = free[:, i] * np.exp(np.minimum(smallest - expected, 0.0))
            weight[:, i] = updated / updated.mean(axis=1, keepdims=True)
    return weight


def is_free(
    paths: Paths, radius: Float[np.ndarray, "world agent"], obstacles: Float[np.ndarray, "world polygon corner 2"]
) -> Weights:
    """Return 1 for trajectories that keep their agent's radius to walls, and 0 for others; 1 for all if all hit walls.

    Args:
        paths: Trajectories in metres.
        radius: In metres.
        obstacles: Polygons in metres, NaN after the last corner.
    """
    worlds, agents, samples, steps, _ = paths.shape
    gap = distance_to_walls(paths.reshape(worlds, -1, 2), obstacles).reshape(worlds, agents, samples, steps)
    free: Bool[np.ndarray, "world agent sample"] = np.all(gap > radius[:, :, None, None], axis=3)
    return np.where(free.any(axis=2, keepdims=True), free, True).astype(float)


def planner(
    samples: int = 60,
    people: int = 4,
    iterations: int = 10,
    horizon: int = 19,
    straightness: float = 0.08,
    width: float = 1.0,
    zone: float = 8.0,
    penalty: float = 400.0,
) -> Brne:
    """Make the planner.

    Args:
        samples: Number of trajectories of each agent; the authors take 300 [1].
        people: Number of people, the nearest, who take part [1].
        iterations: Number of updates of all weights [1].
        horizon: Number of steps of a trajectory [1].
        straightness: Of the trajectories: how soon their deviation changes; the authors' `kernel_a1` [1/s^2].
        width: Variance of their deviation far from the start; the authors' `kernel_a2` [m^2].
        zone: How fast the risk falls with the squared distance; the authors' `cost_a1` [1/m^2].
        penalty: Risk of a contact; the authors' `cost_a3` [1].

    Returns:
        The planner.
    """
    return Brne(samples, people, iterations, horizon, straightness, width, zone, penalty)
