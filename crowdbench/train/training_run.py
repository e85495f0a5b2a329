"""A training in its directory: checkpoints and the training curve, and in the end the weights with their card."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import functools
import os
import platform
import re
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from crowdbench.metrics.summary import wilson
from crowdbench.networks.weights import save_network
from crowdbench.record import curves
from crowdbench.train import checkpoint, methods
from crowdbench.train.checkpoint import CHECKPOINT, CURVE, RECORDING, WEIGHTS
from crowdbench.train.driving import Validation
from crowdbench.train.method import Request, Training
from crowdbench.utils.errors import InputError, describe_error
from crowdbench.utils.files import whole


@dataclass(frozen=True)
class TrainingRun:
    """A training in its directory. Call `train`, and then `finish`.

    Attributes:
        request: What is asked for.
        training: The training and its state.
        directory: Where everything is written.
        device: `cpu` or `cuda`.
    """

    request: Request
    training: Training
    directory: Path
    device: str

    @classmethod
    def new(cls, request: Request, directory: Path, device: str) -> TrainingRun:
        """A training that is not begun, in a new directory.

        Args:
            request: What is asked for.
            directory: The directory. There is none, or it is empty, or was left by a training that was killed at once.
            device: `cpu` or `cuda`.

        Returns:
            The run.

        Raises:
            InputError: Something that is asked for does not exist, or the directory holds something or cannot be made.
        """
        _prepare(device)
        checkpoint.refuse_taken(directory, request.network)
        training = request.training(device)
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{directory} cannot be made: {error.strerror}: name another place with --out") from None
        return cls(request, training, directory, device)

    @classmethod
    def resumed(cls, directory: Path, device: str) -> TrainingRun:
        """A training at its last checkpoint; it goes on as if it had never been interrupted.

        Args:
            directory: The directory of the training.
            device: `cpu` or `cuda`.

        Returns:
            The run.

        Raises:
            InputError: There is no checkpoint, or the training is finished or cannot go on.
        """
        path = directory / CHECKPOINT
        # The checkpoint is the last file that `finish` touches: while it is there, the training is not finished.
        if not path.exists():
            raise InputError(checkpoint.why_nothing_goes_on(directory))
        about = checkpoint.read_about(path)
        _prepare(device)
        with _readable(path):
            request = methods.method_of(about["network"])(**about)
        training = request.training(device)
        state = checkpoint.read(path)
        with _readable(path):
            training.restore(state)
        return cls(request, training, directory, device)

    def train(self, after_validation: Callable[[Any, float], None]) -> None:
        """Train to the end, and write a checkpoint at the start and after every validation.

        An exception leaves the last checkpoint, and no directory where nothing has been validated yet.

        Args:
            after_validation: Called with every new point of the curve, and the progress from 0 to 1.

        Raises:
            InputError: A file cannot be written, or another process trains in the directory.
        """

        def save() -> None:
            self._save()
            point = self.training.curve[-1]
            with self._writing():
                board(point)
            after_validation(point, self.training.progress)

        with self._hold(), contextlib.ExitStack() as stack:
            board = _tensorboard(self.directory, stack)
            try:
                if not self.training.curve:
                    # At once, so that a place where nothing can be written is told before hours of work.
                    self._save()
                self.training.run(save)
            except BaseException:
                if not self.training.curve:
                    checkpoint.remove(self.directory)
                raise

    def finish(self, progress: Callable[[float], None]) -> Path:
        """Measure the best network and write weights, card and curves; the checkpoint is removed.

        Wherever it is killed, the checkpoint is there and can be resumed, and weights only beside their card.

        Args:
            progress: Called with what was added to the `request.card_cases`, in parts of a case.

        Returns:
            The path of the weights.

        Raises:
            InputError: A file cannot be written, or another process trains in the directory.
        """
        weights = self.directory / WEIGHTS
        with self._hold():
            about = {
                "command": self.request.command,
                **self.request.make_card(self.training, progress),
                "commit": _commit(),
                "machine": f"{_processor()}, threads: {torch.get_num_threads()}, {self.device}",
                "versions": {"python": platform.python_version(), "torch": torch.__version__},
                "licence": "MIT",
            }
            with self._writing():
                self._write_recording()
                card = save_network(self.training.best, self.request.network, weights, about)
                with whole(weights.with_suffix(".md")) as partial:
                    partial.write_text(methods.markdown(card), encoding="utf-8")
                (self.directory / CHECKPOINT).unlink()
        return weights

    def _write_recording(self) -> None:
        """Write the curve for the viewer: success with its interval, and which point was kept."""
        curve, training = self.training.curve, self.training
        intervals = {}
        if isinstance(curve[0], Validation):
            solved = [round(point.success * training.validated_on) for point in curve]
            ranges = [wilson(np.arange(training.validated_on) < count) for count in solved]
            intervals["success"] = [(one.low, one.high) for one in ranges]
        points = [dataclasses.asdict(point) for point in curve]
        best = curve.index(training.best_point())
        curves.write(self.directory / RECORDING, self.request.command, points, best=best, intervals=intervals)

    def _save(self) -> None:
        """Write a checkpoint, and the curve where it has points."""
        with self._writing():
            checkpoint.save(self.training.state(), self.directory / CHECKPOINT, dataclasses.asdict(self.request))
            if self.training.curve:
                _write_curve(self.training.curve, self.directory / CURVE)

    def _hold(self) -> contextlib.ExitStack:
        """Keep other processes out of the directory."""
        with self._writing():
            return checkpoint.hold(self.directory)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Say in one sentence that a file cannot be written, and what is left."""
        try:
            yield
        except OSError as error:
            left = (
                "its last checkpoint is kept: make room, and go on with "
                f"crowdbench train {self.request.network} --resume {self.directory}"
                if self.training.curve and (self.directory / CHECKPOINT).exists()
                else "nothing was kept: name another place with --out"
            )
            reason = error.strerror or error
            raise InputError(f"the training in {self.directory} cannot be written: {reason}; {left}") from None


