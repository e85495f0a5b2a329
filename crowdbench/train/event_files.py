"""Writes the training curve for TensorBoard where it is installed: `pip install 'crowdbench[tensorboard]'`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from crowdbench.train.training import Training


@contextlib.contextmanager
def log_curve(directory: Path, training: Training) -> Iterator[Callable[[], None]]:
    """Write the columns of the training curve as scalars into an event file in the directory of the training.

    A resumed training writes its whole curve into a new file, since the old file may have a point after the checkpoint.
    Times of the scalars count training alone, so that interruptions leave no gaps.

    Args:
        directory: The directory of the training.
        training: The training.

    Yields:
        A function that writes the new points of the curve. Without TensorBoard it does nothing.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        yield lambda: None
        return
    for old in directory.glob("events.out.tfevents.*"):
        old.unlink()
    start, length, logged = time.time() - training.seconds, training.config.length, 0
    with SummaryWriter(str(directory)) as writer:

        def log() -> None:
            nonlocal logged
            for point in training.curve[logged:]:
                for name in point.keys() - {length}:
                    writer.add_scalar(name, point[name], point[length], start + point["seconds"])
            logged = len(training.curve)
            writer.flush()

        log()
        yield log
