"""Runs a training in its directory: checkpoints and the training curve, and in the end the weights with their card."""

from __future__ import annotations

import dataclasses
import os
import pkgutil
import platform
import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError

from crowdbench.networks import card as cards
from crowdbench.networks.weights import save_network
from crowdbench.runs.run import read_versions
from crowdbench.train import checkpoint
from crowdbench.train.checkpoint import CHECKPOINT
from crowdbench.train.config import METHODS, Config
from crowdbench.train.event_files import log_curve
from crowdbench.train.training import Point, Training
from crowdbench.utils.errors import InputError, describe_error, find_named
from crowdbench.utils.files import write_whole

WEIGHTS = "weights.safetensors"


class Finished(InputError):
    """Raised for a training that has nothing left to do."""


@dataclass(frozen=True)
class Runner:
    """A training in its directory. Iterate over `train`, and then call `finish`.

    Attributes:
        training: The training and its state.
        directory: The directory of all its files.
    """

    training: Training
    directory: Path

    @classmethod
    def start(cls, config: Config, directory: Path, device: str) -> Runner:
        """Make a new training in a new directory.

        Args:
            config: The options.
            directory: The directory: missing, empty, or left by a training that was killed at its start.
            device: `cpu` or `cuda`.

        Raises:
            InputError: An option is invalid, or the directory is not free.
        """
        _prepare(device)
        checkpoint.check_free(directory, config.program)
        return cls(make_training(config, device), directory)

    @classmethod
    def resume(
        cls, directory: Path, device: str, threads: int | None = None, methods: Mapping[str, type[Config]] = METHODS
    ) -> Runner:
        """Read a training at its last checkpoint. It continues as if it had never been interrupted.

        Args:
            directory: The directory of the training.
            device: `cpu` or `cuda`.
            threads: The number of torch's threads, if it has been set; None to set the number of the training.
            methods: The options of the methods, by the name of the network.

        Raises:
            Finished: The training is finished.
            InputError: There is no checkpoint, or the training cannot be continued.
        """
        path, weights = directory / CHECKPOINT, directory / WEIGHTS
        if not directory.is_dir():
            raise InputError(f"there is no directory {directory}: name the one of a training with --resume")
        if not path.exists() and weights.exists():
            raise Finished(f"the training in {directory} is finished: its weights are {weights}")
        if not path.exists():
            raise InputError(f"there is no checkpoint {path}: nothing can be resumed there")
        _prepare(device)
        try:
            tensors, facts = checkpoint.read(path)
            config = find_named("network", facts["config"]["network"], methods)(**facts["config"])
            if threads is None:
                torch.set_num_threads(facts["threads"])  # sums in another order have other bits
            training = make_training(config, device)
            training.restore(tensors, facts)
        except InputError as error:
            raise InputError(f"{path} cannot be continued: {error}") from None
        except (LookupError, TypeError, ValueError, RuntimeError, AttributeError, OSError, SafetensorError) as error:
            reason = describe_error(error)[:200]
            raise InputError(
                f"{path} cannot be continued: it is damaged, or of another version of crowdbench: {reason}"
            ) from None
        return cls(training, directory)

    def train(self) -> Iterator[Point]:
        """Train to the end, and write a checkpoint at the start and after every validation.

        Yields:
            Every new point of the curve.

        Raises:
            InputError: A file cannot be written, or another process trains in the directory.
        """
        training = self.training
        with checkpoint.hold(self.directory, training.config.program):
            if not training.curve:
                self._save()  # at once, so that a full disk is reported before hours of work
            with log_curve(self.directory, training) as log:
                for _ in training.learn():
                    self._save()
                    log()
                    yield training.curve[-1]

    def finish(self, progress: Callable[[float], None]) -> Path:
        """Measure the best network and write weights and card; the checkpoint is removed.

        If the process is killed, a checkpoint remains that can be resumed. Weights never exist without their card.

        Args:
            progress: Called with the number of the training's `card_cases` that were run since its last call.

        Returns:
            The path of the weights.

        Raises:
            InputError: A file cannot be written, or another process trains in the directory.
        """
        weights, training = self.directory / WEIGHTS, self.training
        with checkpoint.hold(self.directory, training.config.program):
            about = {
                "command": training.config.command,
                **training.card(progress),
                "commit": _commit(),
                "machine": f"{read_versions()['machine']}, threads: {torch.get_num_threads()}, {training.device}",
                "versions": {"python": platform.python_version(), "torch": torch.__version__},
                "licence": "MIT",
            }
            card = save_network(training.best()[1], training.config.network, weights, about)
            with write_whole(weights.with_suffix(".md")) as partial:
                partial.write_text(cards.markdown(card), encoding="utf-8")
            (self.directory / CHECKPOINT).unlink()
        return weights

    def _save(self) -> None:
        """Write a checkpoint, and the curve once it has points."""
        training = self.training
        curve = training.curve
        facts = {
            "config": dataclasses.asdict(training.config),
            "threads": torch.get_num_threads(),
            "amount": training.amount,
            "seconds": training.seconds,
            "curve": curve,
        }
        checkpoint.save(self.directory / CHECKPOINT, {name: getattr(training, name) for name in training.saved}, facts)
        if curve:
            rows = [curve[0], *(point.values() for point in curve)]
            with write_whole(self.directory / "curve.csv") as partial:
                partial.write_text("".join(",".join(map(str, row)) + "\n" for row in rows), encoding="utf-8")


def make_training(config: Config, device: str) -> Training:
    """Return a new training with the given options. Raises InputError if one of them is impossible."""
    make: Callable[[Config, str], Training] = pkgutil.resolve_name(config.training)
    return make(config, device)


def _prepare(device: str) -> None:
    """Prepare a device for trainings that repeat to the last bit. Raises InputError if torch does not have it."""
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
    """Return the commit of the checkout of this file, or None outside one."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        described = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return described.stdout.strip()