def _tensorboard(directory: Path, stack: contextlib.ExitStack) -> Callable[[Any], None]:
    """What writes a point of the curve for TensorBoard until the stack ends; nothing where that is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return lambda point: None

    @functools.cache
    def writer() -> SummaryWriter:
        return stack.enter_context(SummaryWriter(directory))  # which makes a file at once

    def write(point: Any) -> None:
        along, *names = (field.name for field in dataclasses.fields(point))
        for name in names:
            writer().add_scalar(name, getattr(point, name), getattr(point, along))
        writer().flush()

    return write


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Say in one sentence that a checkpoint cannot be used."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path} cannot be continued: {error}") from None
    except (LookupError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise InputError(
            f"{path} cannot be continued: it is damaged, or of another version of crowdbench: "
            f"{describe_error(error)[:200]}"
        ) from None


def _write_curve(curve: Sequence[Any], path: Path) -> None:
    with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in dataclasses.fields(curve[0])])
        writer.writerows(dataclasses.astuple(point) for point in curve)


def _prepare(device: str) -> None:
    """Make a device ready, on which a training repeats to the last bit. Raises InputError where torch has none."""
    try:
        torch.empty(1, device=device).cpu()  # the device `meta` has no values to read
    except (RuntimeError, AssertionError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"nothing can be trained on the device {device!r}: {reason}") from None
    if device != "cpu":
        # Else the order of sums on a GPU differs from run to run. cuBLAS reads the variable when it is first used.
        # Torch only warns of an operation without a fixed order, because a user's encoder may need one.
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
        torch.use_deterministic_algorithms(True, warn_only=True)


def _commit() -> str | None:
    """The commit of the checkout that this runs in, or None outside one."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        found = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return found.stdout.strip()


def _processor() -> str:
    """The name of the processor."""
    cpuinfo = Path("/proc/cpuinfo")
    found = re.search(r"^model name.*?:(.*)", cpuinfo.read_text() if cpuinfo.exists() else "", re.MULTILINE)
    return found[1].strip() if found else platform.processor() or platform.machine()
