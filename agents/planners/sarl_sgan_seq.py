"""Beyond Li et al. (2020): whole sequences of commands under Social GAN's 20 futures, with SARL's network at their end.

The cross-entropy method: Rubinstein, "The Cross-Entropy Method for Combinatorial and Continuous Optimization",
Methodology and Computing in Applied Probability 1, 1999.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Num, Shaped

from crowdbench import Observation, Outcome, Prediction, ValuePlanner
from crowdbench.core import discount
from crowdbench.networks import CHUNK, evaluate, in_chunks, joint_states
from crowdbench.planners import (
    AheadPlanner,
    Scene,
    Sequence,
    Sequences,
    limit_commands,
    local_goals_at,
    lookahead_planner,
    scene_of,
    try_sequences,
)
from crowdbench.predict import predict
from crowdbench.utils import require, require_count, require_not_negative, require_positive

Noise = Float[np.ndarray, "world round sample time 2"]

SMOOTH = 0.5
"""Share of the variance of a sequence's noise that is the same at all its steps."""


@dataclasses.dataclass(frozen=True)
class CrossEntropy:
    """The cross-entropy method (Rubinstein 1999), which samples sequences and samples again around the best of them.

    Attributes:
        samples: Number of sequences that are sampled in a round [1].
        rounds: Number of rounds [1].
        elites: Number of sequences, the best of a round, whose mean and standard deviation the next one samples [1].
        spread: Standard deviation of the samples of the first round around the first guess [m/s].

    Raises:
        InputError: A number is below 1 or not whole, there are more elites than samples, or the spread is not positive.
    """

    samples: int = 96
    rounds: int = 3
    elites: int = 12
    spread: float = 0.3

    def __post_init__(self) -> None:
        for name in ("samples", "rounds", "elites"):
            require_count(name, getattr(self, name))
        require("elites", self.elites, self.elites <= self.samples, f"{self.samples} at most, which is samples")
        require_positive("spread", self.spread)


SEARCH = CrossEntropy()
"""How sequences are sampled where nothing else is asked for."""


