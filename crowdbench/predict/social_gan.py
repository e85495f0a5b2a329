"""The predictor that samples futures from a Social GAN; its networks are in `networks.social_gan`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from crowdbench.core.types import Observation, Pedestrians
from crowdbench.networks.chunks import CHUNK, in_chunks
from crowdbench.networks.social_gan import SGAN_NOISE, Generator
from crowdbench.networks.weights import built_in, load_into, read_card, weights_digest, weights_file
from crowdbench.predict.predictor import Prediction, Predictor
from crowdbench.utils.errors import InputError, is_number, require_count

NAME = "sgan"
"""The name of the network on the cards of its weights."""

LONGEST_STEP = 60.0
"""The longest time step in seconds that a card can have."""


@dataclass(eq=False, repr=False)
class SocialGAN(Predictor):
    """Predictor that samples futures of the whole crowd from the generator of a Social GAN (Gupta et al. 2018).

    The generator was trained with steps of `about["dt"]` seconds. If the observation has another time step, the
    generator gets the displacements per step unchanged, as in Li et al. (2020), or, if `rescaled`, scaled to the
    time step of its training; its predictions are then scaled back. Steps before the first observation are
    extrapolated backwards from the first displacement; a pedestrian that was observed once has none.

    Args:
        about: Facts of the training from its card: at least `dt`, the time step in seconds, and `scenes`, the
            recorded scenes that it was trained on.
        modes: Number of futures [1]. The first futures are the same for every number.
        rescaled: True if displacements are rescaled to the time step that the generator was trained on.
        weights: The name of its weights. The weights `<weights>-<scene>` were trained without that scene.

    Raises:
        InputError: `modes` is not a whole number, 1 or more.
    """

    generator: Generator
    about: Mapping[str, Any]
    modes: int = 20
    rescaled: bool = False
    weights: str = NAME

    def __post_init__(self) -> None:
        require_count("modes", self.modes)
        self.facts = {"predictor_weights": weights_digest(self.generator.eval())}

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`. There are `modes` modes."""
        scale = self.about["dt"] / obs.dt if self.rescaled else 1.0
        history, present = extrapolated_history(obs.pedestrians), torch.from_numpy(obs.pedestrians.seen)
        # All pedestrians of a future share its noise.
        noise = torch.from_numpy(obs.noise(NAME, (self.modes, SGAN_NOISE)).astype(np.float32))
        # Relative to the first pedestrian that is seen, because float32 is coarse far from the origin.
        first = np.argsort(~obs.pedestrians.seen, axis=1, kind="stable")[:, :1, None]
        origin = np.take_along_axis(history[:, -1], first, axis=1)
        relative = torch.from_numpy(((history - origin[:, None]) * scale).astype(np.float32))
        worlds, pedestrians = present.shape
        moves = np.empty((worlds, self.modes, steps, pedestrians, 2))

        device = next(self.generator.parameters()).device

        @torch.inference_mode()
        def fill(part: slice) -> None:
            seen = present[part].to(device)
            rows = self.generator(relative[part].to(device), seen, noise[part].to(device), steps)
            moves[part] = scatter(rows, seen).double().cpu().numpy()

        in_chunks(fill, worlds, max(1, CHUNK // (self.modes * max(pedestrians, 1))))
        displacement = moves / scale
        return Prediction(history[:, None, None, -1] + displacement.cumsum(axis=2), displacement / obs.dt)

    def for_held_out_scene(self, scene: str) -> Predictor:
        """See `Predictor`. Raises InputError if it was trained on the scene and no other weights exist."""
        if scene not in self.about["scenes"]:
            return self
        others = f"{self.weights}-{scene}"
        if others not in [file.stem for file in built_in()]:
            raise InputError(f"these weights were trained on {scene}, and so cannot be scored there")
        return load_social_gan(others, self.modes, self.rescaled, next(self.generator.parameters()).device.type)


def scatter(
    moves: Float[Tensor, "mode row time 2"], present: Bool[Tensor, "scene pedestrian"]
) -> Float[Tensor, "scene mode time pedestrian 2"]:
    """Rearrange a generator's displacements into the shape of a prediction.

    Args:
        moves: Displacements in metres; a row is a pedestrian who is present, in the order of `present.nonzero()`.
        present: True for pedestrians that exist in each scene.

    Returns:
        The same displacements, and 0 for absent pedestrians.
    """
    modes, _, steps, _ = moves.shape
    all_moves = moves.new_zeros((*present.shape, modes, steps, 2))
    all_moves[present] = moves.transpose(0, 1)
    return all_moves.permute(0, 2, 3, 1, 4)


def extrapolated_history(crowd: Pedestrians) -> Float[np.ndarray, "world time pedestrian 2"]:
    """Return the observed history in metres, extrapolated backwards from the first displacement to the full length."""
    history = crowd.history
    last = history.shape[1] - 1
    start = np.clip(last + 1 - crowd.observed, 0, last)
    times = start, np.minimum(start + 1, last)
    first, second = (np.take_along_axis(history, time[:, None, :, None], axis=1)[:, 0] for time in times)
    steps = np.maximum(start[:, None] - np.arange(last + 1)[:, None], 0)[..., None]
    return history - steps * (second - first)[:, None]


def load_social_gan(weights: str, modes: int, rescaled: bool, device: str) -> SocialGAN:
    """Load the predictor with trained weights.

    Args:
        weights: The name of built-in weights or `file.safetensors`, with its card beside it.
        modes: Number of futures [1].
        rescaled: True if displacements are rescaled to the time step that the generator was trained on.
        device: `cpu` or `cuda`.

    Returns:
        The predictor. Its `for_held_out_scene(scene)` loads the weights `<weights>-<scene>`, if they exist.

    Raises:
        InputError: The weights do not exist, are of another network, or their card lacks scenes or time step.
    """
    file = weights_file(weights)
    about = read_card(file).get("training", {})
    generator = load_into(Generator(about.get("pooling") is True), NAME, file, device)
    _check(about, file)
    return SocialGAN(generator, about, modes, rescaled, weights)


def _check(about: Mapping[str, Any], file: Path) -> None:
    """Raise InputError if the facts of a card on the training are missing or impossible."""
    dt: Any = about.get("dt")
    scenes = about.get("scenes")
    facts = {
        f"dt, seconds above 0 and up to {LONGEST_STEP:g}": is_number(dt) and 0.0 < dt <= LONGEST_STEP,
        "scenes, a list of names": isinstance(scenes, list) and all(isinstance(name, str) for name in scenes),
        "pooling, true or false": isinstance(about.get("pooling", False), bool),
    }
    for fact, valid in facts.items():
        if not valid:
            raise InputError(f"the card of the weights {file} must say of the training: {fact}")
