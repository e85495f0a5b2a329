"""The state of a training on disk: one safetensors file, written whole, from which it goes on bit for bit."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from crowdbench.errors import InputError
from crowdbench.files import whole
from crowdbench.train.replay import Steps
from crowdbench.train.value import Training, Validated

NETWORKS = ("network", "average", "best")


def save(training: Training, path: Path, about: Mapping[str, Any]) -> None:
    """Write the state of a training; `about` says what is trained and is kept beside it."""
    tensors = {
        f"{part}.{name}": tensor.contiguous()
        for part in NETWORKS
        for name, tensor in getattr(training, part).state_dict().items()
    }
    for number, state in training.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{number}.{name}": tensor for name, tensor in state.items()}
    if training.replay.steps is not None:
        kept = training.replay.steps.take(slice(0, len(training.replay)))
        tensors |= {f"replay.{name}": torch.from_numpy(array) for name, array in vars(kept).items()}
    facts = {
        "about": dict(about),
        "rounds": training.rounds,
        "seconds": training.seconds,
        "added": training.replay.added,
        "curve": [dataclasses.asdict(point) for point in training.curve],
    }
    with whole(path) as partial:
        save_file(tensors, partial, metadata={"training": json.dumps(facts)})


def read_about(path: Path) -> dict[str, Any]:
    """What a checkpoint says is trained. Raises InputError where there is none."""
    return _facts(path)["about"]


def restore(training: Training, path: Path) -> None:
    """Give a new training the state in a file. Raises InputError where it is none of this network's."""
    facts = _facts(path)
    with safe_open(path, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no dict)
    try:
        for part in NETWORKS:
            getattr(training, part).load_state_dict(_under(part, tensors))
    except RuntimeError:
        raise InputError(f"{path} is a checkpoint of another network than {training.setup.network}") from None
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in _under("optimizer", tensors).items():
        number, _, key = name.partition(".")
        state.setdefault(int(number), {})[key] = tensor
    groups = training.optimizer.state_dict()["param_groups"]
    training.optimizer.load_state_dict({"state": state, "param_groups": groups})
    if replay := _under("replay", tensors):
        training.replay.add(Steps(**{name: tensor.numpy() for name, tensor in replay.items()}))
    training.replay.added = facts["added"]
    training.rounds, training.seconds = facts["rounds"], facts["seconds"]
    training.curve = [Validated(**point) for point in facts["curve"]]


def _under(part: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(f"{part}."): tensor for name, tensor in tensors.items() if name.startswith(f"{part}.")}


def _facts(path: Path) -> dict[str, Any]:
    try:
        with safe_open(path, "pt") as file:
            return json.loads((file.metadata() or {})["training"])
    except FileNotFoundError:
        raise InputError(f"there is no checkpoint {path}: nothing can be resumed there") from None
    except (SafetensorError, KeyError, OSError) as error:
        raise InputError(f"{path} is not a checkpoint of a training: {error}") from None
