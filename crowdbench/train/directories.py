"""The directory of a training: which files lie in it, what killed trainings leave there, and who may write to it."""

from __future__ import annotations

import contextlib
from pathlib import Path

from filelock import Timeout

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import half_written, hold_lock

CHECKPOINT = "checkpoint.safetensors"
"""The state of the training. It is removed last: while it is there, the training is not finished."""

CURVE = "curve.csv"
RECORDING = "training.rrd"
WEIGHTS = "weights.safetensors"
CARDS = ("weights.json", "weights.md")

LOCK = ".lock"
"""Locked by the process that trains in the directory, and by nobody once that has been killed."""


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
    if not directory.is_dir():
        return True
    return bool({*directory.iterdir()} - {directory / LOCK, *_half_written(directory)})
