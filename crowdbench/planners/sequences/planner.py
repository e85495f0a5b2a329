"""The planner of command sequences: the cross-entropy method on sequences that are valued under every future."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Num

from crowdbench.dynamics import FREE, Dynamics, Holonomic, State
from crowdbench.errors import InputError
from crowdbench.geometry import local_goals, norm
from crowdbench.numbers import is_integer, is_number
from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.sequences.futures import Futures, try_sequences
from crowdbench.predict import Prediction
from crowdbench.predict.checked import checked
from crowdbench.reward import discount
from crowdbench.sim.routes import next_waypoints
from crowdbench.threads import CHUNK, in_chunks
from crowdbench.types import Observation, Outcome
from crowdbench.value.joint_state import joint_states
from crowdbench.value.networks import evaluate

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
            number = getattr(self, name)
            if not (is_integer(number) and number >= 1):
                raise InputError(f"{name} is {number!r}, but must be a whole number, 1 or more")
        if self.elites > self.samples:
            raise InputError(f"elites is {self.elites}, but must be {self.samples} at most, which is samples")
        if not (is_number(self.spread) and 0.0 < self.spread < np.inf):
            raise InputError(f"spread is {self.spread!r}, but must be a number above 0")


SEARCH = CrossEntropy()
"""How sequences are sampled where nothing else is asked for."""


class SequencePlanner(Planner):
    """Takes the sequence of commands with the largest discounted reward and value at its end, over all futures.

    The first guess is what the one-step lookahead would do, step by step, in the mean of the futures. The first
    candidates are this sequence, sequences of one command of the lookahead throughout, and samples around the guess.

    Args:
        lookahead: The one-step lookahead for the first guess, whose predictor, network, commands and reward are used.
            Its limits, shaping and finer commands are for the first guess alone.
        search: How sequences are sampled.
        horizon: Number of steps of a sequence, or more where more commands are asked for [1].
        margin: By how much gaps are made smaller for each step ahead, because the futures spread with time [m].

    Raises:
        InputError: `horizon` is not a whole number above 0, or `margin` is negative.
    """

    native = True

    def __init__(
        self, lookahead: ValuePlanner, search: CrossEntropy = SEARCH, horizon: int = 8, margin: float = 0.04
    ) -> None:
        if not (is_integer(horizon) and horizon >= 1):
            raise InputError(f"horizon is {horizon!r}, but must be a whole number, 1 or more")
        if not (is_number(margin) and 0.0 <= margin < np.inf):
            raise InputError(f"margin is {margin!r}, but must be a number, 0 or more")
        self.privileged = lookahead.privileged
        self.facts = lookahead.facts
        self.lookahead = lookahead
        self.search = search
        self.horizon = horizon
        self.margin = margin

    def unseen(self, scene: str) -> SequencePlanner:
        """See `Planner`."""
        return SequencePlanner(self.lookahead.unseen(scene), self.search, self.horizon, self.margin)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        return self.plan_ahead(obs, 1)[:, 0]

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """See `Planner`."""
        horizon = max(steps, self.horizon)
        predictor = self.lookahead.predictor
        prediction = checked(predictor.predict(obs, horizon), type(predictor).__name__, obs, horizon)
        guess, _ = self.lookahead.follow(obs, _mean(prediction))
        noise = self._noise(obs, horizon)
        best = np.empty((len(obs), horizon, 2))

        def fill(part: slice) -> None:
            best[part] = self._best(_futures(obs, prediction, part), guess[part], noise[part])

        rows = self.search.samples * max(obs.pedestrians.radius.shape[1], 1)
        # The guesses beside the samples of the first round are not counted: its chunks are about twice as large.
        in_chunks(fill, len(obs), max(1, CHUNK // rows))
        if obs.logs is not None:
            obs.log("predicted", prediction.position)
            way = _driven(obs.vehicle.state, best[:, None], obs.vehicle.dynamics, obs.vehicle.preferred_speed, obs.dt)
            obs.log("planned", way.position.swapaxes(1, 2))
        return best[:, :steps]

    def _noise(self, obs: Observation, horizon: int) -> Float[np.ndarray, "world round sample time 2"]:
        """Noise of standard deviation 1, smooth in time: each sequence has a part that is the same at all its steps."""
        drawn = obs.noise("sequences", (self.search.rounds, self.search.samples, horizon + 1, 2))
        return np.sqrt(SMOOTH) * drawn[:, :, :, :1] + np.sqrt(1.0 - SMOOTH) * drawn[:, :, :, 1:]

    def _best(
        self,
        futures: Futures,
        guess: Float[np.ndarray, "world time 2"],
        noise: Float[np.ndarray, "world round sample time 2"],
    ) -> Float[np.ndarray, "world time 2"]:
        """The best sequence of each world."""
        horizon = guess.shape[1]
        if isinstance(futures.dynamics, Holonomic):
            commands = self.lookahead.actions(futures.preferred_speed)
        else:
            # Those that can be reached by its end.
            commands = futures.dynamics.commands(futures.state, futures.preferred_speed, horizon * futures.dt)
        constant = commands[:, :, None].repeat(horizon, axis=2)
        # What is tried beside the samples of a round: at first the guesses, and then the best so far.
        beside = np.concatenate([guess[:, None], constant], axis=1)
        mean, spread = guess, np.full_like(guess, self.search.spread)
        for number in range(self.search.rounds):
            sampled = mean[:, None] + spread[:, None] * noise[:, number]
            tried = np.concatenate([beside, _within(sampled, futures)], axis=1)
            values = self.values(futures, tried)
            ranked = values.argsort(axis=1, kind="stable")[:, ::-1, None, None]
            elites = np.take_along_axis(tried, ranked[:, : self.search.elites], axis=1)
            mean, spread, beside = elites.mean(axis=1), elites.std(axis=1), elites[:, :1]
        return beside[:, 0]

    def values(
        self, futures: Futures, commands: Float[np.ndarray, "world sequence time 2"]
    ) -> Float[np.ndarray, "world sequence"]:
        """What sequences are worth: the mean over the futures of their discounted rewards and the value at the end.

        The value at the end is the network's, among pedestrians at the mean of their futures, on the way to the local
        goal there.

        Args:
            futures: The vehicle and the pedestrians.
            commands: Commands of the vehicle's dynamics.

        Returns:
            Their values.
        """
        horizon = commands.shape[2]
        time = np.arange(horizon)
        tried = try_sequences(futures, commands, self.margin * time)
        outcome = np.where(time == tried.steps[..., None] - 1, tried.outcome[..., None], Outcome.RUNNING)
        rewards = self.lookahead.reward(outcome, tried.gap, futures.dt)
        factor = discount(futures.preferred_speed, futures.dt)[:, None, None, None] ** np.arange(horizon + 1)
        earned = np.where(time < tried.steps[..., None], factor[..., :-1] * rewards, 0.0).sum(axis=-1)
        running = (tried.outcome == Outcome.RUNNING).mean(axis=-1)
        return earned.mean(axis=-1) + running * factor[:, :, 0, -1] * self._end_values(futures, commands)

    def _end_values(
        self, futures: Futures, commands: Float[np.ndarray, "world sequence time 2"]
    ) -> Float[np.ndarray, "world sequence"]:
        """The network's values of the states after the last command, among the pedestrians' mean futures."""
        worlds, sequences = commands.shape[:2]
        if futures.dynamics == FREE:
            position = futures.state.position[:, None] + futures.dt * commands.sum(axis=2)
            velocity = commands[:, :, -1]
        else:
            end = _driven(futures.state, commands, futures.dynamics, futures.preferred_speed, futures.dt)
            position, velocity = end.position[:, :, -1], end.velocity[:, :, -1]
        crowd = futures.crowd[:, :, -1].mean(axis=1)
        present = np.ones((worlds, sequences, 1 + futures.present.shape[1]), bool)
        present[:, :, 1:] = futures.present[:, None]
        joint = joint_states(
            _joined(position, crowd),
            _joined(velocity, futures.crowd_velocity),
            _joined(_repeated(futures.radius, sequences), futures.crowd_radius),
            present,
            _local_goals(futures, position),
            _repeated(futures.preferred_speed, sequences),
        )
        shown = np.zeros(joint.shape[:3], bool)
        shown[:, :, : futures.present.shape[1]] = futures.present[:, None]
        return evaluate(self.lookahead.value, joint, shown)[0]


def _local_goals(
    futures: Futures, position: Float[np.ndarray, "world sequence 2"]
) -> Float[np.ndarray, "world sequence 2"]:
    """The vehicle's local goal in metres at the end of each sequence."""
    sequences = position.shape[1]
    goal, route = _repeated(futures.goal, sequences), _repeated(futures.route, sequences)
    waypoint, radius = _repeated(futures.waypoint, sequences), _repeated(futures.radius, sequences)
    waypoint = next_waypoints(position, goal, route, waypoint, radius, futures.obstacles)
    return local_goals(position, goal, route, waypoint)


