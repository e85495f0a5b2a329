"""The directory of a training, which one process at a time writes to, and the checkpoint in it.

A checkpoint is one safetensors file, written whole, from which a training continues bit for bit.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from filelock import Timeout
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

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

FACTS = {"config": dict, "threads": int, "counters": dict, "curve": list}
"""The facts in a checkpoint, with their types: the options of the training, the number of torch's threads, counters by
name, and the points of the curve."""


def save(path: Path, tensors: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
    """Write a checkpoint.

    Args:
        path: The file.
        tensors: Tensors by name.
        facts: See `FACTS`.

    Raises:
        OSError: The file cannot be written. An earlier checkpoint stays as it is.
    """
    content = to_bytes(dict(tensors), metadata={"training": json.dumps(facts)})
    with whole(path) as partial:
        partial.write_bytes(content)


def read_facts(path: Path) -> dict[str, Any]:
    """Read the `FACTS` in a checkpoint. Raises InputError if the file is not a checkpoint."""
    try:
        with safe_open(path, "pt") as file:
            facts = json.loads((file.metadata() or {})["training"])
    except (SafetensorError, OSError, KeyError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is not a checkpoint of a training: {describe_error(error)}") from None
    if not (isinstance(facts, dict) and all(isinstance(facts.get(key), kind) for key, kind in FACTS.items())):
        raise InputError(f"{path} is not a checkpoint of a training: it must have {', '.join(FACTS)}")
    return facts


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Read the tensors in a checkpoint. Raises InputError if a number is not finite."""
    with safe_open(path, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no dict)
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise InputError(f"the checkpoint {path} is damaged: {name} has numbers that are not finite")
    return tensors


def tensors_of(name: str, part: Any) -> dict[str, Tensor]:
    """Return the tensors of a network, optimizer or replay buffer. Their names begin with its name and a dot."""
    state = part.state_dict()
    if isinstance(part, torch.optim.Optimizer):
        state = {f"{row}.{key}": tensor for row, values in state["state"].items() for key, tensor in values.items()}
    return {f"{name}.{key}": tensor.contiguous() for key, tensor in state.items()}


def restore(name: str, part: Any, tensors: Mapping[str, Tensor]) -> None:
    """Restore what `tensors_of` returned, from all tensors. Raises RuntimeError if they are of another network."""
    state = {key.removeprefix(f"{name}."): tensor for key, tensor in tensors.items() if key.startswith(f"{name}.")}
    if not isinstance(part, torch.optim.Optimizer):
        part.load_state_dict(state)
        return
    rows: dict[int, dict[str, Tensor]] = {}
    for key, tensor in state.items():
        row, _, entry = key.partition(".")
        rows.setdefault(int(row), {})[entry] = tensor
    part.load_state_dict({"state": rows, "param_groups": part.state_dict()["param_groups"]})


def check_free(directory: Path, program: str) -> None:
    """Check that a directory is free for a new training: missing, empty, or left by a training killed at once.

    Args:
        directory: The directory.
        program: The command that resumes a training.

    Raises:
        InputError: The directory holds something.
    """
    if (directory / CHECKPOINT).exists():
        raise InputError(
            f"{directory} holds a training already: name another place with --out, or go on with what is there: "
            f"{program} --resume {directory}"
        )
    if directory.exists() and _is_used(directory):
        raise InputError(f"{directory} exists already: name another place with --out")


def check_resumable(directory: Path) -> None:
    """Check that a directory holds a checkpoint. Raises InputError with the reason if it does not."""
    if (directory / CHECKPOINT).exists():
        return
    if not directory.is_dir():
        raise InputError(f"there is no directory {directory}: name the one of a training with --resume")
    if (directory / WEIGHTS).exists():
        raise InputError(f"the training in {directory} is finished: its weights are {directory / WEIGHTS}")
    if _is_used(directory):
        raise InputError(f"there is no checkpoint {directory / CHECKPOINT}: nothing can be resumed there")
    raise InputError(
        f"the training in {directory} was stopped before its first checkpoint, and nothing was kept: start it again "
        f"with --out {directory} and the options that it had"
    )


def remove(directory: Path) -> None:
    """Remove a training without results, but no files of others in the directory."""
    (directory / CHECKPOINT).unlink(missing_ok=True)
    (directory / LOCK).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # raised where something else is in it
        directory.rmdir()


def hold(directory: Path) -> contextlib.ExitStack:
    """Lock a directory against other processes, and remove half-written files of killed trainings.

    Returns:
        The context at whose end the lock is released.

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
        for partial in _half_written(directory):
            partial.unlink(missing_ok=True)
        stack.callback(path.unlink, missing_ok=True)
        return stack.pop_all()


def _half_written(directory: Path) -> list[Path]:
    """Return the half-written files of killed trainings."""
    names = (CHECKPOINT, CURVE, RECORDING, WEIGHTS, *CARDS)
    return [path for name in names for path in half_written(directory / name)]


def _is_used(directory: Path) -> bool:
    """Return whether a directory holds more than the files of a training killed before its first checkpoint."""
    return not directory.is_dir() or bool({*directory.iterdir()} - {directory / LOCK, *_half_written(directory)})
