"""Trains Social GAN (Gupta et al. 2018): a generator with a variety loss, against a discriminator.

Differs from the published training because it must take minutes: the loss is the distance itself, not its square,
learning rates fall along a cosine, scenes are turned and mirrored at random, and what is validated and kept is a
moving average of the generator.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from crowdbench.evaluate.prediction_errors import TOGETHER, displacement
from crowdbench.predict import Prediction
from crowdbench.predict.social_gan import spread
from crowdbench.predict.social_gan_network import NOISE, Discriminator, Generator
from crowdbench.train.checkpoint import State, optimizer_state, restore_optimizer, tensors_of, under
from crowdbench.types import HISTORY

AHEAD = 8
"""Steps that follow those seen, in a training window."""

BATCH = 64
"""Scenes in an update."""

MODES = 20
"""Futures of which the best one is learnt from: the published k."""

ADVERSARIAL = 0.05
"""Weight of looking real, beside the best future's mean distance in metres."""

RATE = 1e-3
CLIP = 1.0
"""Largest norm of a gradient."""

AVERAGING = 0.005
"""Weight of the generator in the moving average, at every update."""

EPOCHS_PER_SEED = 1_000_000
"""Every seed has random numbers of its own."""

PARTS = ("generator", "discriminator", "average", "best")
"""The networks of a training."""

VALIDATIONS = 24
"""How often, over a whole training, the generator is measured on validation windows."""


@dataclass(frozen=True)
class Samples:
    """Windows of crowds in metres, as float32: `HISTORY` steps and `AHEAD` more of whoever is `present` in them."""

    position: Float[np.ndarray, "window time pedestrian 2"]
    present: Bool[np.ndarray, "window pedestrian"]

    def __len__(self) -> int:
        return len(self.present)


@dataclass(frozen=True)
class Setup:
    """What is learnt, from which windows, for how long: `minutes` where given, or else `epochs`."""

    training: Samples
    validation: Samples
    pooling: bool
    seed: int
    epochs: int
    minutes: float | None
    device: str


@dataclass(frozen=True)
class Validated:
    """One point of the training curve. Seconds are those spent on training, validation left out.

    The errors in metres, at the last step ahead, are those of the best of `MODES` futures, jointly for all of a
    window, on validation windows.
    """

    epochs: int
    seconds: float
    loss: float
    discriminator_loss: float
    ade: float
    fde: float

    def __str__(self) -> str:
        return (
            f"{self.epochs:4d} epochs, {self.seconds:4.0f} s: on validation windows ADE {self.ade:.3f} m, FDE "
            f"{self.fde:.3f} m (best of {MODES} futures)"
        )


