"""A training in its directory: checkpoints and the training curve, and in the end the weights with their card."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import platform
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from crowdbench.errors import InputError
from crowdbench.files import whole
from crowdbench.record import curves
from crowdbench.train import checkpoint, methods
from crowdbench.train.method import Request, Training
from crowdbench.weights.store import save_network

CHECKPOINT = "checkpoint.safetensors"
CURVE = "curve.csv"
RECORDING = "training.rrd"
WEIGHTS = "weights.safetensors"


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
            directory: The directory, which must not exist.
            device: `cpu` or `cuda`.

        Returns:
            The run.

        Raises:
            InputError: Something that is asked for does not exist, or the directory does.
        """
        _check(device)
        training = request.training(device)
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            raise InputError(
                f"{directory} exists already: name another place with --out, or go on with what is there: "
                f"--resume {directory}"
            ) from None
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
        if (directory / WEIGHTS).exists():
            raise InputError(f"the training in {directory} is finished: its weights are {directory / WEIGHTS}")
        about = checkpoint.read_about(directory / CHECKPOINT)
        _check(device)
        request = methods.method_of(about["network"])(**about)
        training = request.training(device)
        try:
            training.restore(checkpoint.read(directory / CHECKPOINT))
        except RuntimeError:
            raise InputError(
                f"{directory / CHECKPOINT} is a checkpoint of another network than {request.network}"
            ) from None
        return cls(request, training, directory, device)

    def train(self, after_validation: Callable[[Any, float], None]) -> None:
        """Train to the end, and write a checkpoint after every validation.

        An exception leaves the last checkpoint, and no directory where there is no checkpoint yet.

        Args:
            after_validation: Called with every new point of the curve, and the progress from 0 to 1.
        """

        def save() -> None:
            checkpoint.save(self.training.state(), self.directory / CHECKPOINT, dataclasses.asdict(self.request))
            _write_curve(self.training.curve, self.directory / CURVE)
            after_validation(self.training.curve[-1], self.training.progress)

        try:
            self.training.run(save)
        finally:
            # Fails where there is a checkpoint in it, as it should.
            with contextlib.suppress(OSError):
                self.directory.rmdir()

    def finish(self, progress: Callable[[int], None]) -> Path:
        """Measure the best network and write weights, card and curves; the checkpoint is removed.

        Args:
            progress: Called with the number of the `request.card_cases` that have ended since its last call.

        Returns:
            The path of the weights.
        """
        points = [dataclasses.asdict(point) for point in self.training.curve]
        curves.write(self.directory / RECORDING, self.request.command, points)
        about = {
            "command": self.request.command,
            **self.request.card(self.training, progress),
            "commit": _commit(),
            "machine": f"{_processor()}, threads: {torch.get_num_threads()}, {self.device}",
            "versions": {"python": platform.python_version(), "torch": torch.__version__},
            "licence": "MIT",
        }
        weights = self.directory / WEIGHTS
        card = save_network(self.training.best, self.request.network, weights, about)
        with whole(weights.with_suffix(".md")) as partial:
            partial.write_text(methods.markdown(card), encoding="utf-8")
        (self.directory / CHECKPOINT).unlink()
        return weights


def _write_curve(curve: Sequence[Any], path: Path) -> None:
    with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in dataclasses.fields(curve[0])])
        writer.writerows(dataclasses.astuple(point) for point in curve)


def _check(device: str) -> None:
    """Raises InputError where torch cannot use the device."""
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"nothing can be trained on the device {device!r}: {reason}") from None


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
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
