"""Exports trained policies of stable-baselines3 and of torch as ONNX files for `crowdbench run --planner`."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from crowdbench.planners.onnx_policy import METADATA, STATE
from crowdbench.utils.errors import InputError, plugin_errors
from crowdbench.views.view import KEYS

EXAMPLES = 3
"""Number of worlds in the traced example. With one world, the exporter treats the batch axis as a constant."""


def export_policy(model: Any, file: str | Path, env: Any, state: Sequence[tuple[int, ...]] = ()) -> None:
    """Write the mean action of a policy as an ONNX file for `crowdbench run --planner policy.onnx`.

    The graph takes and returns float32. It contains the running normalisation of observations, if a wrapper has one,
    and squashing. The metadata contain the observation of the policy, its actions, and the scenario in which it was
    trained. Needs `pip install 'crowdbench[onnx]'`.

    Args:
        model: A model of stable-baselines3 or sb3-contrib with an actor (PPO, A2C, SAC, TD3, RecurrentPPO, ...), or a
            torch module that maps observations, `[world, features]` or a dictionary, to actions `[world, 2]`.
        file: The file to write.
        env: Its training environment with all wrappers: `CrowdVecEnv`, `crowdbench/Vehicle-v0`, or a vector of these.
            Include the `VecNormalize` of the training: a model that is loaded without it is exported without it.
        state: The shapes of the memory arrays of a recurrent module for one world. The module is called as
            `module(observed, *state)` and returns `(action, *state)`.

    Raises:
        InputError: The environment is not from crowdbench, the model is of another kind or was trained with other
            observations or actions, or a package is missing.
    """
    layers = [*_layers(env), *_layers(getattr(model, "env", None))]
    view: Any = next((layer.view for layer in layers if hasattr(layer, "view")), None)
    if view is None:
        raise InputError(f"env is a {type(env).__name__}, but must be crowdbench/Vehicle-v0 or CrowdVecEnv, or wrap it")
    module = model
    if policy := getattr(model, "policy", None):
        if model.action_space != view.action_space:
            raise InputError("the model has other actions than env: wrappers that change actions are not exported")
        module = _MeanAction(policy)
        if lstm := getattr(policy, "lstm_actor", None):
            state = [(lstm.num_layers, lstm.hidden_size)] * 2
    space = view.observation_space
    observations = {key: space[key] for key in KEYS if key in getattr(space, "spaces", ())} or {"observation": space}
    shapes = {key: observation.shape or () for key, observation in observations.items()}
    memory = {f"{STATE}_{number}": shape for number, shape in enumerate(state)}
    with warnings.catch_warnings(), plugin_errors("the policy cannot be exported (is crowdbench[onnx] installed?):"):
        warnings.simplefilter("ignore")  # the exporter's own deprecations
        is_training = module.training
        device = next((parameter.device for parameter in module.parameters()), torch.device("cpu"))
        normalisers = (
            layer for layer in layers if getattr(layer, "obs_rms", None) and getattr(layer, "norm_obs", True)
        )
        network = _Normalised(module, list(observations), next(normalisers, None), device).eval()
        program = _trace(network, shapes | memory, ["action", *(f"next_{name}" for name in memory)], device)
        program.model.metadata_props[METADATA] = json.dumps(_metadata(view))
        program.save(file, external_data=False)
        module.train(is_training)


def _trace(network: nn.Module, shapes: Mapping[str, tuple[int, ...]], outputs: list[str], device: torch.device) -> Any:
    """Return a network as an ONNX program.

    Args:
        network: The network.
        shapes: The shape of each input for one world, by name.
        outputs: The names of the outputs.
        device: The device of the network.
    """
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns that torchvision is missing
    example = tuple(torch.zeros(EXAMPLES, *shape, device=device) for shape in shapes.values())
    network(*example)  # its errors are shorter than the errors of the exporter
    batch_axes = (tuple({0: torch.export.Dim("world")} for _ in shapes),)
    return torch.onnx.export(
        network,
        example,
        input_names=list(shapes),
        output_names=outputs,
        dynamic_shapes=batch_axes,
        dynamo=True,
        verbose=False,
    )


def _metadata(view: Any) -> dict[str, Any]:
    """Return the metadata of the file: observation, actions, and the scenario of the training."""
    scenario = view.scenario
    return {
        **{name: getattr(view, name) for name in ("observation", "action", "nearest", "rays")},
        "scenario": scenario.name,
        "dynamics": scenario.rules.dynamics.name,
        "dt": scenario.rules.dt,
        "pedestrians": scenario.max_agents - 1,
    }


def _layers(env: Any) -> Iterator[Any]:
    """Yield an environment and the environments that it wraps; of a vector of environments, only the first."""
    while env is not None:
        yield env
        env = getattr(env, "venv", None) or getattr(env, "env", None) or next(iter(getattr(env, "envs", ())), None)


class _Normalised(nn.Module):
    """A policy with the normalisation of its observations. Its inputs are the observations, then the state.

    Args:
        policy: The policy.
        keys: The names of the observations, which the policy takes as a dictionary if there are several.
        layer: The wrapper that normalises them; None without one.
        device: The device of the policy.
    """

    def __init__(self, policy: nn.Module, keys: list[str], layer: Any, device: Any) -> None:
        super().__init__()
        self.policy, self.keys = policy, keys
        self.statistics: dict[str, tuple[Tensor, Tensor, float]] = {}
        running = getattr(layer, "obs_rms", {})
        if not isinstance(running, dict):
            running = {keys[0]: running}
        for key, moments in running.items():
            mean_and_deviation = np.stack([moments.mean, np.sqrt(moments.var + layer.epsilon)])
            mean, deviation = torch.as_tensor(mean_and_deviation, dtype=torch.float32, device=device)
            self.statistics[key] = mean, deviation, getattr(layer, "clip_obs", np.inf)

    def forward(self, *arrays: Tensor) -> Any:
        observed = dict(zip(self.keys, arrays, strict=False))
        for key, (mean, deviation, most) in self.statistics.items():
            observed[key] = torch.clamp((observed[key] - mean) / deviation, -most, most)
        return self.policy(observed if len(self.keys) > 1 else observed[self.keys[0]], *arrays[len(observed) :])


class _MeanAction(nn.Module):
    """The mean action of a policy of stable-baselines3. Its `_predict` makes a distribution, which is not exported."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy = policy
        bounds = np.stack([policy.action_space.low, policy.action_space.high])
        self.low, self.high = torch.as_tensor(bounds, dtype=torch.float32, device=policy.device)

    def forward(self, observed: Any, *state: Tensor) -> Any:
        policy = self.policy
        if hasattr(policy, "actor"):  # SAC and TD3, whose actions are within -1 and 1
            squashed = getattr(policy.actor, "get_action_dist_params", None)
            action = torch.tanh(squashed(observed)[0]) if squashed else policy.actor(observed)
        else:
            features = policy.extract_features(observed)
            features = features[0] if isinstance(features, tuple) else features  # the others are the critic's
            if state:
                # The state is [world, layer, unit], but [layer, world, unit] in the LSTM, whose sequence has one step.
                hidden = tuple(array.transpose(0, 1).contiguous() for array in state)
                sequence, hidden = policy.lstm_actor(features[None], hidden)
                features, state = sequence[0], tuple(array.transpose(0, 1) for array in hidden)
            action = policy.action_net(policy.mlp_extractor.forward_actor(features))
            action = torch.tanh(action) if policy.squash_output else action
        if policy.squash_output:
            action = self.low + 0.5 * (action + 1.0) * (self.high - self.low)
        return (action, *state) if state else action
