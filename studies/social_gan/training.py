"""Trains Social GAN (Gupta et al. 2018): a generator with the variety loss, against a discriminator.

Differs from the published training, because a training must take minutes: the variety loss takes the mean distance over
the steps instead of the squared distance, learning rates are annealed along a cosine (Loshchilov and Hutter 2017),
scenes are rotated and mirrored at random, and an exponential moving average of the generator is validated and saved.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import softplus

from crowdbench import Prediction, load_scenario
from crowdbench.core import HISTORY
from crowdbench.networks import SGAN_HIDDEN, SGAN_NOISE, SGAN_WIDE, Generator, TrajectoryEncoder, perceptron
from crowdbench.predict import scatter
from crowdbench.scenario import ETH_UCY_DT
from crowdbench.train import Point, Training, describe_scenario
from studies.social_gan.config import SocialGANConfig
from studies.social_gan.prediction_errors import TOGETHER, displacement
from studies.social_gan.recordings import read_folder, scenes
from studies.social_gan.samples import HORIZON, Samples, load_samples

BATCH = 64
"""Scenes of an update."""

MODES = 20
"""Sampled futures, the best of which counts: the k of the variety loss, 20 as published."""

ADVERSARIAL = 0.05
"""Weight of the adversarial loss, beside a variety loss in metres."""

LEARNING_RATE = 1e-3
"""At the start; it is annealed to 0."""

CLIP = 1.0
"""Largest norm of a gradient."""

AVERAGING = 0.005
"""Weight of the generator in its moving average, at every update."""

EPOCHS_PER_SEED = 1_000_000
"""The number of epochs with random numbers that belong to each seed."""

VALIDATIONS = 24
"""Validations of a training, on validation windows."""


def make_discriminator() -> nn.Module:
    """Return a network that distinguishes real tracks from fake ones: an encoder, and a perceptron as its head.

    It maps displacements in metres, observed and predicted, `[row, time, 2]`, to the logits `[row]` of real tracks.
    """
    return nn.Sequential(TrajectoryEncoder(SGAN_HIDDEN), perceptron(SGAN_HIDDEN, SGAN_WIDE, 1), nn.Flatten(0))


class SocialGANTraining(Training):
    """A training of a Social GAN.

    A point of its curve has the mean losses of generator and discriminator in the last epoch, `loss` and
    `discriminator_loss`, and the errors on validation windows in metres, `ade` and `fde`. They belong to the best of
    `MODES` futures, chosen jointly for all pedestrians of a window.

    Args:
        config: The options.
        device: `cpu` or `cuda`.

    Raises:
        InputError: See `load_samples`.
    """

    config: SocialGANConfig
    saved = ("generator", "discriminator", "average", "validated", "generator_optimizer", "discriminator_optimizer")

    def __init__(self, config: SocialGANConfig, device: str) -> None:
        super().__init__(config, device)
        self.training, self.validation = load_samples(config)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.generator = Generator(config.pooling).to(device)
            self.discriminator = make_discriminator().to(device)
        self.average = copy.deepcopy(self.generator)
        self.validated = copy.deepcopy(self.generator)
        self.generator_optimizer = torch.optim.Adam(self.generator.parameters(), lr=LEARNING_RATE)
        self.discriminator_optimizer = torch.optim.Adam(self.discriminator.parameters(), lr=LEARNING_RATE)

    def describe(self, point: Point) -> str:
        """See `Training`."""
        return (
            f"{point['epochs']:4d} epochs, {point['seconds']:4.0f} s: on validation windows ADE {point['ade']:.3f} m, "
            f"FDE {point['fde']:.3f} m (best of {MODES} futures)"
        )

    def best(self) -> tuple[Point, Generator]:
        """See `Training`: the point with the smallest ADE; the latest of equal ones."""
        return min(reversed(self.curve), key=lambda point: point["ade"]), self.validated

    def learn(self) -> Iterator[None]:
        """See `Training`."""
        while self.progress < 1.0:
            with self.timed():
                losses = self._epoch()
            self.amount += 1
            if len(self.curve) < int(self.progress * VALIDATIONS):
                self._validate(*losses)
                yield

    def _epoch(self) -> tuple[float, float]:
        """Train on every training window once. Return the mean losses of generator and discriminator."""
        rate = 0.5 * LEARNING_RATE * (1.0 + np.cos(np.pi * self.progress))
        for optimizer in (self.generator_optimizer, self.discriminator_optimizer):
            for group in optimizer.param_groups:
                group["lr"] = rate
        rng = torch.Generator().manual_seed(self.config.seed * EPOCHS_PER_SEED + self.amount)
        order = torch.randperm(len(self.training), generator=rng).numpy()
        batches = [order[start : start + BATCH] for start in range(0, len(order), BATCH)]
        loss, discriminator_loss = np.mean([self._update(rows, rng) for rows in batches], axis=0).tolist()
        return loss, discriminator_loss

    def _update(self, rows: np.ndarray, rng: torch.Generator) -> tuple[float, float]:
        """Make one step of both optimizers on the windows of the given rows. Return the losses."""
        position, present = self._scenes(self.training, rows)
        position = position @ _rotations(len(rows), rng).to(position)[:, None]
        noise = torch.randn((len(rows), MODES, SGAN_NOISE), generator=rng).to(position)
        scene, pedestrian = present.nonzero(as_tuple=True)
        real = position.transpose(1, 2)[scene, pedestrian].diff(dim=1)
        observed, future = real[:, : HISTORY - 1], real[:, HISTORY - 1 :]
        seen = position[:, :HISTORY], present
        with torch.no_grad():
            best = scene_errors(self.generator(*seen, noise, HORIZON), future, scene, len(rows)).argmin(dim=0)
        # Only two of the futures have a gradient: the first, which is the input of the discriminator, and the best.
        two = torch.stack([noise[:, 0], noise[torch.arange(len(rows)), best]], dim=1)
        predicted = self.generator(*seen, two, HORIZON)
        fake = torch.cat([observed, predicted[0]], dim=1)
        variety = variety_loss(predicted, future, scene, len(rows))
        loss = variety + ADVERSARIAL * non_saturating_loss(self.discriminator(fake))
        _step(self.generator_optimizer, loss, self.generator)
        discriminator_loss = cross_entropy(self.discriminator(real), self.discriminator(fake.detach()))
        _step(self.discriminator_optimizer, discriminator_loss, self.discriminator)
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), list(self.generator.parameters()), AVERAGING)
        return loss.item(), discriminator_loss.item()

    def _scenes(
        self, windows: Samples, rows: np.ndarray
    ) -> tuple[Float[Tensor, "scene time pedestrian 2"], Bool[Tensor, "scene pedestrian"]]:
        """Return positions in metres and presence in the windows of the given rows, as tensors."""
        present = windows.present[rows]
        widest = int(present.sum(axis=1).max())  # present pedestrians come first
        position = torch.from_numpy(windows.position[rows, :, :widest])
        return position.to(self.device), torch.from_numpy(present[:, :widest]).to(self.device)

    def _validate(self, loss: float, discriminator_loss: float) -> None:
        """Add a point to the curve, and keep the generator if it is the best one so far."""
        with self.timed():
            ade, fde = self._errors()
        self.add_point(loss=loss, discriminator_loss=discriminator_loss, ade=ade, fde=fde)
        if self.best()[0] is self.curve[-1]:
            self.validated.load_state_dict(self.average.state_dict())

    @torch.inference_mode()
    def _errors(self) -> tuple[float, float]:
        """Measure the moving average on the validation windows. Return ADE and FDE in metres."""
        rng = torch.Generator().manual_seed(0)
        total, count = np.zeros(2), 0
        for first in range(0, len(self.validation), 2 * BATCH):
            rows = np.arange(first, min(first + 2 * BATCH, len(self.validation)))
            position, present = self._scenes(self.validation, rows)
            noise = torch.randn((len(rows), MODES, SGAN_NOISE), generator=rng).to(position)
            predicted = self.average(position[:, :HISTORY], present, noise, HORIZON)
            moves = scatter(predicted, present).cpu().numpy()
            path = position.cpu().numpy()
            prediction = Prediction(path[:, None, HISTORY - 1, None] + moves.cumsum(axis=2), moves)
            error = displacement(prediction, path[:, HISTORY:], present.cpu().numpy())[present.cpu().numpy()]
            total, count = total + error[:, TOGETHER, :, -1].sum(axis=0), count + len(error)
        ade, fde = (total / count).tolist()
        return ade, fde

    def card(self, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Training`. The figures are the errors on the validation windows."""
        (best, _), config = self.best(), self.config
        if config.data is None:
            scenario = load_scenario(config.scenario, config.overrides)
            source = {"scenario": describe_scenario(scenario), "dt": scenario.rules.dt, "scenes": []}
            data = "simulated crowds only"
        else:
            trained_on = [scene for scene in scenes(read_folder(Path(config.data))) if scene != config.held_out]
            source = {"held_out": config.held_out, "dt": config.dt or ETH_UCY_DT, "scenes": trained_on}
            data = f"recorded tracks: {', '.join(trained_on)}, and those that are in no scene's test"
        return {
            "training": {
                **source,
                "pooling": config.pooling,
                "seed": config.seed,
                "windows": len(self.training),
                "epochs": self.curve[-1]["epochs"],
                "kept_after_epochs": best["epochs"],
                "minutes": round(self.seconds / 60, 1),
            },
            "figures": {
                "validation": {"windows": len(self.validation), "modes": MODES, "ade": best["ade"], "fde": best["fde"]}
            },
            "data": data,
        }


