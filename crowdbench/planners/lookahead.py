"""The planner with a one-step lookahead: it predicts the crowd and selects the command with the best value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.dynamics import Holonomic
from crowdbench.core.dynamics.dynamics import speeds_and_headings
from crowdbench.core.geometry import norm
from crowdbench.core.reward import discount, reward
from crowdbench.core.types import Observation, Outcome, Vehicle
from crowdbench.networks.chunks import CHUNK, in_chunks
from crowdbench.networks.evaluation import evaluate
from crowdbench.networks.value import ValueNetwork
from crowdbench.networks.weights import weights_digest
from crowdbench.planners.kce import Limits, Shaping
from crowdbench.planners.planner import AheadPlanner, PredictingPlanner
from crowdbench.planners.scene import Commands, Scene, Sequence, Velocities, mean_future, scene_of
from crowdbench.planners.trials import propagate_vehicle, try_commands
from crowdbench.predict.predictor import Prediction, predict
from crowdbench.utils.errors import require_count

Reward = Callable[[Int[np.ndarray, "*batch"], Float[np.ndarray, "*batch"], float], Float[np.ndarray, "*batch"]]


SHOWN = 8
"""Number of steps of the futures that are logged: more than are planned, to show where the futures lead."""


class ScoredActions(NamedTuple):
    """Commands with their values.

    Attributes:
        commands: The commands.
        values: Reward of the step plus discounted value of the state after it, the mean over the futures; minus
            infinity if the limits exclude the command.
        later: The value of the state after the step, the mean over the futures; NaN if the command is excluded.
        attention: The mean attention to each pedestrian in that state over the futures; NaN if the command is excluded.
    """

    commands: Commands
    values: Float[np.ndarray, "world action"]
    later: Float[np.ndarray, "world action"]
    attention: Float[np.ndarray, "world action pedestrian"]

    def best(self) -> Velocities:
        """Return the best command of each world; the first if several are equal."""
        return self.commands[np.arange(len(self.values)), self.values.argmax(axis=1)]


@dataclass(eq=False)
class ValuePlanner(PredictingPlanner, AheadPlanner):
    """Planner of the command with the largest reward of the next step plus discounted value of the next state.

    Its methods are defined in the order in which a decision calls them.

    Attributes:
        value: The value network.
        actions: Returns the candidate commands in m/s for preferred speeds in m/s. A wheeled vehicle has the commands
            of its dynamics instead.
        reward: The reward of a step, called like `crowdbench.core.reward.reward`.
        shaping: Reward of a change of velocity, called like `kce.ChangeCost`; None for no such reward.
        limits: The allowed changes of velocity; None for all. With limits, the hardest allowed braking is an additional
            command, so that a holonomic vehicle always has an allowed command.
        explore: Returns further commands around the best one, called like `kce.Exploration`; None for no further
            commands. The best command is replaced only if a further one is better.
        shortlist: Number of commands that are evaluated under all futures: those that are best in a single future with
            the mean predicted positions and velocities. None for all commands. No effect if there is one future.

    Raises:
        InputError: `shortlist` is not a whole number above 0.
    """

    value: ValueNetwork
    actions: Callable[[Float[np.ndarray, "world"]], Commands] = speeds_and_headings
    reward: Reward = reward
    shaping: Shaping | None = None
    limits: Limits | None = None
    explore: Callable[[Scene, Velocities], Commands] | None = None
    shortlist: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.shortlist is not None:
            require_count("shortlist", self.shortlist)
        self.value.eval()
        self.trained_dt = self.value.trained_dt
        self.facts = {"network": self.value.name, "weights": weights_digest(self.value), **self.facts}

    def plan_ahead(self, obs: Observation, steps: int) -> Sequence:
        """See `Planner`. The crowd is predicted once for all steps; the vehicle follows its earlier commands."""
        prediction = predict(self.predictor, obs, steps)
        commands, first = self.follow(obs, prediction)
        if obs.logs is not None:
            self._log(obs, prediction, first)
        return commands

    def follow(self, obs: Observation, prediction: Prediction) -> tuple[Sequence, ScoredActions]:
        """Return the commands for the steps of a prediction, each decided in the state after the earlier ones.

        Args:
            obs: The observation before the first step.
            prediction: The pedestrians' motion during these steps.

        Returns:
            The commands, and the candidates of the first step with their values.
        """
        steps = prediction.position.shape[2]
        commands = np.empty((len(obs), steps, 2))
        vehicle = obs.vehicle
        scored = []
        for step in range(steps):
            scored.append(self.choose(scene_of(obs, prediction, step, vehicle)))
            commands[:, step] = scored[-1].best()
            vehicle = propagate_vehicle(vehicle, commands[:, step], obs)
        return commands, scored[0]

    def choose(self, scene: Scene) -> ScoredActions:
        """Return the candidate commands in each world with their values; the vehicle executes the best one."""
        scored = self._score(scene, self.commands(scene.vehicle, scene.dt))
        if self.explore is None:
            return scored
        return self._score(scene, self.explore(scene, scored.best()), scored)

    def commands(self, vehicle: Vehicle, dt: float) -> Commands:
        """Return the candidate commands. Not all of them are within the limits; with limits, the last one brakes.

        Args:
            vehicle: The vehicle before the step.
            dt: Duration of the step in seconds.
        """
        commands = self.unlimited_commands(vehicle, dt)
        if self.limits is None:
            return commands
        slower = self.limits.brake(vehicle.velocity, dt)
        brake = vehicle.dynamics.follow(vehicle.state, slower, vehicle.preferred_speed, dt)
        return np.concatenate([commands, brake[:, None]], axis=1)

    def unlimited_commands(self, vehicle: Vehicle, dt: float) -> Commands:
        """Return the candidate commands without limits, see `commands`."""
        if isinstance(vehicle.dynamics, Holonomic):
            return self.actions(vehicle.preferred_speed)
        return vehicle.dynamics.commands(vehicle.state, vehicle.preferred_speed, dt)

    def are_allowed(self, vehicle: Vehicle, commands: Commands, dt: float) -> Bool[np.ndarray, "world action"]:
        """Return which commands are within the limits, with the arguments of `commands`."""
        if self.limits is None:
            return np.ones(commands.shape[:2], bool)
        velocities = vehicle.dynamics.velocities(vehicle.state, commands, vehicle.preferred_speed, dt)
        return self.limits.allow(vehicle.velocity, velocities, dt)

    def _score(self, scene: Scene, commands: Commands, known: ScoredActions | None = None) -> ScoredActions:
        """Return commands with their values; with a shortlist, only the best commands under the mean of the futures.

        Commands that have been scored before come first.
        """
        if self.shortlist is not None and self.shortlist < commands.shape[1] and scene.crowd.velocity.shape[1] > 1:
            loss = -self.score(mean_future(scene), commands).values
            # In their old order, which decides between commands of equal value.
            best = np.sort(loss.argsort(axis=1, kind="stable")[:, : self.shortlist], axis=1)
            commands = np.take_along_axis(commands, best[..., None], axis=1)
        return self.score(scene, commands, known)

    def score(self, scene: Scene, commands: Commands, known: ScoredActions | None = None) -> ScoredActions:
        """Evaluate commands. Each state is evaluated once, also if several commands lead to it.

        Args:
            scene: The state before the step, and the predicted crowd.
            commands: The commands.
            known: Commands that have been evaluated in this scene, which come first in the result.
        """
        allowed = self.are_allowed(scene.vehicle, commands, scene.dt)
        shape, people = allowed.shape, scene.crowd.present.shape[1]
        scored = ScoredActions(
            commands, np.full(shape, -np.inf), np.full(shape, np.nan), np.full((*shape, people), np.nan)
        )
        before = 0 if known is None else known.values.shape[1]
        if known is not None:
            scored = ScoredActions(*(np.concatenate(pair, axis=1) for pair in zip(known, scored, strict=True)))
        first = _first_equal(scored.commands)
        world, action = np.nonzero(allowed & (first[:, before:] == np.arange(before, first.shape[1])))

        def fill(part: slice) -> None:
            rows = world[part], before + action[part]
            scored.values[rows], scored.later[rows], scored.attention[rows] = self._evaluate(
                scene, commands[world[part], action[part]], world[part]
            )

        in_chunks(fill, len(world), _chunk(scene))
        for array in scored[1:]:
            array[:] = array[np.arange(len(first))[:, None], first]
        return scored

    def _evaluate(
        self, scene: Scene, commands: Float[np.ndarray, "row 2"], world: Int[np.ndarray, "row"]
    ) -> tuple[Float[np.ndarray, "row"], Float[np.ndarray, "row"], Float[np.ndarray, "row pedestrian"]]:
        """Return the other fields of `ScoredActions` for commands, without limits; `world` is the world of each
        command."""
        result = try_commands(scene, commands, world)
        now = self.reward(result.outcome, result.gap, scene.dt)
        if self.shaping is not None:
            now = now + self.shaping(result.outcome, result.gap, norm(result.velocity - scene.vehicle.velocity[world]))
        factor = discount(scene.vehicle.preferred_speed, scene.dt)[world, None]
        later, attention = evaluate(self.value, result.joint, _present(scene, world))
        values = now + np.where(result.outcome == Outcome.RUNNING, factor * later, 0.0)
        return values.mean(axis=1), later.mean(axis=1), attention[..., : scene.crowd.present.shape[1]].mean(axis=1)

    def _log(self, obs: Observation, prediction: Prediction, scored: ScoredActions) -> None:
        """Log the predicted crowd, all commands, the value of the state after the chosen one, and the attention."""
        velocities = scene_of(obs, prediction, 0, obs.vehicle).velocities(scored.commands)
        best = np.arange(len(obs)), scored.values.argmax(axis=1)
        shown = prediction if prediction.position.shape[2] >= SHOWN else predict(self.predictor, obs, SHOWN)
        obs.log("commands", np.dstack([velocities, scored.values]))
        obs.log("predicted", shown.position)
        obs.log("value", scored.later[best])
        obs.log("attention", scored.attention[best])


def _chunk(scene: Scene) -> int:
    """Return the number of commands that are evaluated at once, so that memory does not grow with worlds or modes."""
    modes, pedestrians = scene.crowd.velocity.shape[1:3]
    return max(1, CHUNK // (modes * max(pedestrians, 1)))


def _present(scene: Scene, world: Int[np.ndarray, "row"]) -> Bool[np.ndarray, "row mode pedestrian"]:
    """Return which pedestrians of the joint states are present. There is at least one row, even without pedestrians."""
    modes, pedestrians = scene.crowd.velocity.shape[1:3]
    present = np.zeros((len(world), modes, max(pedestrians, 1)), bool)
    present[..., :pedestrians] = scene.crowd.present[world][:, None]
    return present


def _first_equal(commands: Commands) -> Int[np.ndarray, "world action"]:
    """Return the index of the first command of each world that equals a command up to rounding.

    Several finer commands are equal if their speeds are clipped, and one of them is the command that they surround.
    """
    rounded = np.round(commands, 9)
    key = rounded[..., 0] + 1j * rounded[..., 1]
    return (key[:, :, None] == key[:, None]).argmax(axis=2)