@dataclasses.dataclass(eq=False)
class SequencePlanner(AheadPlanner):
    """Takes the sequence of commands with the largest discounted reward and value at its end, over all futures.

    The first guess is what the one-step lookahead would do, step by step, in the mean of the futures. The first
    candidates are this sequence, sequences of one command of the lookahead throughout, and samples around the guess.

    Attributes:
        lookahead: The one-step lookahead for the first guess, whose predictor, network, commands and reward are used.
            Its limits, shaping and finer commands are for the first guess alone.
        search: How sequences are sampled.
        horizon: Number of steps of a sequence, or more where more commands are asked for [1].
        margin: By how much gaps are made smaller for each step ahead, because the futures spread with time [m].

    Raises:
        InputError: `horizon` is not a whole number above 0, or `margin` is negative.
    """

    lookahead: ValuePlanner
    search: CrossEntropy = SEARCH
    horizon: int = 8
    margin: float = 0.04

    native = True

    def __post_init__(self) -> None:
        require_count("horizon", self.horizon)
        require_not_negative("margin", self.margin)
        self.privileged, self.facts = self.lookahead.privileged, self.lookahead.facts

    def for_held_out_scene(self, scene: str) -> SequencePlanner:
        """See `Planner`."""
        return dataclasses.replace(self, lookahead=self.lookahead.for_held_out_scene(scene))

    def plan_ahead(self, obs: Observation, steps: int) -> Sequence:
        """See `Planner`."""
        horizon = max(steps, self.horizon)
        prediction = predict(self.lookahead.predictor, obs, horizon)
        guess, _ = self.lookahead.follow(obs, _mean(prediction))
        noise = self._noise(obs, horizon)
        best, path = np.empty((2, len(obs), horizon, 2))

        def fill(part: slice) -> None:
            chunk, futures = obs.take(part), Prediction(prediction.position[part], prediction.velocity[part])
            scene = scene_of(chunk, futures, 0, chunk.vehicle, horizon)
            best[part] = self._search(scene, guess[part], noise[part])
            if obs.logs is not None:
                path[part] = try_sequences(scene, best[part, None]).motion[:, 0, 1:, :2]

        rows = self.search.samples * max(obs.pedestrians.radius.shape[1], 1)
        # The guesses beside the samples of the first round are not counted: its chunks are about twice as large.
        in_chunks(fill, len(obs), max(1, CHUNK // rows))
        if obs.logs is not None:
            obs.log("predicted", prediction.position)
            obs.log("planned", path[:, :, None])
        return best[:, :steps]

    def _noise(self, obs: Observation, horizon: int) -> Noise:
        """Return noise of standard deviation 1, smooth in time: each sequence has a part that is the same at all its
        steps."""
        noise = obs.noise("sequences", (self.search.rounds, self.search.samples, horizon + 1, 2))
        return np.sqrt(SMOOTH) * noise[:, :, :, :1] + np.sqrt(1.0 - SMOOTH) * noise[:, :, :, 1:]

    def _search(self, scene: Scene, guess: Sequence, noise: Noise) -> Sequence:
        """Return the best sequence of each world."""
        vehicle, horizon = scene.vehicle, guess.shape[1]
        # Those that can be reached by its end.
        commands = self.lookahead.unlimited_commands(vehicle, horizon * scene.dt)
        constant = commands[:, :, None].repeat(horizon, axis=2)
        # Tried beside the samples of a round: at first the guesses, then the best so far.
        beside = np.concatenate([guess[:, None], constant], axis=1)
        mean, spread = guess, np.full_like(guess, self.search.spread)
        for number in range(self.search.rounds):
            sampled = mean[:, None] + spread[:, None] * noise[:, number]
            sequences = np.concatenate([beside, limit_commands(sampled, vehicle)], axis=1)
            values = self.values(scene, sequences)
            order = values.argsort(axis=1, kind="stable")[:, ::-1, None, None]
            elites = np.take_along_axis(sequences, order[:, : self.search.elites], axis=1)
            mean, spread, beside = elites.mean(axis=1), elites.std(axis=1), elites[:, :1]
        return beside[:, 0]

    def values(self, scene: Scene, commands: Sequences) -> Float[np.ndarray, "world sequence"]:
        """Return values of sequences: the mean over the futures of their discounted rewards and the value at the end.

        The value at the end is the network's, among pedestrians at the mean of their futures, on the way to the local
        goal there.

        Args:
            scene: The vehicle and the pedestrians.
            commands: Commands of the vehicle's dynamics.
        """
        horizon = commands.shape[2]
        time = np.arange(horizon)
        result = try_sequences(scene, commands, self.margin * time[None, :, None])
        outcome = np.where(time == result.steps[..., None] - 1, result.outcome[..., None], Outcome.RUNNING)
        rewards = self.lookahead.reward(outcome, result.gap, scene.dt)
        gamma = discount(scene.vehicle.preferred_speed, scene.dt)
        factor = gamma[:, None, None, None] ** np.arange(horizon + 1)
        earned = np.where(time < result.steps[..., None], factor[..., :-1] * rewards, 0.0).sum(axis=-1)
        running = (result.outcome == Outcome.RUNNING).mean(axis=-1)
        return earned.mean(axis=-1) + running * factor[:, :, 0, -1] * self._end_values(scene, result.motion[:, :, -1])

    def _end_values(
        self, scene: Scene, motion: Float[np.ndarray, "world sequence 6"]
    ) -> Float[np.ndarray, "world sequence"]:
        """Return the network's values of the states after the last command, among the pedestrians' mean scene."""
        vehicle, crowd = scene.vehicle, scene.crowd
        position, velocity = np.ascontiguousarray(motion[:, :, :2]), motion[:, :, 2:4]
        radius, speed = (_repeat(values, motion.shape[1]) for values in (vehicle.radius, vehicle.preferred_speed))
        ahead = local_goals_at(scene, position)
        ego = position, velocity, radius, np.ones(radius.shape, bool)
        others = crowd.position[:, :, -1].mean(axis=1), crowd.velocity.mean(axis=1), crowd.radius, crowd.present
        position, velocity, radius, present = (_join(*pair) for pair in zip(ego, others, strict=True))
        joint = joint_states(position, velocity, radius, present, ahead, speed)
        # Without pedestrians, there is one joint state: that of an absent one.
        return evaluate(self.lookahead.value, joint, present[:, :, 1:] if crowd.present.shape[1] else ~present)[0]


def _repeat(values: Num[np.ndarray, "world *xy"], sequences: int) -> Num[np.ndarray, "world sequence *xy"]:
    """Repeat values of a world for all its sequences."""
    return np.repeat(values[:, None], sequences, axis=1)


def _join(
    vehicle: Shaped[np.ndarray, "world sequence *xy"], crowd: Shaped[np.ndarray, "world pedestrian *xy"]
) -> Shaped[np.ndarray, "world sequence agent *xy"]:
    """Return the vehicle of each sequence, and the pedestrians, which are the same for all."""
    return np.concatenate([vehicle[:, :, None], np.repeat(crowd[:, None], vehicle.shape[1], axis=1)], axis=2)


def _mean(prediction: Prediction) -> Prediction:
    """Return the mean of the futures, as the only one."""
    return Prediction(prediction.position.mean(axis=1, keepdims=True), prediction.velocity.mean(axis=1, keepdims=True))


def planner(
    predictor: str = "sgan",
    weights: str = "sarl",
    device: str = "cpu",
    modes: int | None = None,
    search: CrossEntropy = SEARCH,
    horizon: int = 8,
    margin: float = 0.04,
) -> SequencePlanner:
    """Compose the planner.

    Args:
        predictor: Predictor of the pedestrians: a name (`crowdbench list predictors`) or a file.
        weights: The trained value network: a name (`crowdbench list weights`) or a file.
        device: Where the value network runs: `cpu` or `cuda`.
        modes: Number of futures to predict; false for the predictor's own number [1].
        search: How sequences are sampled.
        horizon: Number of steps of a sequence, or more where more commands are asked for [1].
        margin: By how much gaps are made smaller for each step ahead, because the futures spread with time [m].

    Returns:
        The planner.
    """
    return SequencePlanner(lookahead_planner("sarl", predictor, weights, device, modes), search, horizon, margin)
