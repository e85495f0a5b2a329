"""What a user asks for in the training of a Social GAN, and what the card says of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from crowdbench.networks import card as cards
from crowdbench.train.method import Request, Training, option
from crowdbench.utils.errors import InputError

EPOCHS = 50
"""The epochs of a training where their number is not given."""


@dataclass(frozen=True, kw_only=True)
class SocialGANRequest(Request):
    """What is asked for of the training in `crowdbench.train.social_gan`: on recorded tracks, or else in a scenario.

    `data` is the folder of the recordings, or None to train on the pedestrians of the scenario.

    Attributes:
        held_out: The scene of the recordings that is not trained on, or None to train on all.
        dt: The time step to which recordings are resampled, in seconds, or None for their own.
        pooling: Whether the generator has the social pooling module.
        epochs: How often every training window is used.
    """

    held_out: str | None = option(None, "With --data, the scene to leave out, to be tested on")
    dt: float | None = option(None, "With --data, resample the tracks to this many seconds per step", least=0.01)
    pooling: bool = option(False, "Use the social pooling module")
    epochs: int = option(EPOCHS, "Train for this many epochs", least=1)

    length: ClassVar[str] = "epochs"

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> None:
        """See `Request`. Recordings and scenario exclude each other, and some options are for recordings only."""
        if "data" in options and ("scenario" in options or "overrides" in options):
            raise InputError(
                "sgan learns from the tracks in --data themselves: leave out --scenario and --set, or else --data"
            )
        if "data" not in options and ("held_out" in options or "dt" in options):
            raise InputError("--held-out and --dt are for recorded tracks: give them with --data")

    @property
    def arguments(self) -> Sequence[str]:
        """See `Request`."""
        words = list(self.scenario_arguments)
        if self.data is not None:
            words = ["--data", Path(self.data).name]
            words += [] if self.dt is None else [f"--dt {self.dt:g}"]
            words += [] if self.held_out is None else ["--held-out", self.held_out]
        return [*words, "--pooling"] if self.pooling else words

    @property
    def use(self) -> str:
        """See `Request`."""
        return f"evaluate-predictor {self.network}"

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where recordings, scene or scenario do not exist, or are too short."""
        # Imported here, because torch and the simulator take seconds and the options are shown without them.
        from crowdbench.train.social_gan import Training

        return Training(self, device)

    def card(self, training: Any, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Request`. The figures are the errors on the validation windows."""
        from crowdbench.train.social_gan import MODES

        best = training.best_point()
        source, data = self._source()
        return {
            "training": {
                **source,
                "pooling": self.pooling,
                "seed": self.seed,
                "windows": len(training.training),
                "epochs": training.curve[-1].epochs,
                "kept_after_epochs": best.epochs,
                "minutes": round(training.seconds / 60, 1),
            },
            "figures": {
                "validation": {
                    "windows": len(training.validation),
                    "modes": MODES,
                    "ade": best.ade,
                    "fde": best.fde,
                }
            },
            "data": data,
        }

    @property
    def card_cases(self) -> int:
        """See `Request`. None: the errors are those of the last validation."""
        return 0

    def _source(self) -> tuple[dict[str, Any], str]:
        """What a card says of the pedestrians that were learned from: as JSON, and in words."""
        from crowdbench.catalog import load_scenario
        from crowdbench.scenario.tracks.eth_ucy import DT, read_folder, scenes

        if self.data is None:
            scenario = load_scenario(self.scenario, self.overrides)
            description = {"name": scenario.name, "digest": scenario.digest, **scenario.table}
            return {"scenario": description, "dt": scenario.rules.dt, "scenes": []}, "simulated crowds only"
        used = [scene for scene in scenes(read_folder(Path(self.data))) if scene != self.held_out]
        source = {"held_out": self.held_out, "dt": DT if self.dt is None else self.dt, "scenes": used}
        return source, f"recorded tracks: {', '.join(used)}, and those that are in no scene's test"

    @staticmethod
    def card_headline(card: Mapping[str, Any]) -> str:
        """See `Request`."""
        trained, figures = card["training"], card["figures"]["validation"]
        error = f"ADE {figures['ade']:.3f} m, best of {figures['modes']}"
        return f"on {card['data']}; {error}, on validation windows with {trained['dt']:g} s per step"

    @staticmethod
    def card_rows(card: Mapping[str, Any]) -> Mapping[str, str]:
        """See `Request`."""
        trained = card["training"]
        if "scenario" in trained:
            rows = {"scenario": cards.crowd(trained["scenario"])}
        else:
            rows = {"scene held out": trained["held_out"] or "none"}
        return rows | {
            "time step": f"{trained['dt']:g} s",
            "social pooling": "yes" if trained["pooling"] else "no",
            "training windows": str(trained["windows"]),
            "checkpoint": f"chosen at epoch {trained['kept_after_epochs']} of {trained['epochs']}",
        }

    @staticmethod
    def card_figures(card: Mapping[str, Any]) -> Sequence[str]:
        """See `Request`."""
        figures = card["figures"]["validation"]
        return [
            f"Errors on the {figures['windows']} validation windows, by which the checkpoint was chosen: ADE "
            f"{figures['ade']:.3f} m and FDE {figures['fde']:.3f} m after 8 steps, for the best of {figures['modes']} "
            "futures, chosen jointly for all pedestrians of a window."
        ]
