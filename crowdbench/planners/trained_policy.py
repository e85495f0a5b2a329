"""Policies, which are planners without lookahead: a network maps observations of the vehicle to velocities."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from crowdbench.core.types import Observation
from crowdbench.networks.chunks import CHUNK, in_chunks
from crowdbench.networks.encoders import POLICIES, make_policy
from crowdbench.networks.features import Features, Vectors, clip_to_disc, direction, features, to_world
from crowdbench.networks.features_ahead import RAYS, REACH, STEPS, features_ahead
from crowdbench.networks.policy import Policy, Seen
from crowdbench.networks.weights import load_into, read_card, training_dt, weights_digest, weights_file
from crowdbench.planners.planner import Planner
from crowdbench.planners.reactive import along_walls
from crowdbench.planners.scan_interface import ScanInterface
from crowdbench.plugins.kind import file_and_function
from crowdbench.plugins.plugin_files import read_files
from crowdbench.predict.predictor import Predictor, predict
from crowdbench.predict.predictors import load_predictor
from crowdbench.sim.lidar import wall_distances
from crowdbench.utils.errors import InputError, is_integer


@dataclass(frozen=True)
class PolicyInterface:
    """Features that a policy observes, and the meaning of its actions.

    A policy with a memory observes predicted positions of pedestrians, walls, and the vehicle's motion; others observe
    the present. Actions are velocities in the frame of the goal, which wheeled vehicles follow as closely as possible.

    Attributes:
        nearest: Largest number of pedestrians that it observes: the nearest ones.
        predictor: Predicts the pedestrians; None for a policy without a memory.
    """

    nearest: int
    predictor: Predictor | None = None

    def __call__(self, obs: Observation) -> Features:
        """Return the input of the policy for an observation."""
        if self.predictor is None:
            return features(obs, self.nearest)
        position, ahead = obs.vehicle.position, predict(self.predictor, obs, STEPS).position[:, 0]
        walls = wall_distances(position, direction(position, obs.vehicle.local_goal), obs.obstacles, RAYS, REACH)
        return features_ahead(obs, self.nearest, ahead, walls)

    def velocities(self, action: Vectors, obs: Observation, axis: Vectors) -> Vectors:
        """Convert actions to velocities in m/s, corrected along walls.

        Args:
            action: The actions of a policy.
            obs: The observation.
            axis: The direction of the goal, as in `Features`.
        """
        return along_walls(obs, to_world(clip_to_disc(action, obs.vehicle.preferred_speed), axis))  # same direction

    def reset(self, rows: np.ndarray) -> None:
        """Do nothing: an input depends on one observation alone. See `Planner.reset`."""

    def forget(self, rows: np.ndarray) -> None:
        """Do nothing, as `reset`."""


@dataclass(eq=False)
class NetworkPlanner(Planner):
    """Planner that drives with the mean action of a policy: no lookahead, no randomness.

    Attributes:
        policy: The trained network.
        interface: Its observation and its actions.
        network: The name of the network.
        trained_pedestrians: The largest number of pedestrians that it was trained with; None if that is unknown.
        trained_dt: The length of a step in seconds that it was trained with; None if that is unknown.
    """

    policy: Policy
    interface: PolicyInterface | ScanInterface
    network: str = "ppo"
    trained_pedestrians: int | None = None
    trained_dt: float | None = None

    def __post_init__(self) -> None:
        self.policy.eval()
        predictor = self.interface.predictor
        self.privileged = predictor is not None and predictor.privileged
        of_predictor = {} if predictor is None else predictor.facts
        self.facts = {**of_predictor, "network": self.network, "weights": weights_digest(self.policy)}
        self.reset(np.arange(0))

    def for_held_out_scene(self, scene: str) -> NetworkPlanner:
        """See `Planner`."""
        if self.interface.predictor is None:
            return self
        interface = dataclasses.replace(self.interface, predictor=self.interface.predictor.for_held_out_scene(scene))
        return dataclasses.replace(self, interface=interface)

    def reset(self, rows: np.ndarray) -> None:
        """See `Planner`."""
        self.memory = self.policy.initial_memory(len(rows))
        self.interface.reset(rows)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        shown = self.interface(obs)
        seen = Seen.of(shown, self.memory.device)
        action, row = np.empty((len(obs), 2)), torch.from_numpy(obs.row)
        if len(self.memory) <= row.max():  # called without a reset
            self.memory = self.policy.initial_memory(int(row.max()) + 1)
        before = self.memory[row]

        def fill(part: slice) -> None:
            with torch.inference_mode():
                mean, memory = self.policy(Seen(*(tensor[part] for tensor in seen)), before[part])
                action[part] = mean.double().cpu().numpy()
                before[part] = memory

        in_chunks(fill, len(obs), CHUNK)
        self.memory[row] = before
        return self.interface.velocities(action, obs, shown.axis)


def load_policy(
    weights: str, device: str = "cpu", predictor: str = "constant_velocity", encoder: str | None = None
) -> NetworkPlanner:
    """Return a planner with a trained policy.

    Args:
        weights: The name of built-in weights, or a file.
        device: `cpu` or `cuda`.
        predictor: Predictor of the pedestrians for a policy with a memory: a name or a file.
        encoder: The file of the encoder that the policy was trained with; None for the network's default encoder.

    Returns:
        The planner.

    Raises:
        InputError: The weights are missing, altered or belong to no policy, the encoder is not the one that they were
            trained with, or there is no such predictor.
    """
    path = weights_file(weights)
    card = read_card(path)
    network, training = card["network"] if card["network"] in POLICIES else "ppo", card.get("training", {})
    policy = make_policy(network, encoder)
    _check_encoder(path, training.get("encoder_files"), encoder)
    load_into(policy, network, path, device)
    interface: PolicyInterface | ScanInterface = ScanInterface()
    if network != "ppo_lidar":
        nearest = training.get("nearest")
        if not is_integer(nearest) or nearest < 1:
            raise InputError(f"the card of the weights {path} does not say how many pedestrians the policy is shown")
        interface = PolicyInterface(int(nearest), load_predictor(predictor) if policy.remembered else None)
    return NetworkPlanner(policy, interface, network, _most_pedestrians(training), training_dt(card))


def _check_encoder(weights: Path, trained: object, encoder: str | None) -> None:
    """Raise InputError unless the files of an encoder have the digests in the card of the weights."""
    file, _ = file_and_function(encoder or "")
    given = None if file is None else read_files(file)
    if given != trained:
        right = f"with the encoder {', '.join(trained)}" if isinstance(trained, dict) else "without an encoder file"
        raise InputError(f"the weights {weights} were trained {right}: the option encoder must be the same")


def _most_pedestrians(training: Mapping[str, Any]) -> int | None:
    """Return the largest number of pedestrians in the training according to a card; None if the card has no number."""
    try:
        numbers = [each["pedestrians"]["number"] for each in (training["scenario"], *training.get("beside", []))]
    except (KeyError, TypeError):
        return None
    most = [number[-1] if isinstance(number, list) and number else number for number in numbers]
    return max(most) if all(map(is_integer, most)) else None
