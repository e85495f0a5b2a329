"""A training in a directory: what was asked for, checkpoints, the curve, and in the end weights with their card."""

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
from crowdbench.predict.social_gan import NAME as SGAN
from crowdbench.record import curves
from crowdbench.train import checkpoint
from crowdbench.train.sgan_request import SganRequest
from crowdbench.train.value_request import ValueRequest
from crowdbench.weights.store import save_network

CHECKPOINT = "checkpoint.safetensors"
CURVE = "curve.csv"
RECORDING = "training.rrd"
WEIGHTS = "weights.safetensors"


@dataclass(frozen=True)
class Session:
    """A training in its directory. `train` it, and then `finish`."""

    request: ValueRequest | SganRequest
    training: Any
    directory: Path

    @classmethod
    def new(cls, request: ValueRequest | SganRequest, directory: Path, device: str) -> Session:
        """Start from nothing. Raises InputError where something asked for does not exist, or the directory does."""
        _check(device)
        training = request.training(device)
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            raise InputError(
                f"{directory} exists already: name another place with --out, or go on with what is there: "
                f"--resume {directory}"
            ) from None
        return cls(request, training, directory)

    @classmethod
    def resumed(cls, directory: Path, device: str) -> Session:
        """Go on from the checkpoint in a directory, as if nothing had happened.

        Raises InputError where there is none, or its training cannot go on.
        """
        if (directory / WEIGHTS).exists():
            raise InputError(f"the training in {directory} is finished: its weights are {directory / WEIGHTS}")
        about = checkpoint.read_about(directory / CHECKPOINT)
        _check(device)
        request = SganRequest(**about) if about["network"] == SGAN else ValueRequest(**about)
        training = request.training(device)
        try:
            training.restore(checkpoint.read(directory / CHECKPOINT))
        except RuntimeError:
            raise InputError(
                f"{directory / CHECKPOINT} is a checkpoint of another network than {request.network}"
            ) from None
        return cls(request, training, directory)

    def train(self, tell: Callable[[Any, float], None]) -> None:
        """Train to the end; `tell` is given every point of the curve, and the progress from 0 to 1.

        What stops it leaves the last checkpoint, or no directory where there is none yet.
        """

        def keep() -> None:
            checkpoint.save(self.training.state(), self.directory / CHECKPOINT, dataclasses.asdict(self.request))
            _write_curve(self.training.curve, self.directory / CURVE)
            tell(self.training.curve[-1], self.training.progress)

        try:
            self.training.run(keep)
        finally:
            # Raised where there is something in it: then there is something to go on with.
            with contextlib.suppress(OSError):
                self.directory.rmdir()

    def finish(self, progress: Callable[[int], None]) -> Path:
        """Measure what was kept and write weights, card and curves; the path of the weights.

        `progress` is told how many of the `request.measured` cases have ended.
        """
        points = [dataclasses.asdict(point) for point in self.training.curve]
        curves.write(self.directory / RECORDING, self.request.command, points)
        card = {
            "command": self.request.command,
            **self.request.card(self.training, progress),
            "commit": _commit(),
            "machine": f"{_processor()}, {torch.get_num_threads()} threads, {self.training.setup.device}",
            "versions": {"python": platform.python_version(), "torch": torch.__version__},
            "licence": "MIT",
        }
        save_network(self.training.best, self.request.network, self.directory / WEIGHTS, card)
        (self.directory / CHECKPOINT).unlink()
        return self.directory / WEIGHTS


def _write_curve(curve: Sequence[Any], path: Path) -> None:
    with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in dataclasses.fields(curve[0])])
        writer.writerows(dataclasses.astuple(point) for point in curve)


def _check(device: str) -> None:
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
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