def variety_loss(
    predicted: Float[Tensor, "mode row time 2"],
    future: Float[Tensor, "row time 2"],
    scene: Int[Tensor, "row"],
    scenes: int,
) -> Float[Tensor, ""]:
    """Compute the variety loss of Gupta et al. (2018, section 3.5), to which only the best sampled future contributes.

    L = min_k |Y - Y^(k)|, where the minimum is over the modes of a whole scene, and the distance is the mean over
    pedestrians and steps.

    Args:
        predicted: Displacements from step to step in metres; a row is a pedestrian of a scene.
        future: The true displacements in metres.
        scene: The number of each row's scene.
        scenes: Number of scenes.

    Returns:
        The mean over all pedestrians, in metres.
    """
    return scene_errors(predicted, future, scene, scenes).amin(dim=0).sum() / len(scene)


def scene_errors(
    predicted: Float[Tensor, "mode row time 2"],
    future: Float[Tensor, "row time 2"],
    scene: Int[Tensor, "row"],
    scenes: int,
) -> Float[Tensor, "mode scene"]:
    """Return the mean distance over steps in metres, summed over the pedestrians of each scene; see `variety_loss`."""
    distance = torch.linalg.vector_norm((predicted - future).cumsum(dim=2), dim=-1).mean(dim=2)
    return distance.new_zeros((len(distance), scenes)).index_add(1, scene, distance)


