"""A training on disk: its directory, which one process at a time writes to, and the checkpoint in it.

A checkpoint is one safetensors file, written whole, from which training goes on bit for bit.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from filelock import Timeout
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor, nn

from crowdbench.utils.errors import InputError, describe_error
from crowdbench.utils.files import half_written, hold_lock, whole

CHECKPOINT = "checkpoint.safetensors"
"""The state of the training. It is removed last: while it is there, the training is not finished."""

CURVE = "curve.csv"
RECORDING = "training.rrd"
WEIGHTS = "weights.safetensors"
CARDS = ("weights.json", "weights.md")

LOCK = ".lock"
"""Locked by the process that trains in the directory, and by nobody once that has been killed."""


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


def refuse_taken(directory: Path, network: str) -> None:
    """Refuse a directory for a new training, unless it is empty or left by one that was killed at once.

    Args:
        directory: The directory, which need not exist.
        network: The network that is to be trained.

    Raises:
        InputError: Something is there already.
    """
    if (directory / CHECKPOINT).exists():
        raise InputError(
            f"{directory} holds a training already: name another place with --out, or go on with what is there: "
            f"crowdbench train {network} --resume {directory}"
        )
    if directory.exists() and _holds_something(directory):
        raise InputError(f"{directory} exists already: name another place with --out")


def why_nothing_goes_on(directory: Path) -> str:
    """Why there is no checkpoint in a directory, and what to do."""
    if not directory.is_dir():
        return f"there is no directory {directory}: name the one of a training with --resume"
    if (directory / WEIGHTS).exists():
        return f"the training in {directory} is finished: its weights are {directory / WEIGHTS}"
    if _holds_something(directory):
        return f"there is no checkpoint {directory / CHECKPOINT}: nothing can be resumed there"
    return (
        f"the training in {directory} was stopped before its first checkpoint, and nothing was kept: start it again "
        f"with --out {directory} and the options that it had"
    )


def remove(directory: Path) -> None:
    """Remove a training that has nothing to keep, but nothing that somebody else has put beside it."""
    (directory / CHECKPOINT).unlink(missing_ok=True)
    (directory / LOCK).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # raised where something else is in it
        directory.rmdir()


def hold(directory: Path) -> contextlib.ExitStack:
    """Keep other processes out of a directory, and clear away what killed trainings have left half-written there.

    Returns:
        The context at whose end others may enter.

    Raises:
        InputError: Another process trains there.
        OSError: Nothing can be written there.
    """
    path = directory / LOCK
    # First, because a lock would wait for ever where the file cannot be made.
    path.touch()
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(hold_lock(path, 0))
        except Timeout:
            raise InputError(f"another process trains in {directory}: wait for it, or name another directory") from None
        for left in _half_written(directory):
            left.unlink(missing_ok=True)
        stack.callback(path.unlink, missing_ok=True)
        return stack.pop_all()


def _half_written(directory: Path) -> list[Path]:
    """What killed trainings have left of files that they were writing."""
    names = (CHECKPOINT, CURVE, RECORDING, WEIGHTS, *CARDS)
    return [path for name in names for path in half_written(directory / name)]


def _holds_something(directory: Path) -> bool:
    """Whether there is anything but what a training leaves that is killed before its first checkpoint."""
    return not directory.is_dir() or bool({*directory.iterdir()} - {directory / LOCK, *_half_written(directory)})
