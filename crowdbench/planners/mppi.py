"""Model predictive path integral control (MPPI): sampled sequences of commands, weighted by their costs."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from crowdbench.core.dynamics import Holonomic
from crowdbench.core.geometry import toward_goal
from crowdbench.core.types import Observation, Outcome
from crowdbench.networks.chunks import CHUNK, in_chunks
from crowdbench.planners.hidden import hidden_scene
from crowdbench.planners.inflation import RadiusInflation, radius_inflation
from crowdbench.planners.last_plans import LastPlans
from crowdbench.planners.planner import AheadPlanner, PredictingPlanner
from crowdbench.planners.scene import Scene, Sequence, Sequences, Velocities, scene_of
from crowdbench.planners.trials import SequenceResult, limit_commands, propagate_vehicle, time_left, try_sequences
from crowdbench.predict.predictor import Prediction, predict
from crowdbench.utils.errors import is_number, require, require_count, require_not_negative, require_positive

Costs = Float[np.ndarray, "world sequence"]
Noise = Float[np.ndarray, "world round sample time 2"]

SHOWN = 12
"""Number of sampled paths that are recorded."""


@dataclasses.dataclass(frozen=True)
class MPPISearch:
    """Settings of the sampling. Commands are in fractions of their range: from 0 to the preferred speed, or to a limit.

    Attributes:
        samples: Number of sequences that are sampled in a round [1].
        rounds: Number of rounds, each around the result of the one before [1].
        spread: Standard deviation of the samples of the first round [1].
        narrower: Factor by which the deviation is multiplied in each further round [1].
        correlation: Correlation of the noise of a command with that of the previous command [1].
        temperature: Increase of the costs that reduces the weight of a sequence to 1 / e [s].

    Raises:
        InputError: A number is impossible.
    """

    samples: int = 200
    rounds: int = 2
    spread: float = 0.35
    narrower: float = 0.6
    correlation: float = 0.85
    temperature: float = 0.1

    def __post_init__(self) -> None:
        for name in ("samples", "rounds"):
            require_count(name, getattr(self, name))
        for name in ("spread", "narrower", "temperature"):
            require_positive(name, getattr(self, name))
        right = "a number from 0 to below 1"
        require("correlation", self.correlation, is_number(self.correlation) and 0.0 <= self.correlation < 1.0, right)


@dataclasses.dataclass(frozen=True)
class MPPIWeights:
    """Costs of a sequence, as equivalent additional travel time in seconds.

    Attributes:
        contact: A collision with a pedestrian in the first step [s].
        fading: Factor on the costs of contacts and gaps for each step ahead, because the prediction is less certain
            [1].
        wall: A collision with an obstacle [s].
        near: A step with a gap of 0; the cost decreases quadratically to 0 at the margin [s].
        margin: Width of the margin in the first step [m].
        growth: Increase of this width for each second ahead [m/s].
        sigma_factor: Radius of the halo of a tracked pedestrian, in standard deviations of its position. Gaps are
            those to halos; a collision is one with the pedestrian [1].
        uncertain: A step inside a halo, for each metre of depth [s/m].
        change: A change of a command by its whole range; the cost is quadratic [s].
        jerk: A change of this change; the cost is quadratic [s].

    Raises:
        InputError: A number is impossible.
    """

    contact: float = 60.0
    fading: float = 0.7
    wall: float = 200.0
    near: float = 6.0
    margin: float = 0.03
    growth: float = 0.35
    sigma_factor: float = 1.1
    uncertain: float = 8.0
    change: float = 0.15
    jerk: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require_not_negative(name, value)
        require("margin", self.margin, self.margin > 0.0, "above 0")


SEARCH, WEIGHTS = MPPISearch(), MPPIWeights()


@dataclasses.dataclass(eq=False)
class MPPIPlanner(PredictingPlanner, AheadPlanner):
    """Planner of the cost-weighted mean of sampled command sequences, or of the best sample if it has a lower cost.

    Each decision starts from the rest of the last plan, the straight path to the goal, and constant commands.

    Attributes:
        search: Settings of the sampling.
        weights: Costs of sequences.
        horizon: Number of steps of a sequence [1].
        worst: Share of the futures over which costs are averaged, those with the highest costs (CVaR); 1 for all [1].

    Raises:
        InputError: `horizon` is not a whole number above 0, or `worst` is not in (0, 1].
    """

    search: MPPISearch = SEARCH
    weights: MPPIWeights = WEIGHTS
    horizon: int = 18
    worst: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_count("horizon", self.horizon)
        require("worst", self.worst, is_number(self.worst) and 0.0 < self.worst <= 1.0, "above 0, and 1 at most")
        self.last = LastPlans(self.horizon)

    def reset(self, rows: np.ndarray) -> None:
        """See `Planner`."""
        self.last.reset(rows)

    def plan_ahead(self, obs: Observation, steps: int) -> Sequence:
        """See `Planner`."""
        self.last.check_length(steps)
        first, noise = self.first_guesses(obs), self._noise(obs)
        prediction = predict(self.predictor, obs, self.horizon, first[:, 0])
        best, path = np.empty((2, len(obs), self.horizon, 2))
        shown = np.empty((len(obs), min(SHOWN, self.search.samples), self.horizon, 3))

        def fill(part: slice) -> None:
            futures = Prediction(prediction.position[part], prediction.velocity[part])
            chunk = obs.take(part)
            scene = scene_of(chunk, futures, 0, chunk.vehicle, self.horizon)
            guesses, hidden = first[part], hidden_scene(chunk, scene)
            best[part], paths = self.optimize(scene, self.halo(chunk), hidden, guesses, noise[part])
            order = np.argsort(-paths[:, :, 0, 2], axis=1, kind="stable")[:, : shown.shape[1], None, None]
            shown[part] = np.take_along_axis(paths, order, axis=1)
            if obs.logs is not None:
                path[part] = try_sequences(scene, best[part, None]).motion[:, 0, 1:, :2]

        rows = self.search.samples * max(obs.pedestrians.radius.shape[1], 1) * prediction.position.shape[1]
        in_chunks(fill, len(obs), max(1, 8 * CHUNK // rows))
        self.last.store(obs, best)
        if obs.logs is not None:
            obs.log("predicted", prediction.position)
            obs.log("sampled", shown.swapaxes(1, 2))
            obs.log("planned", path[:, :, None])
        return best[:, :steps]

    def halo(self, obs: Observation) -> RadiusInflation:
        """Return the width of each pedestrian's halo in each step, in metres."""
        return radius_inflation(obs, self.horizon, self.weights.sigma_factor)

    def first_guesses(self, obs: Observation) -> Sequences:
        """Return the rest of the last plan, the path to the goal, and constant commands."""
        vehicle, straight = obs.vehicle, np.empty((len(obs), self.horizon, 2))
        dynamics, speed = vehicle.dynamics, vehicle.preferred_speed
        for t in range(self.horizon):
            toward = toward_goal(vehicle.position, vehicle.local_goal, speed)
            straight[:, t] = dynamics.follow(vehicle.state, toward, speed, obs.dt)
            vehicle = propagate_vehicle(vehicle, straight[:, t], obs)
        return np.insert(self.last.guesses(obs, straight), 1, straight, axis=1)

    def _noise(self, obs: Observation) -> Noise:
        """Return noise of standard deviation 1, correlated over the steps of a sequence; the second half mirrors the
        first."""
        noise = obs.noise("mppi", (self.search.rounds, (self.search.samples + 1) // 2, self.horizon, 2))
        correlation, innovation = self.search.correlation, np.sqrt(1.0 - self.search.correlation**2)
        for t in range(1, self.horizon):
            noise[..., t, :] = correlation * noise[..., t - 1, :] + innovation * noise[..., t, :]
        return np.concatenate([noise, -noise], axis=2)[:, :, : self.search.samples]

    def optimize(
        self, scene: Scene, halo: RadiusInflation, hidden: Scene | None, guesses: Sequences, noise: Noise
    ) -> tuple[Sequence, Float[np.ndarray, "world candidate time 3"]]:
        """Return the selected sequence of each world, and the paths of the samples of the last round.

        A path has positions in metres, and the negative cost of the whole sequence in seconds.

        Args:
            scene: The vehicles and the pedestrians.
            halo: The width of each pedestrian's halo in each step, in metres.
            hidden: The scene with the virtual pedestrian that walls may hide.
            guesses: Sequences of commands with which the search begins.
            noise: Noise of standard deviation 1.
        """
        spread = self.search.spread * _range(scene)[:, None, None]
        candidates, world = guesses, np.arange(len(guesses))
        cost, _ = self.costs(scene, guesses, halo, hidden)
        for number in range(self.search.rounds):
            centre = candidates[world, cost.argmin(axis=1)]
            deviation = self.search.narrower**number * spread * noise[:, number]
            sampled = limit_commands(centre[:, None] + deviation, scene.vehicle)
            tried = np.concatenate([sampled, centre[:, None]], axis=1)
            cost, result = self.costs(scene, tried, halo, hidden)
            weight = np.exp((cost.min(axis=1, keepdims=True) - cost) / self.search.temperature)
            mean = (weight[..., None, None] * tried).sum(axis=1) / weight.sum(axis=1)[:, None, None]
            candidates = np.stack([mean, tried[world, cost.argmin(axis=1)]], axis=1)
            values = -np.repeat(cost[..., None, None], noise.shape[3], axis=2)
            paths = np.concatenate([result.motion[:, :, 1:, :2], values], axis=3)
            cost, _ = self.costs(scene, candidates, halo, hidden)
        return candidates[world, cost.argmin(axis=1)], paths

    def costs(
        self, scene: Scene, commands: Sequences, halo: RadiusInflation, hidden: Scene | None = None
    ) -> tuple[Costs, SequenceResult]:
        """Return the costs of sequences in seconds, see `MPPIWeights`, and their simulated results.

        The costs are the time to the goal, and penalties for events during the sequence.

        Args:
            scene: The vehicles and the pedestrians.
            commands: Commands of the vehicle's dynamics.
            halo: The width of each pedestrian's halo in each step, in metres.
            hidden: The scene with the virtual pedestrian.
        """
        result = try_sequences(scene, commands, halo=halo)
        cost = self._nearness(result, scene.dt) + self.weights.wall * (result.outcome == Outcome.WALL_COLLISION)
        if hidden is not None:
            cost += self._nearness(try_sequences(hidden, commands), scene.dt)
        arrived, whole = result.outcome == Outcome.SUCCESS, scene.dt * commands.shape[2]
        cost += np.where(arrived, scene.dt * result.steps, whole + time_left(scene, result)[..., None])
        return self._over_futures(cost) + self._roughness(scene, commands), result

    def _nearness(self, result: SequenceResult, dt: float) -> Float[np.ndarray, "world sequence mode"]:
        """Return the costs of small gaps to pedestrians and of contacts."""
        weights, time = self.weights, np.arange(result.gap.shape[-1])
        margin, fading = weights.margin + weights.growth * dt * time, weights.fading**time
        inside = np.maximum(1.0 - np.maximum(result.gap, 0.0) / margin, 0.0)
        near = weights.near * inside**2 + weights.uncertain * np.maximum(-result.gap, 0.0)
        hit = result.outcome == Outcome.COLLISION
        return np.asarray((fading * near).sum(axis=-1) + hit * weights.contact * weights.fading ** (result.steps - 1))

    def _over_futures(self, cost: Float[np.ndarray, "world sequence mode"]) -> Costs:
        """Return the mean cost over the worst futures of each sequence."""
        number = int(np.ceil(self.worst * cost.shape[2]))
        if number < cost.shape[2]:
            cost = np.sort(cost, axis=2)[:, :, -number:]
        return cost.mean(axis=2)

    def _roughness(self, scene: Scene, commands: Sequences) -> Costs:
        """Return the costs of changes of the commands; the first change is from the vehicle's present motion."""
        vehicle = scene.vehicle
        if isinstance(vehicle.dynamics, Holonomic):
            now = vehicle.velocity
        else:
            now = vehicle.dynamics.follow(vehicle.state, vehicle.velocity, vehicle.preferred_speed, scene.dt)
        before = np.broadcast_to(now[:, None, None], (*commands.shape[:2], 1, 2))
        change = np.diff(np.concatenate([before, commands], axis=2), axis=2) / _range(scene)[:, None, None]
        rough = self.weights.change * (change**2).sum(axis=(2, 3))
        return rough + self.weights.jerk * (np.diff(change, axis=2) ** 2).sum(axis=(2, 3))


def _range(scene: Scene) -> Velocities:
    """Return the largest value of each component of a command."""
    return scene.vehicle.dynamics.space(scene.vehicle.preferred_speed)[1]
