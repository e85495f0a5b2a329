"""The planner that looks one step ahead: predict the crowd, try every command, value what it leads to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from crowdbench.lookahead.actions import speeds_and_headings
from crowdbench.lookahead.outlook import Scene, look
from crowdbench.planner import Planner
from crowdbench.predict import Prediction, Predictor
from crowdbench.reward import discount, reward
from crowdbench.types import Observation, Outcome
from crowdbench.value.networks import ValueNetwork
from crowdbench.weights import digest

CHUNK = 4096
"""Joint states that a network is given at once: few enough for its layers to stay in a core's cache."""

Actions = Callable[[Float[np.ndarray, "world"]], Float[np.ndarray, "world action 2"]]
Reward = Callable[
    [Int[np.ndarray, "*batch"], Float[np.ndarray, "*batch"], float],
    Float[np.ndarray, "*batch"],
]
Aggregate = Callable[[Float[np.ndarray, "row mode"]], Float[np.ndarray, "row"]]
Limits = Callable[[Float[np.ndarray, "world 2"], Float[np.ndarray, "world action 2"]], Bool[np.ndarray, "world action"]]
Explore = Callable[[Float[np.ndarray, "world 2"], Float[np.ndarray, "world"]], Float[np.ndarray, "world action 2"]]


def mean_over_modes(values: Float[np.ndarray, "row mode"]) -> Float[np.ndarray, "row"]:
    """Every predicted future counts alike."""
    return values.mean(axis=1)


