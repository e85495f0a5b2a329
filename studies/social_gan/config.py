"""The options of a training of Social GAN. It does not import torch, so that the command line starts without it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from crowdbench.train import Config, option

if TYPE_CHECKING:
    from studies.social_gan.training import SocialGANTraining


@dataclass(frozen=True, kw_only=True)
class SocialGANConfig(Config):
    """The options of `studies.social_gan.training`: on recorded tracks in `data`, or else in a scenario.

    Attributes:
        dt: The time step to which recordings are resampled, in seconds; None to keep the recorded one.
        held_out: The scene of the recordings left out of the training; None to train on all.
        pooling: True if the generator has the social pooling module.
        epochs: The number of passes over the training windows.
    """

    dt: float | None = option(None, "With --data, resample the tracks to this many seconds per step", least=0.01)
    held_out: str | None = option(None, "With --data, the scene to leave out, to be tested on")
    pooling: bool = option(False, "Use the social pooling module")
    epochs: int = option(50, "Train for this many epochs", least=1)

    length: ClassVar[str] = "epochs"
    program = "python studies/social_gan/train.py"
    use = "check sgan --kind predictors"

    def training(self, device: str) -> SocialGANTraining:
        """See `Config`."""
        from studies.social_gan.training import SocialGANTraining

        return SocialGANTraining(self, device)

    @property
    def source(self) -> list[str]:
        """See `Config`."""
        return super().source if self.data is None else ["--data", Path(self.data).name]


METHODS: dict[str, type[Config]] = {"sgan": SocialGANConfig}
"""The options by the name of the network, for `crowdbench.train`."""