def non_saturating_loss(fake: Float[Tensor, "row"]) -> Float[Tensor, ""]:
    """Compute the generator's adversarial loss, -log D(fake), from logits (Goodfellow et al. 2014)."""
    return softplus(-fake).mean()


def cross_entropy(real: Float[Tensor, "row"], fake: Float[Tensor, "row"]) -> Float[Tensor, ""]:
    """Compute the discriminator's loss, -log D(real) - log(1 - D(fake)) (Goodfellow et al. 2014, eq. 1).

    Args:
        real: The discriminator's logits of recorded tracks.
        fake: Its logits of generated tracks.

    Returns:
        The mean loss.
    """
    return softplus(-real).mean() + softplus(fake).mean()


def _rotations(scenes: int, rng: torch.Generator) -> Float[Tensor, "scene 2 2"]:
    """Draw a random rotation for each scene, with a reflection in half of them."""
    angle = 2.0 * np.pi * torch.rand(scenes, generator=rng)
    mirror = 1.0 - 2.0 * torch.randint(2, (scenes,), generator=rng)
    rows = [torch.stack([angle.cos(), angle.sin()], -1), torch.stack([-angle.sin() * mirror, angle.cos() * mirror], -1)]
    return torch.stack(rows, dim=1)


def _step(optimizer: torch.optim.Optimizer, loss: Float[Tensor, ""], network: nn.Module) -> None:
    """Make a step of an optimizer, with the gradient's norm clipped."""
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(network.parameters(), CLIP)
    optimizer.step()
