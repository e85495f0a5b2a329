"""The directory of a training and its checkpoint. Only one process at a time writes to the directory.

A checkpoint is one safetensors file, written atomically. A training that is resumed from it continues bit for bit.
"""

from __future__ import annotations

import contextlib
import json
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from filelock import Timeout
from safetensors import safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import half_written, hold_lock, write_whole

CHECKPOINT = "checkpoint.safetensors"
"""The state of the training. It is removed last: while it exists, the training is not finished."""

LOCK = ".lock"
"""The file that the process that trains in the directory locks. The lock ends when the process is killed."""


def save(path: Path, parts: Mapping[str, Any], facts: Mapping[str, Any]) -> None:
    """Write a checkpoint.

    Args:
        path: The file.
        parts: Networks, optimizers and replay buffers by name. Names of their tensors begin with the name and a dot.
        facts: `config`, the options of the training; `threads`, the number of torch's threads; `amount`, `seconds` and
            `curve`, the attributes of `Training`.

    Raises:
        OSError: The file cannot be written. An earlier checkpoint stays as it is.
    """
    tensors: dict[str, Tensor] = {}
    for name, part in parts.items():
        state = part.state_dict()
        if isinstance(part, torch.optim.Optimizer):
            state = {f"{row}.{key}": tensor for row, values in state["state"].items() for key, tensor in values.items()}
        tensors |= {f"{name}.{key}": tensor.contiguous() for key, tensor in state.items()}
    content = to_bytes(tensors, metadata={"training": json.dumps(facts)})
    with write_whole(path) as partial:
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


def restore(name: str, part: Any, tensors: Mapping[str, Tensor]) -> None:
    """Restore a part from all tensors of a checkpoint. Raises RuntimeError if they are of another network."""
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
    """Check that a directory is free for a new training: missing, empty, or left by a training killed at its start.

    Args:
        directory: The directory.
        program: The command that resumes a training.

    Raises:
        InputError: The directory has other contents.
    """
    if (directory / CHECKPOINT).exists():
        raise InputError(
            f"{directory} holds a training: name another --out, or go on with "
            f"{program} --resume {shlex.quote(str(directory))}"
        )
    if directory.is_dir() and {*directory.iterdir()} - {directory / LOCK, *half_written(directory)}:
        raise InputError(f"{directory} exists already: name another place with --out")


@contextlib.contextmanager
def hold(directory: Path, program: str) -> Iterator[None]:
    """Make a directory, lock it against other processes, and remove half-written files of killed trainings.

    Args:
        directory: The directory.
        program: The command that resumes a training.

    Raises:
        InputError: Another process trains there, or a file there cannot be written.
    """
    path = directory / LOCK
    try:
        directory.mkdir(parents=True, exist_ok=True)
        # Before the lock, which would wait forever if the file could not be created.
        path.touch()
        with hold_lock(path, 0):
            try:
                for partial in half_written(directory):
                    partial.unlink(missing_ok=True)
                yield
            finally:
                path.unlink(missing_ok=True)
    except Timeout:
        raise InputError(f"another process trains in {directory}: wait for it, or name another directory") from None
    except OSError as error:
        result = "nothing was kept: name another place with --out"
        if (directory / CHECKPOINT).exists():
            resume = f"{program} --resume {shlex.quote(str(directory))}"
            result = f"its last checkpoint is kept: make room, and go on with {resume}"
        reason = error.strerror or error
        raise InputError(f"the training in {directory} cannot be written: {reason}; {result}") from None