class ValuePlanner(Planner):
    """Takes the command with the largest reward of the next step plus discounted value of the state after it.

    The next step's crowd is the `predictor`'s, and `value` is the network. `actions` gives the commands for a
    preferred speed, `reward` is a function like `crowdbench.reward.reward`, and `aggregate` makes one value of a
    command's values under all predicted futures. `limits(velocity, commands)` says which commands the vehicle can
    follow: where it can follow none, it keeps its velocity. `explore(command, preferred_speed)` gives further
    commands around the best one, which is taken if none of them is better.
    """

    def __init__(
        self,
        predictor: Predictor,
        value: ValueNetwork,
        actions: Actions = speeds_and_headings,
        reward: Reward = reward,
        aggregate: Aggregate = mean_over_modes,
        limits: Limits | None = None,
        explore: Explore | None = None,
    ) -> None:
        self.privileged = predictor.privileged
        self.predictor = predictor
        self.value = value.eval()
        self.actions = actions
        self.reward = reward
        self.aggregate = aggregate
        self.limits = limits
        self.explore = explore
        self.facts = {"network": value.name, "weights": digest(value)}

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        return self.plan_ahead(obs, 1)[:, 0]

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """See `Planner`. There is one prediction, in which each mode goes on by itself from step to step."""
        prediction = self.predictor.predict(obs, steps)
        commands = np.empty((len(obs), steps, 2))
        position, velocity = obs.vehicle.position, obs.vehicle.velocity
        for step in range(steps):
            scene = scene_of(obs, prediction, step, position)
            velocity = commands[:, step] = self._best(scene, velocity)
            if step == 0:
                self._log(obs, prediction, scene, velocity)
            position = position + velocity * obs.dt
        return commands

    def values(self, scene: Scene, commands: Float[np.ndarray, "world action 2"]) -> Float[np.ndarray, "world action"]:
        """What each command is worth, in chunks of commands, so that memory does not grow with worlds or modes."""
        worlds, actions = commands.shape[:2]
        flat, world = commands.reshape(-1, 2), np.repeat(np.arange(worlds), actions)
        values = np.empty(worlds * actions)
        modes, pedestrians = scene.crowd.shape[1:3]
        chunk = max(1, CHUNK // (modes * max(pedestrians, 1)))
        for start in range(0, len(flat), chunk):
            rows = slice(start, start + chunk)
            values[rows] = self._row_values(scene, flat[rows], world[rows])
        return values.reshape(worlds, actions)

    def _row_values(
        self, scene: Scene, commands: Float[np.ndarray, "row 2"], world: Int[np.ndarray, "row"]
    ) -> Float[np.ndarray, "row"]:
        outlook = look(scene, commands, world)
        now = self.reward(outlook.outcome, outlook.gap, scene.dt)
        factor = discount(scene.preferred_speed, scene.dt)[world, None]
        later = _evaluate(self.value, outlook.joint, _rows_present(scene, world, outlook.joint.shape))[0]
        return self.aggregate(now + np.where(outlook.outcome == Outcome.RUNNING, factor * later, 0.0))

    def _best(self, scene: Scene, velocity: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world 2"]:
        command, value = self._best_of(scene, velocity, self.actions(scene.preferred_speed))
        if self.explore is not None:
            near = self.explore(command, scene.preferred_speed)
            refined, refined_value = self._best_of(scene, velocity, near)
            command = np.where((refined_value > value)[:, None], refined, command)
            value = np.maximum(value, refined_value)
        # Only where no command is allowed is the best of them worth nothing at all.
        return np.where(np.isneginf(value)[:, None], velocity, command)

    def _best_of(
        self, scene: Scene, velocity: Float[np.ndarray, "world 2"], commands: Float[np.ndarray, "world action 2"]
    ) -> tuple[Float[np.ndarray, "world 2"], Float[np.ndarray, "world"]]:
        values = self.values(scene, commands)
        if self.limits is not None:
            values = np.where(self.limits(velocity, commands), values, -np.inf)
        world, best = np.arange(len(values)), values.argmax(axis=1)
        return commands[world, best], values[world, best]

    def _log(
        self, obs: Observation, prediction: Prediction, scene: Scene, command: Float[np.ndarray, "world 2"]
    ) -> None:
        """Show the predicted crowd, the value of the command, and whom the network attends to."""
        if obs.record is None:
            return
        world = np.arange(len(obs))
        joint = look(scene, command, world).joint
        value, attention = _evaluate(self.value, joint, _rows_present(scene, world, joint.shape))
        pedestrians = obs.pedestrians.present.shape[1]
        obs.log("predicted", prediction.position)
        obs.log("value", value.mean(axis=1))
        obs.log("attention", attention.mean(axis=1)[:, :pedestrians])


def scene_of(obs: Observation, prediction: Prediction, step: int, position: Float[np.ndarray, "world 2"]) -> Scene:
    """The scene before one step of a prediction, with the vehicle at `position`."""
    after = prediction.position[:, :, step]
    before = prediction.position[:, :, step - 1] if step else obs.pedestrians.position[:, None]
    return Scene(
        position=position,
        goal=obs.vehicle.goal,
        radius=obs.vehicle.radius,
        preferred_speed=obs.vehicle.preferred_speed,
        crowd=np.broadcast_to(before, after.shape),
        next_crowd=after,
        next_velocity=prediction.velocity[:, :, step],
        crowd_radius=obs.pedestrians.radius,
        present=obs.pedestrians.present,
        dt=obs.dt,
    )


def _rows_present(
    scene: Scene, world: Int[np.ndarray, "row"], shape: tuple[int, ...]
) -> Bool[np.ndarray, "row mode pedestrian"]:
    """Who is present in each row; the joint states have a place for a pedestrian even where there are none."""
    present = np.zeros(shape[:3], bool)
    present[..., : scene.present.shape[1]] = scene.present[world][:, None]
    return present


@torch.inference_mode()
def _evaluate(
    network: ValueNetwork,
    joint: Float[np.ndarray, "*batch pedestrian 13"],
    present: Bool[np.ndarray, "*batch pedestrian"],
) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch pedestrian"]]:
    """A network's values and attention as float64."""
    device = next(network.parameters()).device
    value, attention = network.attend(torch.from_numpy(joint).to(device), torch.from_numpy(present).to(device))
    return value.double().cpu().numpy(), attention.double().cpu().numpy()
