"""Planner of a network of CrowdNav++ (Liu et al. 2023), from your clone of its code and weights.

    git clone https://github.com/Shuijing725/CrowdNav_Prediction_AttnGraph
    crowdbench run --planner adapters/crowdnav_plus/crowdnav_plus.py --option clone=CrowdNav_Prediction_AttnGraph \\
        --scenario crowdnav_plus_20 --isolated

Run it in a separate process (`--isolated`): its code imports modules named `rl` and `arguments`, which may be other
modules in `sys.modules`.

Its evaluation calls `network.act(inputs, memory, masks, deterministic=True)` with the observed positions of 20
pedestrians, and their predicted positions in the next five steps. `act` returns a velocity.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Bool, Float, Int
from numpy._core.multiarray import scalar
from torch import Tensor

from crowdbench import InputError, Observation, Planner
from crowdbench.networks import clip_to_disc, weights_digest

SOURCE = "https://github.com/Shuijing725/CrowdNav_Prediction_AttnGraph"

CODE = ("rl/networks/model.py", "gst_updated/scripts/wrapper/crowd_nav_interface_parallel.py")
"""The files of CrowdNav++ that are imported."""

STEPS = 5
"""Number of predicted steps, and of observed positions in the input of a predictor."""

AWAY = 15.0
"""Offset in metres from the robot, along both axes, of a pedestrian that is not seen."""

UNKNOWN = -999.0
"""Coordinates before the first observation, in the input of the predictor."""

CHECKPOINTS = {"GST_predictor_non_rand": "41200.pt", "GST_predictor_rand": "41665.pt"}
"""The weights of each trained model."""


class Settings(pickle.Unpickler):
    """Unpickler of the predictor's settings, an `argparse.Namespace`, that rejects all other classes."""

    def find_class(self, module: str, name: str) -> type:
        """Return the class of settings. Raises UnpicklingError for another class."""
        if (module, name) != ("argparse", "Namespace"):
            raise pickle.UnpicklingError(f"{module}.{name} is no setting")
        return argparse.Namespace


def planner(clone: str = "CrowdNav_Prediction_AttnGraph", model: str = "GST_predictor_non_rand") -> CrowdNavPlusPlanner:
    """Make the planner.

    Args:
        clone: Your clone of CrowdNav++.
        model: One of its trained models: GST_predictor_non_rand (identical pedestrians) or GST_predictor_rand (random).

    Returns:
        The planner.

    Raises:
        InputError: The clone lacks a file, or a file has no weights of the model.
    """
    root = Path(clone).resolve()
    if model not in CHECKPOINTS:
        raise InputError(f"CrowdNav++ has no trained model {model!r}, but {', '.join(CHECKPOINTS)}")
    trained = root / "trained_models" / model
    weights = trained / "checkpoints" / CHECKPOINTS[model]
    needed = [root / file for file in CODE] + [trained / "arguments.py", trained / "configs" / "config.py", weights]
    missing = [str(file.relative_to(root)) for file in needed if not file.is_file()]
    if missing:
        raise InputError(
            f"{clone} is no complete clone of CrowdNav++, because it has no {', no '.join(missing)}: "
            f"git clone {SOURCE}, or give --option clone=DIR"
        )
    # Only the environments of CrowdNav++ need gym, baselines and rvo2, which can no longer be installed.
    environments = ModuleType("rl.networks.envs")
    vars(environments)["VecNormalize"] = None
    sys.modules["rl.networks.envs"] = environments
    sys.path.insert(0, str(root))
    policy = importlib.import_module("rl.networks.model").Policy
    interface = importlib.import_module("gst_updated.scripts.wrapper.crowd_nav_interface_parallel")
    given, sys.argv = sys.argv, [""]  # its arguments are read from the command line
    try:
        arguments = importlib.import_module(f"trained_models.{model}.arguments").get_args()
        config = importlib.import_module(f"trained_models.{model}.configs.config").Config
    finally:
        sys.argv = given
    try:
        state = torch.load(weights, map_location="cpu", weights_only=True)
        inputs = state["base.spatial_attn.embedding_layer.0.weight"].shape[1]
    except Exception:  # torch raises many kinds of exceptions, and advises against `weights_only`
        raise InputError(f"{weights} cannot be read, or holds something other than weights of {model}") from None
    # `env_name` selects the input of a network, and the saved arguments need not have the value of the training.
    arguments.env_name = "CrowdSimPred-v0" if inputs > 2 else "CrowdSimVarNum-v0"
    arguments.no_cuda, arguments.num_processes = True, 1
    people = config.sim.human_num + config.sim.human_num_range
    spaces = {"spatial_edges": SimpleNamespace(shape=(people, 2 * (config.sim.predict_steps + 1)))}
    network = policy(spaces, Box(-1.0, 1.0, (2,)), base=config.robot.policy, base_kwargs=arguments)
    with _described(f"{weights} has no weights of {model}"):
        network.load_state_dict(state)
    folder = root / config.pred.model_dir
    with _described(f"{folder} has no predictor"), (folder / "checkpoint" / "args.pickle").open("rb") as file:
        settings = Settings(file).load()
    # The file of the predictor's weights also contains losses, which are NumPy scalars.
    kinds = [type(np.dtype(kind)) for kind in (np.float32, np.float64)]
    harmless: list[Any] = [(scalar, "numpy.core.multiarray.scalar"), np.dtype, *kinds]
    with _described(f"{folder} has no predictor"), torch.serialization.safe_globals(harmless):
        predictor = interface.CrowdNavPredInterfaceMultiEnv(str(folder), "cpu", settings, 1)
    return CrowdNavPlusPlanner(network, predictor)


