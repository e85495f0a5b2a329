"""The state of a training on disk: one safetensors file, written whole, from which it goes on bit for bit."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from crowdbench.errors import InputError
from crowdbench.files import whole


@dataclass(frozen=True)
class State:
    """What a training is made of: tensors, numbers, and its curve, whose points are dataclasses or what JSON makes."""

    tensors: Mapping[str, Tensor]
    facts: Mapping[str, Any]
    curve: Sequence[Any]


def save(state: State, path: Path, about: Mapping[str, Any]) -> None:
    """Write the state of a training; `about` says what is trained and is kept beside it."""
    curve = [dataclasses.asdict(point) for point in state.curve]
    facts = {"about": dict(about), "facts": dict(state.facts), "curve": curve}
    with whole(path) as partial:
        save_file(dict(state.tensors), partial, metadata={"training": json.dumps(facts)})


def read_about(path: Path) -> dict[str, Any]:
    """What a checkpoint says is trained. Raises InputError where there is none."""
    return _written(path)["about"]


def read(path: Path) -> State:
    """The state in a file. Raises InputError where there is none."""
    written = _written(path)
    with safe_open(path, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no dict)
    return State(tensors, written["facts"], written["curve"])


def tensors_of(part: str, network: nn.Module) -> dict[str, Tensor]:
    """A network's tensors, named as those of a part of a training."""
    return {f"{part}.{name}": tensor.contiguous() for name, tensor in network.state_dict().items()}


def optimizer_state(part: str, optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """An optimizer's tensors, named as those of a part of a training."""
    states = optimizer.state_dict()["state"].items()
    return {f"{part}.{number}.{name}": tensor for number, state in states for name, tensor in state.items()}


def restore_optimizer(optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """Give an optimizer what `optimizer_state` gave, without the name of the part."""
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        number, _, key = name.partition(".")
        state.setdefault(int(number), {})[key] = tensor
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def under(part: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors of a part of a training."""
    return {name.removeprefix(f"{part}."): tensor for name, tensor in tensors.items() if name.startswith(f"{part}.")}


def _written(path: Path) -> dict[str, Any]:
    try:
        with safe_open(path, "pt") as file:
            return json.loads((file.metadata() or {})["training"])
    except FileNotFoundError:
        raise InputError(f"there is no checkpoint {path}: nothing can be resumed there") from None
    except (SafetensorError, KeyError, OSError) as error:
        raise InputError(f"{path} is not a checkpoint of a training: {error}") from None
