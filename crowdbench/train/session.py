"""A training in a directory: what was asked for, checkpoints, the curve, and in the end weights with their card."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import platform
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from crowdbench import catalog, curves
from crowdbench.cases import Cases
from crowdbench.driver import Driver
from crowdbench.errors import InputError
from crowdbench.files import whole
from crowdbench.lookahead import ValuePlanner
from crowdbench.metrics import METRICS
from crowdbench.predict import ConstantVelocity
from crowdbench.results import Episodes, to_json
from crowdbench.rollouts import rollout
from crowdbench.settings import BATCH
from crowdbench.train import checkpoint
from crowdbench.train.value import Setup, Training, Validated
from crowdbench.value.networks import NETWORKS
from crowdbench.value.weights import save_network

CHECKPOINT = "checkpoint.safetensors"
CURVE = "curve.csv"
RECORDING = "training.rrd"
WEIGHTS = "weights.safetensors"

FIGURES = {"validation": Cases("val", 0, 1000), "test": Cases("test", 0, 500)}
"""The cases that a finished network is measured on, for its card."""

MEASURED = ("success_rate", "collision_rate", "timeout_rate", "navigation_time")


@dataclass(frozen=True)
class Request:
    """What is asked for, as in the options of `crowdbench train`."""

    network: str
    scenario: str
    overrides: Mapping[str, Any]
    predictor: str
    seed: int
    episodes: int
    minutes: float | None

    @property
    def command(self) -> str:
        """The command that asks for it."""
        words = ["crowdbench train", self.network, "--scenario", self.scenario]
        words += [f"--set '{key}={value}'" for key, value in self.overrides.items()]
        words += ["--predictor", self.predictor, "--seed", str(self.seed)]
        words += ["--episodes", str(self.episodes)] if self.minutes is None else ["--minutes", f"{self.minutes:g}"]
        return " ".join(words)

    def training(self, device: str) -> Training:
        """A new training of it. Raises InputError where there is no such network, scenario, predictor or device."""
        if self.network not in NETWORKS:
            raise InputError(f"no network is called {self.network!r}; there are {', '.join(NETWORKS)}")
        _check(device)
        _, predictor = catalog.load_predictor(self.predictor)
        scenario = catalog.load_scenario(self.scenario, self.overrides)
        return Training(Setup(self.network, scenario, predictor, self.seed, self.episodes, self.minutes, device))


@dataclass(frozen=True)
class Session:
    """A training in its directory. `train` it, and then `finish`."""

    request: Request
    training: Training
    directory: Path

    @classmethod
    def new(cls, request: Request, directory: Path, device: str) -> Session:
        """Start from nothing. Raises InputError where something asked for does not exist, or the directory does."""
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
        request = Request(**checkpoint.read_about(directory / CHECKPOINT))
        training = request.training(device)
        checkpoint.restore(training, directory / CHECKPOINT)
        return cls(request, training, directory)

    def train(self, tell: Callable[[Validated, float], None]) -> None:
        """Train to the end; `tell` is given every point of the curve, and the progress from 0 to 1.

        What stops it leaves the last checkpoint, or no directory where there is none yet.
        """

        def keep() -> None:
            checkpoint.save(self.training, self.directory / CHECKPOINT, dataclasses.asdict(self.request))
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

        `progress` is told how many of the episodes of `FIGURES` have ended.
        """
        points = [dataclasses.asdict(point) for point in self.training.curve]
        curves.write(self.directory / RECORDING, self.request.command, points)
        save_network(self.training.best, self.directory / WEIGHTS, _card(self.training, self.request, progress))
        (self.directory / CHECKPOINT).unlink()
        return self.directory / WEIGHTS


def _card(training: Training, request: Request, progress: Callable[[int], None]) -> dict[str, Any]:
    setup = training.setup
    return {
        "command": request.command,
        "training": {
            "scenario": {"name": setup.scenario.name, "digest": setup.scenario.digest, **setup.scenario.table},
            "predictor": request.predictor,
            "seed": request.seed,
            "episodes": training.curve[-1].episodes,
            "kept_after_episodes": training.kept.episodes,
            "minutes": round(training.seconds / 60, 1),
        },
        "figures": {split: _figures(training, cases, progress) for split, cases in FIGURES.items()},
        "commit": _commit(),
        "machine": f"{_processor()}, {torch.get_num_threads()} threads, {setup.device}",
        "versions": {"python": platform.python_version(), "torch": torch.__version__},
        "data": "simulated episodes only",
        "licence": "MIT",
    }


def _figures(training: Training, cases: Cases, progress: Callable[[int], None]) -> dict[str, Any]:
    """How the kept network does at constant velocity, among the crowd that it was trained in."""
    setup = training.setup
    driver = Driver(ValuePlanner(ConstantVelocity(), training.best), setup.network)
    metrics = {name: METRICS[name] for name in MEASURED}
    traces = (rollout(driver, setup.scenario, part, progress=progress) for part in cases.batches(BATCH))
    parts = [Episodes.of(trace, metrics) for trace in traces]
    return {"cases": str(cases), "metrics": to_json(Episodes.joined(parts).summary())}


def _write_curve(curve: list[Validated], path: Path) -> None:
    with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in dataclasses.fields(Validated)])
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