@contextlib.contextmanager
def _described(sentence: str) -> Iterator[None]:
    """Turn any error into an InputError: a sentence and the reason, in one line."""
    try:
        yield
    except Exception as error:  # pickle and torch raise many kinds
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{sentence}: {reason}") from None


class CrowdNavPlusPlanner(Planner):
    """Planner of a network of CrowdNav++, for all worlds at once.

    The input has the positions of the pedestrians that are seen in this step. The robot's heading is always pi/2.

    Args:
        network: Its `Policy`, with the weights loaded: `rl/networks/model.py`.
        predictor: Its predictor: `gst_updated/scripts/wrapper/crowd_nav_interface_parallel.py`; without it
            pedestrians keep their velocities.

    Raises:
        InputError: `network` is not a network of CrowdNav++. While it drives: there are more pedestrians than it takes.
    """

    def __init__(self, network: Any, predictor: Any = None) -> None:
        if not callable(getattr(network, "act", None)) or not hasattr(network, "base"):
            raise InputError(f"a network of CrowdNav++ has act and base, but this {type(network).__name__} has not")
        self.network, self.predictor = network.eval(), predictor
        self.people, self.numbers = int(network.base.human_num), int(network.base.spatial_attn.input_size)
        self.facts = {"network": type(network.base).__name__, "weights": weights_digest(network)}
        self.reset(np.arange(0))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        base, worlds = self.network.base, len(rows)
        self.memory = {
            "human_node_rnn": torch.zeros(worlds, 1, base.human_node_rnn_size),
            "human_human_edge_rnn": torch.zeros(worlds, self.people + 1, base.human_human_edge_rnn_size),
        }
        self.past = torch.full((worlds, self.people, STEPS, 2), UNKNOWN)
        self.seen = torch.zeros(worlds, self.people, STEPS, 1)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        row, vehicle = torch.from_numpy(obs.row), obs.vehicle
        theta = np.full(len(obs), np.pi / 2.0)
        parts = vehicle.position, vehicle.radius, vehicle.local_goal, vehicle.preferred_speed, theta
        edges, seen = self._edges(obs, row)
        inputs = {
            "robot_node": _tensor(np.column_stack(parts))[:, None],
            "temporal_edges": _tensor(vehicle.velocity)[:, None],
            "spatial_edges": edges[..., : self.numbers],  # the input of some networks has no predictions
            "visible_masks": seen,
            "detected_human_num": seen.sum(dim=1, keepdim=True).clamp(min=1),
        }
        memory = {name: kept[row] for name, kept in self.memory.items()}
        go_on = torch.from_numpy(obs.step > 0).float()[:, None]
        self.network.base.nenv = len(obs)
        with torch.inference_mode():
            _, action, _, after = self.network.act(inputs, memory, go_on, deterministic=True)
        for name, kept in self.memory.items():
            kept[row] = after[name]
        return clip_to_disc(action.double().numpy(), vehicle.preferred_speed)

    def _edges(
        self, obs: Observation, row: Int[Tensor, "world"]
    ) -> tuple[Float[Tensor, "world human numbers"], Bool[Tensor, "world human"]]:
        """Return present and predicted positions of pedestrians relative to the robot, the nearest first, and a mask of
        the visible ones."""
        crowd, number = obs.pedestrians, obs.pedestrians.seen.shape[1]
        if number > self.people:
            raise InputError(f"the network was made for {self.people} people, but here are {number}")
        seen = torch.zeros(len(obs), self.people, dtype=torch.bool)
        seen[:, :number] = torch.from_numpy(crowd.seen & (crowd.age < 1e-6))
        away = torch.full((len(obs), self.people, 2), AWAY)
        away[:, :number] = _tensor(crowd.position - obs.vehicle.position[:, None])
        away = torch.where(seen[..., None], away, AWAY)
        own = _tensor(obs.vehicle.position)
        self.past[row] = torch.cat([self.past[row, :, 1:], (own[:, None] + away)[:, :, None]], dim=2)
        self.seen[row] = torch.cat([self.seen[row, :, 1:], seen[..., None, None].float()], dim=2)
        ahead = away[:, :, None].repeat(1, 1, STEPS, 1)
        if self.predictor is None:
            velocity = torch.zeros_like(away)
            velocity[:, :number] = _tensor(crowd.velocity)
            moved = obs.dt * torch.arange(1, STEPS + 1)[:, None] * velocity[:, :, None]
            ahead = ahead + torch.where(seen[..., None, None], moved, 0.0)
        else:
            with torch.inference_mode():
                found, known = self.predictor.forward(self.past[row], self.seen[row])
            ahead = torch.where(known.bool()[..., None], found[..., :2] - own[:, None, None], ahead)
        edges = torch.cat([away, ahead.flatten(2)], dim=2)
        order = away.norm(dim=2).argsort(dim=1)
        return edges.gather(1, order[..., None].expand_as(edges)), seen


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(array).float()
