"""What is asked for of the training of a Social GAN, and the card of what came out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench import catalog
from crowdbench.errors import InputError
from crowdbench.predict.tracks import read_folder, scenes
from crowdbench.predict.training_tracks import training_split
from crowdbench.scenario.cases import Cases
from crowdbench.train.sgan import AHEAD, MODES, Setup, Training
from crowdbench.train.sgan_samples import from_scenario, from_tracks
from crowdbench.types import HISTORY

TRAINING_CASES = Cases("train", 0, 2000)
"""Whose crowds are learnt from, where no recordings are given."""

VALIDATION_CASES = Cases("val", 0, 200)


@dataclass(frozen=True)
class SganRequest:
    """What is asked for, as in the options of `crowdbench train sgan`: recordings in `data`, or else a scenario."""

    network: str
    data: str | None
    held_out: str | None
    dt: float
    scenario: str
    overrides: Mapping[str, Any]
    pooling: bool
    seed: int
    epochs: int
    minutes: float | None

    @property
    def command(self) -> str:
        """The command that asks for it."""
        words = ["crowdbench train", self.network]
        if self.data is None:
            words += ["--scenario", self.scenario]
            words += [f"--set '{key}={value}'" for key, value in self.overrides.items()]
        else:
            words += ["--data", Path(self.data).name, "--dt", f"{self.dt:g}"]
            words += [] if self.held_out is None else ["--held-out", self.held_out]
        words += ["--pooling"] if self.pooling else []
        words += ["--seed", str(self.seed)]
        words += ["--epochs", str(self.epochs)] if self.minutes is None else ["--minutes", f"{self.minutes:g}"]
        return " ".join(words)

    def training(self, device: str) -> Training:
        """A new training of it. Raises InputError where the recordings, the scene or the scenario are not there."""
        if self.data is None:
            scenario = catalog.load_scenario(self.scenario, self.overrides)
            training, validation = (from_scenario(scenario, cases) for cases in (TRAINING_CASES, VALIDATION_CASES))
        else:
            parts = training_split(read_folder(Path(self.data)), self.held_out)
            training, validation = (from_tracks(recordings, self.dt) for recordings in parts)
        if not (len(training) and len(validation)):
            raise InputError(f"there is no window of {HISTORY + AHEAD} steps on end to train and validate on")
        return Training(Setup(training, validation, self.pooling, self.seed, self.epochs, self.minutes, device))

    def card(self, training: Training, progress: Callable[[int], None]) -> dict[str, Any]:
        """What its card says of the training, and the errors of what was kept on validation windows."""
        if self.data is None:
            scenario = catalog.load_scenario(self.scenario, self.overrides)
            place: dict[str, Any] = {"scenario": {"name": scenario.name, "digest": scenario.digest, **scenario.table}}
            dt, data = scenario.rules.dt, "simulated crowds only"
            seen = []
        else:
            parts = scenes(read_folder(Path(self.data)))
            place = {"held_out": self.held_out}
            seen = [scene for scene in parts if scene != self.held_out]
            dt, data = self.dt, f"recorded tracks: {', '.join(seen)}, and those that are in no scene's test"
        kept = training.kept
        return {
            "training": {
                **place,
                "dt": dt,
                "scenes": seen,
                "pooling": self.pooling,
                "seed": self.seed,
                "windows": len(training.setup.training),
                "epochs": training.curve[-1].epochs,
                "kept_after_epochs": kept.epochs,
                "minutes": round(training.seconds / 60, 1),
            },
            "figures": {
                "validation": {
                    "windows": len(training.setup.validation),
                    "modes": MODES,
                    "ade": kept.ade,
                    "fde": kept.fde,
                }
            },
            "data": data,
        }

    @property
    def measured(self) -> int:
        """How many cases the card takes."""
        return 0