def _repeated(values: Num[np.ndarray, "world *xy"], sequences: int) -> Num[np.ndarray, "world sequence *xy"]:
    """What is the same for all sequences of a world."""
    return np.repeat(values[:, None], sequences, axis=1)


def _joined(
    vehicle: Float[np.ndarray, "world sequence *xy"], crowd: Float[np.ndarray, "world pedestrian *xy"]
) -> Float[np.ndarray, "world sequence agent *xy"]:
    """The vehicle of each sequence, and the pedestrians, which are the same for all."""
    return np.concatenate([vehicle[:, :, None], _repeated(crowd, vehicle.shape[1])], axis=2)


def _mean(prediction: Prediction) -> Prediction:
    """The mean of the futures, as the only one."""
    return Prediction(prediction.position.mean(axis=1, keepdims=True), prediction.velocity.mean(axis=1, keepdims=True))


def _futures(obs: Observation, prediction: Prediction, part: slice) -> Futures:
    """What sequences are tried in, for some of the worlds."""
    vehicle, pedestrians = obs.vehicle, obs.pedestrians
    after = prediction.position[part]
    now = np.broadcast_to(pedestrians.position[part, None, None], (*after.shape[:2], 1, *after.shape[3:]))
    return Futures(
        state=State(*(array[part] for array in vehicle.state)),
        goal=vehicle.goal[part],
        radius=vehicle.radius[part],
        preferred_speed=vehicle.preferred_speed[part],
        crowd=np.concatenate([now, after], axis=2),
        crowd_velocity=prediction.velocity[part, :, -1].mean(axis=1),
        crowd_radius=pedestrians.radius[part],
        present=pedestrians.seen[part],
        route=vehicle.route[part],
        waypoint=vehicle.waypoint[part],
        obstacles=obs.obstacles[part],
        dt=obs.dt,
        dynamics=vehicle.dynamics,
        goal_tolerance=vehicle.goal_tolerance,
        body=vehicle.body,
    )


def _driven(
    state: State,
    commands: Float[np.ndarray, "world sequence time 2"],
    dynamics: Dynamics,
    max_speed: Float[np.ndarray, "world"],
    dt: float,
) -> State:
    """The states `[world, sequence, time]` after each command of sequences, from one state per world."""
    sequences, steps = commands.shape[1:3]
    each = State(*(_repeated(array, sequences) for array in state))
    states = []
    for t in range(steps):
        each = dynamics.step(each, commands[:, :, t], _repeated(max_speed, sequences), dt)
        states.append(each)
    return State(*(np.stack(arrays, axis=2) for arrays in zip(*states, strict=True)))


def _within(
    commands: Float[np.ndarray, "world sequence time 2"], futures: Futures
) -> Float[np.ndarray, "world sequence time 2"]:
    """The commands, made small enough for the limits of the dynamics."""
    if not isinstance(futures.dynamics, Holonomic):
        low, high = (bound[:, None, None] for bound in futures.dynamics.space(futures.preferred_speed))
        return np.clip(commands, low, high)
    limit = futures.preferred_speed[:, None, None]
    return commands * (limit / np.maximum(norm(commands), limit))[..., None]
