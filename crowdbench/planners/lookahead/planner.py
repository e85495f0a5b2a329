"""The planner that looks one step ahead: predict the crowd, try every command, value what it leads to."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from crowdbench.errors import InputError
from crowdbench.geometry import norm
from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead.actions import speeds_and_headings
from crowdbench.planners.lookahead.aggregate import MEAN, Aggregate, mean_future
from crowdbench.planners.lookahead.chunks import in_chunks
from crowdbench.planners.lookahead.kce import Limits
from crowdbench.planners.lookahead.outlook import Scene, look
from crowdbench.predict import Prediction, Predictor
from crowdbench.reward import discount, reward
from crowdbench.toml_section import is_integer
from crowdbench.types import Observation, Outcome, Vehicle
from crowdbench.value.networks import ValueNetwork
from crowdbench.weights.store import digest

CHUNK = 4096
"""Joint states that a network is given at once: few enough for its layers to stay in a core's cache."""

Actions = Callable[[Float[np.ndarray, "world"]], Float[np.ndarray, "world action 2"]]
Reward = Callable[
    [Int[np.ndarray, "*batch"], Float[np.ndarray, "*batch"], float],
    Float[np.ndarray, "*batch"],
]
Shaping = Callable[
    [Int[np.ndarray, "row mode"], Float[np.ndarray, "row mode"], Float[np.ndarray, "row"]],
    Float[np.ndarray, "row mode"],
]
Explore = Callable[[Scene, Float[np.ndarray, "world 2"]], Float[np.ndarray, "world action 2"]]


