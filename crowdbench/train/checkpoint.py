"""The directory of a training, which one process at a time writes to, and the checkpoint in it.

A checkpoint is one safetensors file, written whole, from which a training continues bit for bit.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from filelock import Timeout
from safetensors import safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import half_written, hold_lock, whole

CHECKPOINT = "checkpoint.safetensors"
"""The state of the training. It is removed last: while it is there, the training is not finished."""

LOCK = ".lock"
"""Locked by the process that trains in the directory, and by nobody once that has been killed."""


def save(path: Path, tensors: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
    """Write a checkpoint.

    Args:
        path: The file.
        tensors: Tensors by name.
        facts: `config`, the options of the training; `threads`, the number of torch's threads; `amount`, `seconds` and
            `curve`, those of `Training`.

    Raises:
        OSError: The file cannot be written. An earlier checkpoint stays as it is.
    """
    content = to_bytes(dict(tensors), metadata={"training": json.dumps(facts)})
    with whole(path) as partial:
        partial.write_bytes(content)


def read(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read the tensors and facts in a checkpoint.

    Raises:
        ValueError, LookupError, TypeError, SafetensorError or OSError: The file is not a checkpoint, or is damaged.
    """
    with safe_open(path, "pt") as file:
        facts = json.loads(file.metadata()["training"])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no dict)
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise ValueError(f"{name} has numbers that are not finite")
    return tensors, facts


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
    if directory.is_dir() and {*directory.iterdir()} - {directory / LOCK, *half_written(directory)}:
        raise InputError(f"{directory} exists already: name another place with --out")


@contextlib.contextmanager
def hold(directory: Path) -> Iterator[None]:
    """Make a directory, lock it against other processes, and remove half-written files of killed trainings.

    Raises:
        InputError: Another process trains there.
        OSError: Nothing can be written there.
    """
    path = directory / LOCK
    directory.mkdir(parents=True, exist_ok=True)
    # First, because a lock would wait for ever where the file cannot be made.
    path.touch()
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(hold_lock(path, 0))
        except Timeout:
            raise InputError(f"another process trains in {directory}: wait for it, or name another directory") from None
        stack.callback(path.unlink, missing_ok=True)
        for partial in half_written(directory):
            partial.unlink(missing_ok=True)
        yield
