"""What a user asks for in a training of a Social GAN."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from crowdbench.networks import card as cards
from crowdbench.train.method import CardText, Request, Training, describe_scenario, option
from crowdbench.utils.errors import InputError


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
    epochs: int = option(50, "Train for this many epochs", least=1)

    length: ClassVar[str] = "epochs"
    use = "check sgan --kind predictors"

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

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where recordings, scene or scenario do not exist, or are too short."""
        from crowdbench.train.social_gan import Training

        return Training(self, device)

    def make_card(self, training: Any, progress: Callable[[float], None]) -> dict[str, Any]:
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
                "validation": {"windows": len(training.validation), "modes": MODES, "ade": best.ade, "fde": best.fde}
            },
            "data": data,
        }

    def _source(self) -> tuple[dict[str, Any], str]:
        """What a card says of the pedestrians that were learned from: as JSON, and in words."""
        from crowdbench.catalog import load_scenario
        from crowdbench.scenario.tracks.eth_ucy import DT, read_folder, scenes

        if self.data is None:
            scenario = load_scenario(self.scenario, self.overrides)
            return {
                "scenario": describe_scenario(scenario),
                "dt": scenario.rules.dt,
                "scenes": [],
            }, "simulated crowds only"
        trained_on = [scene for scene in scenes(read_folder(Path(self.data))) if scene != self.held_out]
        source = {"held_out": self.held_out, "dt": DT if self.dt is None else self.dt, "scenes": trained_on}
        return source, f"recorded tracks: {', '.join(trained_on)}, and those that are in no scene's test"

    @classmethod
    def card_text(cls, card: Mapping[str, Any]) -> CardText:
        """See `Request`."""
        trained, figures = card["training"], card["figures"]["validation"]
        ade, modes, step = f"ADE {figures['ade']:.3f} m", figures["modes"], f"{trained['dt']:g} s"
        simulated = "scenario" in trained
        source = cards.crowd(trained["scenario"]) if simulated else trained["held_out"] or "none"
        rows = {
            "scenario" if simulated else "scene held out": source,
            "time step": step,
            "social pooling": "yes" if trained["pooling"] else "no",
            "training windows": str(trained["windows"]),
            "checkpoint": f"chosen at epoch {trained['kept_after_epochs']} of {trained['epochs']}",
        }
        errors = (
            f"Errors on the {figures['windows']} validation windows, by which the checkpoint was chosen: {ade} and FDE "
            f"{figures['fde']:.3f} m after 8 steps, for the best of {modes} futures, chosen jointly for all "
            "pedestrians of a window."
        )
        headline = f"on {card['data']}; {ade}, best of {modes}, on validation windows with {step} per step"
        return CardText(headline, rows, [errors])
