"""The options of a training of Social GAN. It does not import torch, so that the command line starts without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from crowdbench import InputError
from crowdbench.train import SCENARIO, Config


@dataclass(frozen=True, kw_only=True)
class SocialGANConfig(Config):
    """The options of `studies.social_gan.training`: on recorded tracks in `data`, or else in a scenario.

    Attributes:
        data: Folder with recorded tracks to train on, instead of a scenario's pedestrians.
        minutes: Train for this many minutes, validations included, instead of --epochs.
        dt: With --data, resample the tracks to this many seconds per step.
        held_out: With --data, the scene to leave out, to be tested on.
        pooling: Use the social pooling module.
        epochs: Train for this many epochs.

    Raises:
        InputError: Options contradict each other, or a number is impossible.
    """

    dt: float | None = None
    held_out: str | None = None
    pooling: bool = False
    epochs: int = 50

    length: ClassVar[str] = "epochs"
    training: ClassVar[str] = "studies.social_gan.training:SocialGANTraining"
    program = "python studies/social_gan/train.py"
    usage = "check sgan --kind predictors"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.data is not None and (self.scenario != SCENARIO or self.overrides):
            raise InputError(
                "sgan learns from the tracks in --data themselves: leave out --scenario and --set, or else --data"
            )
        if self.data is None and not (self.held_out is None and self.dt is None):
            raise InputError("--held-out and --dt are for recorded tracks: give them with --data")
        if self.dt is not None and not self.dt >= 0.01:
            raise InputError(f"--dt is {self.dt}, but must be a number, 0.01 or more")

    @property
    def always_written(self) -> Sequence[str]:  # type: ignore[override]
        """See `Config`."""
        return ("scenario",) if self.data is None else ()


METHODS: dict[str, type[Config]] = {"sgan": SocialGANConfig}
"""The options by the name of the network, for `crowdbench.train`."""