class Training:
    """A training and all its state. `run` may be called again after an interruption or on a restored state."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(setup.seed)
            self.generator = Generator(setup.pooling).to(setup.device)
            self.discriminator = Discriminator().to(setup.device)
        self.average = copy.deepcopy(self.generator)
        self.best = copy.deepcopy(self.generator)
        self.optimizer = torch.optim.Adam(self.generator.parameters(), lr=RATE)
        self.opponent = torch.optim.Adam(self.discriminator.parameters(), lr=RATE)
        self.epochs = 0
        self.seconds = 0.0
        self.curve: list[Validated] = []

    @property
    def progress(self) -> float:
        """How much of the training is done, from 0 to 1."""
        epochs, minutes = self.setup.epochs, self.setup.minutes
        return min(1.0, self.seconds / (60.0 * minutes) if minutes else self.epochs / epochs)

    def run(self, after_validation: Callable[[], None]) -> None:
        """Train to the end; `after_validation` is called whenever a point is added to the curve."""
        while self.progress < 1.0:
            start = time.perf_counter()
            loss, discriminator_loss = self._epoch()
            self.seconds += time.perf_counter() - start
            self.epochs += 1
            if len(self.curve) < int(self.progress * VALIDATIONS):
                self._validate(loss, discriminator_loss)
                after_validation()

    def _epoch(self) -> tuple[float, float]:
        """Every training window once; the mean losses of generator and discriminator."""
        rate = 0.5 * RATE * (1.0 + np.cos(np.pi * self.progress))
        for optimizer in (self.optimizer, self.opponent):
            for group in optimizer.param_groups:
                group["lr"] = rate
        chance = torch.Generator().manual_seed(self.setup.seed * EPOCHS_PER_SEED + self.epochs)
        order = torch.randperm(len(self.setup.training), generator=chance).numpy()
        batches = [order[start : start + BATCH] for start in range(0, len(order), BATCH)]
        loss, discriminator_loss = np.mean([self._update(rows, chance) for rows in batches], axis=0).tolist()
        return loss, discriminator_loss

    def _update(self, rows: np.ndarray, chance: torch.Generator) -> tuple[float, float]:
        position, present = self._scenes(self.setup.training, rows)
        position = position @ _turns(len(rows), chance).to(position)[:, None]
        noise = torch.randn((len(rows), MODES, NOISE), generator=chance).to(position)
        scene, pedestrian = present.nonzero(as_tuple=True)
        moves = position.transpose(1, 2)[scene, pedestrian].diff(dim=1)
        seen, ahead = moves[:, : HISTORY - 1], moves[:, HISTORY - 1 :]
        foreseen = self.generator(position[:, :HISTORY], present, noise, AHEAD)
        made = torch.cat([seen, foreseen[0]], dim=1)
        loss = variety_loss(foreseen, ahead, scene, len(rows)) + ADVERSARIAL * _doubt(self.discriminator(made))
        _descend(self.optimizer, loss, self.generator)
        doubt = _doubt(self.discriminator(moves)) + _doubt(-self.discriminator(made.detach()))
        _descend(self.opponent, doubt, self.discriminator)
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), list(self.generator.parameters()), AVERAGING)
        return loss.item(), doubt.item()

    def _scenes(
        self, samples: Samples, rows: np.ndarray
    ) -> tuple[Float[Tensor, "scene time pedestrian 2"], Bool[Tensor, "scene pedestrian"]]:
        present = samples.present[rows]
        widest = int(present.sum(axis=1).max())  # whoever is present comes first
        position = torch.from_numpy(samples.position[rows, :, :widest])
        return position.to(self.setup.device), torch.from_numpy(present[:, :widest]).to(self.setup.device)

    @torch.inference_mode()
    def _validate(self, loss: float, discriminator_loss: float) -> None:
        chance = torch.Generator().manual_seed(0)
        total, count = np.zeros(2), 0
        for start in range(0, len(self.setup.validation), 2 * BATCH):
            rows = np.arange(start, min(start + 2 * BATCH, len(self.setup.validation)))
            position, present = self._scenes(self.setup.validation, rows)
            noise = torch.randn((len(rows), MODES, NOISE), generator=chance).to(position)
            moves = spread(self.average(position[:, :HISTORY], present, noise, AHEAD), present).cpu().numpy()
            path = position.cpu().numpy()
            foreseen = Prediction(path[:, None, HISTORY - 1, None] + moves.cumsum(axis=2), moves)
            off = displacement(foreseen, path[:, HISTORY:], present.cpu().numpy())[present.cpu().numpy()]
            total, count = total + off[:, TOGETHER, :, -1].sum(axis=0), count + len(off)
        ade, fde = (total / count).tolist()
        self.curve.append(Validated(self.epochs, self.seconds, loss, discriminator_loss, ade, fde))
        if self.kept is self.curve[-1]:
            self.best.load_state_dict(self.average.state_dict())

    @property
    def kept(self) -> Validated:
        """The point of the curve at which the best generator was found, the later of equals."""
        return min(reversed(self.curve), key=lambda point: point.ade)

    def state(self) -> State:
        """All of it, to be written."""
        tensors = {key: value for part in PARTS for key, value in tensors_of(part, getattr(self, part)).items()}
        for part in ("optimizer", "opponent"):
            tensors |= optimizer_state(part, getattr(self, part))
        return State(tensors, {"epochs": self.epochs, "seconds": self.seconds}, self.curve)

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises RuntimeError where it is another network's."""
        for part in PARTS:
            getattr(self, part).load_state_dict(under(part, state.tensors))
        for part in ("optimizer", "opponent"):
            restore_optimizer(getattr(self, part), under(part, state.tensors))
        self.epochs, self.seconds = state.facts["epochs"], state.facts["seconds"]
        self.curve = [Validated(**point) for point in state.curve]


def variety_loss(
    foreseen: Float[Tensor, "mode row time 2"],
    ahead: Float[Tensor, "row time 2"],
    scene: Int[Tensor, "row"],
    scenes: int,
) -> Float[Tensor, ""]:
    """The mean distance over pedestrians, in the future that is best for all of a scene (Gupta et al. 2018, eq. 4).

    `foreseen` and `ahead` are displacements from step to step, in metres; `scene` says to which each row belongs.
    """
    off = torch.linalg.vector_norm((foreseen - ahead).cumsum(dim=2), dim=-1).mean(dim=2)
    by_scene = off.new_zeros((len(off), scenes)).index_add(1, scene, off)
    return by_scene.amin(dim=0).sum() / len(scene)


def _turns(scenes: int, chance: torch.Generator) -> Float[Tensor, "scene 2 2"]:
    """A random rotation for each scene, half of them mirrored."""
    angle = 2.0 * np.pi * torch.rand(scenes, generator=chance)
    mirror = 1.0 - 2.0 * torch.randint(2, (scenes,), generator=chance)
    rows = [torch.stack([angle.cos(), angle.sin()], -1), torch.stack([-angle.sin() * mirror, angle.cos() * mirror], -1)]
    return torch.stack(rows, dim=1)


def _doubt(score: Float[Tensor, "row"]) -> Float[Tensor, ""]:
    """The cross entropy of what should have been taken for real."""
    return nn.functional.softplus(-score).mean()


def _descend(optimizer: torch.optim.Optimizer, loss: Float[Tensor, ""], network: nn.Module) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(network.parameters(), CLIP)
    optimizer.step()
