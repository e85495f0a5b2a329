"""The state of a training on disk: one safetensors file, written whole, from which training goes on bit for bit."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor, nn

from crowdbench.utils.errors import InputError, describe_error
from crowdbench.utils.files import whole


@dataclass(frozen=True)
class State:
    """The state of a training.

    Attributes:
        tensors: Networks, optimizers and other arrays by name; the name of a part comes first, then a dot.
        facts: Counters and other numbers by name.
        curve: The points of the training curve: dataclasses, or dictionaries where the state was read from a file.
    """

    tensors: Mapping[str, Tensor]
    facts: Mapping[str, Any]
    curve: Sequence[Any]


def save(state: State, path: Path, about: Mapping[str, Any]) -> None:
    """Write a checkpoint.

    Args:
        state: The state of the training.
        path: The file.
        about: The request of the training, as JSON.

    Raises:
        OSError: The file cannot be written. An earlier checkpoint stays as it is.
    """
    curve = [dataclasses.asdict(point) for point in state.curve]
    facts = {"about": dict(about), "facts": dict(state.facts), "curve": curve}
    content = to_bytes(dict(state.tensors), metadata={"training": json.dumps(facts)})
    with whole(path) as partial:
        partial.write_bytes(content)


def read_about(path: Path) -> dict[str, Any]:
    """The request in a checkpoint, as JSON. Raises InputError where it is not one."""
    return _metadata(path)["about"]


def read(path: Path) -> State:
    """The state in a checkpoint. Raises InputError where it is not one, or has a number that is not finite."""
    written = _metadata(path)
    with safe_open(path, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no dict)
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise InputError(f"the checkpoint {path} is damaged: {name} has numbers that are not finite")
    return State(tensors, written["facts"], written["curve"])


def tensors_of(part: str, network: nn.Module) -> dict[str, Tensor]:
    """A network's tensors, to be written: their names with the part's in front."""
    return {f"{part}.{name}": tensor.contiguous() for name, tensor in network.state_dict().items()}


def optimizer_state(part: str, optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """An optimizer's tensors, to be written: their names with the part's in front."""
    states = optimizer.state_dict()["state"].items()
    return {f"{part}.{number}.{name}": tensor for number, state in states for name, tensor in state.items()}


def part_of(part: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors of one part of a training, from those of its checkpoint: their names without the part's."""
    return {name.removeprefix(f"{part}."): tensor for name, tensor in tensors.items() if name.startswith(f"{part}.")}


def restore_optimizer(optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """Give an optimizer the tensors that `optimizer_state` took from it, as `part_of` returns them."""
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        number, _, key = name.partition(".")
        state.setdefault(int(number), {})[key] = tensor
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def parts_state(training: object, parts: Sequence[str]) -> dict[str, Tensor]:
    """The tensors of the networks and optimizers that are attributes of a training, to be written."""
    tensors: dict[str, Tensor] = {}
    for part in parts:
        value = getattr(training, part)
        tensors |= tensors_of(part, value) if isinstance(value, nn.Module) else optimizer_state(part, value)
    return tensors


def restore_parts(training: object, parts: Sequence[str], tensors: Mapping[str, Tensor]) -> None:
    """Give these parts the tensors of a checkpoint. Raises RuntimeError where they are of another network."""
    for part in parts:
        value, own = getattr(training, part), part_of(part, tensors)
        if isinstance(value, nn.Module):
            value.load_state_dict(own)
        else:
            restore_optimizer(value, own)


def rename_tensors(tensors: Mapping[str, Tensor], names: Mapping[str, str]) -> dict[str, Tensor]:
    """Tensors of an older checkpoint under their present names.

    Args:
        tensors: The tensors by name.
        names: The present name by the former one, each of a part of the training or of something in it.

    Returns:
        The same tensors; whatever `names` does not mention keeps its name.
    """
    found = {}
    for name, tensor in tensors.items():
        former = next((each for each in names if name == each or name.startswith(f"{each}.")), None)
        found[name if former is None else names[former] + name.removeprefix(former)] = tensor
    return found


def _metadata(path: Path) -> dict[str, Any]:
    """What a checkpoint says of its training: `about`, `facts` and `curve`."""
    try:
        with safe_open(path, "pt") as file:
            written = json.loads((file.metadata() or {})["training"])
    except (SafetensorError, OSError, KeyError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is not a checkpoint of a training: {describe_error(error)}") from None
    kinds = {"about": dict, "facts": dict, "curve": list}
    if not (isinstance(written, dict) and all(isinstance(written.get(key), kind) for key, kind in kinds.items())):
        raise InputError(f"{path} is not a checkpoint of a training: it must have {', '.join(kinds)}")
    return written