class ValuePlanner(Planner):
    """Takes the command with the largest reward of the next step plus discounted value of the state after it.

    The next step's crowd is the `predictor`'s, and `value` is the network. `actions` gives the commands for a
    preferred speed, `reward` is a function like `crowdbench.reward.reward`, to which `shaping(outcome, gap, change)`
    adds what a change of velocity is worth, and `aggregate` makes one value of a command's values under all predicted
    futures. `limits` says which commands the vehicle can follow; braking as hard as they allow is one more command
    then, so that there always is one. `explore(scene, command)` gives further commands around the best one, which is
    taken if none of them is better.

    With a `shortlist`, only so many commands are valued under all futures: those that are best under the mean of
    them. It changes nothing where there is one future. Raises InputError where it is no number to count with.
    """

    def __init__(
        self,
        predictor: Predictor,
        value: ValueNetwork,
        actions: Actions = speeds_and_headings,
        reward: Reward = reward,
        shaping: Shaping | None = None,
        aggregate: Aggregate = MEAN,
        limits: Limits | None = None,
        explore: Explore | None = None,
        shortlist: int | None = None,
    ) -> None:
        if shortlist is not None and not (is_integer(shortlist) and shortlist >= 1):
            raise InputError(f"shortlist is {shortlist!r}, but must be a whole number, 1 or more")
        self.privileged = predictor.privileged
        self.predictor = predictor
        self.value = value.eval()
        self.actions = actions
        self.reward = reward
        self.shaping = shaping
        self.aggregate = aggregate
        self.limits = limits
        self.explore = explore
        self.shortlist = shortlist
        self.facts = {"network": value.name, "weights": digest(value), **predictor.facts}

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        return self.plan_ahead(obs, 1)[:, 0]

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """See `Planner`. There is one prediction, in which each mode goes on by itself from step to step."""
        prediction = self.predictor.predict(obs, steps)
        commands = np.empty((len(obs), steps, 2))
        vehicle = obs.vehicle
        for step in range(steps):
            scene = scene_of(obs, prediction, step, vehicle)
            command = commands[:, step] = self._best(scene)
            if step == 0:
                self._log(obs, prediction, scene, command)
            vehicle = dataclasses.replace(vehicle, position=vehicle.position + command * obs.dt, velocity=command)
        return commands

    def values(self, scene: Scene, commands: Float[np.ndarray, "world action 2"]) -> Float[np.ndarray, "world action"]:
        """What each command is worth, in chunks of commands, so that memory does not grow with worlds or modes."""
        scene = self.aggregate.shown(scene)
        worlds, actions = commands.shape[:2]
        flat, world = commands.reshape(-1, 2), np.repeat(np.arange(worlds), actions)
        values = np.empty(worlds * actions)
        modes, pedestrians = scene.crowd.shape[1:3]

        def fill(rows: slice) -> None:
            values[rows] = self._row_values(scene, flat[rows], world[rows])

        in_chunks(fill, len(flat), max(1, CHUNK // (modes * max(pedestrians, 1))))
        return values.reshape(worlds, actions)

    def _row_values(
        self, scene: Scene, commands: Float[np.ndarray, "row 2"], world: Int[np.ndarray, "row"]
    ) -> Float[np.ndarray, "row"]:
        outlook = look(scene, commands, world)
        now = self.reward(outlook.outcome, outlook.gap, scene.dt)
        if self.shaping is not None:
            now = now + self.shaping(outlook.outcome, outlook.gap, norm(commands - scene.velocity[world]))
        factor = discount(scene.preferred_speed, scene.dt)[world, None]
        later = _evaluate(self.value, outlook.joint, _rows_present(scene, world, outlook.joint.shape))[0]
        return self.aggregate.over_modes(now + np.where(outlook.outcome == Outcome.RUNNING, factor * later, 0.0))

    def _best(self, scene: Scene) -> Float[np.ndarray, "world 2"]:
        commands = self.actions(scene.preferred_speed)
        if self.limits is not None:
            commands = np.concatenate([commands, self.limits.brake(scene)[:, None]], axis=1)
        command, value = self._best_of(scene, commands)
        if self.explore is not None:
            refined, refined_value = self._best_of(scene, self.explore(scene, command))
            command = np.where((refined_value > value)[:, None], refined, command)
        return command

    def _best_of(
        self, scene: Scene, commands: Float[np.ndarray, "world action 2"]
    ) -> tuple[Float[np.ndarray, "world 2"], Float[np.ndarray, "world"]]:
        if self.shortlist is not None and self.shortlist < commands.shape[1] and scene.crowd.shape[1] > 1:
            loss = -self._allowed_values(mean_future(scene), commands)
            # In their order again, which decides between equals.
            kept = np.sort(loss.argsort(axis=1, kind="stable")[:, : self.shortlist], axis=1)
            commands = np.take_along_axis(commands, kept[..., None], axis=1)
        values = self._allowed_values(scene, commands)
        world, best = np.arange(len(values)), values.argmax(axis=1)
        return commands[world, best], values[world, best]

    def _allowed_values(
        self, scene: Scene, commands: Float[np.ndarray, "world action 2"]
    ) -> Float[np.ndarray, "world action"]:
        values = self.values(scene, commands)
        return values if self.limits is None else np.where(self.limits.allow(scene, commands), values, -np.inf)

    def _log(
        self, obs: Observation, prediction: Prediction, scene: Scene, command: Float[np.ndarray, "world 2"]
    ) -> None:
        """Show the predicted crowd, the value of the command, and whom the network attends to."""
        if obs.record is None:
            return
        world, shown = np.arange(len(obs)), self.aggregate.shown(scene)
        joint = look(shown, command, world).joint
        value, attention = _evaluate(self.value, joint, _rows_present(shown, world, joint.shape))
        # To a pedestrian goes what all of its futures get.
        attention = attention[..., : shown.present.shape[1]].reshape(len(obs), *scene.crowd.shape[1:3])
        obs.log("predicted", prediction.position)
        obs.log("value", value.mean(axis=1))
        obs.log("attention", attention.sum(axis=1) / value.shape[1])


def scene_of(obs: Observation, prediction: Prediction, step: int, vehicle: Vehicle) -> Scene:
    """The scene before one step of a prediction, with the `vehicle` as it is then."""
    after = prediction.position[:, :, step]
    before = prediction.position[:, :, step - 1] if step else obs.pedestrians.position[:, None]
    return Scene(
        position=vehicle.position,
        velocity=vehicle.velocity,
        goal=vehicle.goal,
        radius=vehicle.radius,
        preferred_speed=vehicle.preferred_speed,
        # In one layout, whatever the prediction's: each compiles the look ahead anew.
        crowd=np.broadcast_to(before, after.shape).copy(),
        next_crowd=np.ascontiguousarray(after),
        next_velocity=np.ascontiguousarray(prediction.velocity[:, :, step]),
        crowd_radius=obs.pedestrians.radius,
        present=obs.pedestrians.seen,
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
