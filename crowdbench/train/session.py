"""A training in a directory: what was asked for, checkpoints, the curve, and in the end weights with their card."""

from __future__ import annotations

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

Tell = Callable[[Validated, float], None]


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


def train(request: Request, out: Path, device: str, tell: Tell) -> Path:
    """Train from nothing in the new directory `out`; the path of the weights.

    `tell` is given each point of the curve and the progress. An interrupt leaves the last checkpoint. Raises
    InputError where something asked for does not exist, or `out` does.
    """
    training = request.training(device)
    try:
        out.mkdir(parents=True)
    except FileExistsError:
        raise InputError(
            f"{out} exists already: name another place with --out, or go on with what is there: --resume {out}"
        ) from None
    return _finish(training, request, out, tell)


def resume(directory: Path, device: str, tell: Tell) -> Path:
    """Go on from the checkpoint in a directory, as if nothing had happened; the path of the weights.

    Raises InputError where there is none, or its training cannot go on.
    """
    path = directory / CHECKPOINT
    if (directory / WEIGHTS).exists():
        raise InputError(f"the training in {directory} is finished: its weights are {directory / WEIGHTS}")
    request = Request(**checkpoint.read_about(path))
    training = request.training(device)
    checkpoint.restore(training, path)
    return _finish(training, request, directory, tell)


def _finish(training: Training, request: Request, out: Path, tell: Tell) -> Path:
    def keep() -> None:
        checkpoint.save(training, out / CHECKPOINT, dataclasses.asdict(request))
        _write_curve(training.curve, out / CURVE)
        tell(training.curve[-1], training.progress)

    training.run(keep)
    curves.write(out / RECORDING, request.command, [dataclasses.asdict(point) for point in training.curve])
    save_network(training.best, out / WEIGHTS, _card(training, request))
    (out / CHECKPOINT).unlink()
    return out / WEIGHTS


def _card(training: Training, request: Request) -> dict[str, Any]:
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
        "figures": {split: _figures(training, cases) for split, cases in FIGURES.items()},
        "commit": _commit(),
        "machine": f"{_processor()}, {torch.get_num_threads()} threads, {setup.device}",
        "versions": {"python": platform.python_version(), "torch": torch.__version__},
        "data": "simulated episodes only",
        "licence": "MIT",
    }


def _figures(training: Training, cases: Cases) -> dict[str, Any]:
    """How the kept network does, with the predictor and on the scenario that it was trained with."""
    setup = training.setup
    driver = Driver(ValuePlanner(setup.predictor, training.best), setup.network)
    metrics = {name: METRICS[name] for name in MEASURED}
    parts = [Episodes.of(rollout(driver, setup.scenario, part), metrics) for part in cases.batches(BATCH)]
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
