"""The predictor that samples futures from a Social GAN."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from crowdbench import rng
from crowdbench.errors import InputError
from crowdbench.predict.base import Prediction, Predictor
from crowdbench.predict.social_gan_network import NOISE, Generator
from crowdbench.types import Observation, Pedestrians
from crowdbench.weights.store import built_in, digest, load_into, read_card, weights_file

NAME = "sgan"
"""What files of its weights call it."""


class SocialGAN(Predictor):
    """Futures of the whole crowd from a generator trained on `about["dt"]` seconds a step: Social GAN.

    `modes` of them; fewer are the first of more. Where the observation's steps are of another length, `rescaled`
    shows the generator displacements as long as its own steps would make them, and shortens its answers alike;
    otherwise it takes one step for the other, as the paper does. Steps before the first that was seen are taken to
    have gone like that one; a pedestrian seen only once stands still until then.
    """

    def __init__(
        self,
        generator: Generator,
        about: Mapping[str, Any],
        modes: int = 20,
        rescaled: bool = False,
        trained_without: Callable[[str], Predictor] | None = None,
    ) -> None:
        if not (isinstance(modes, int) and modes >= 1):
            raise InputError(f"modes is {modes!r}, but must be a whole number of futures, 1 or more")
        self.generator = generator.eval()
        self.about = about
        self.modes = modes
        self.rescaled = rescaled
        self.trained_without = trained_without
        self.facts = {"predictor_weights": digest(generator)}

    @torch.inference_mode()
    def predict(self, obs: Observation, steps: int) -> Prediction:
        """See `Predictor`."""
        stretch = self.about["dt"] / obs.dt if self.rescaled else 1.0
        history, present = lived(obs.pedestrians), torch.from_numpy(obs.pedestrians.seen)
        # Its noise is a function of case, step and mode alone.
        noise = rng.normal(obs.key, NAME, obs.step, self.modes, NOISE)
        device = next(self.generator.parameters()).device
        # Told from where everybody is now, since float32 far from the origin is coarse.
        near = torch.from_numpy(((history - history[:, -1:, :1]) * stretch).astype(np.float32))
        moves = self.generator(
            near.to(device), present.to(device), torch.from_numpy(noise.astype(np.float32)).to(device), steps
        )
        ahead = spread(moves, present.to(device)).double().cpu().numpy() / stretch
        return Prediction(history[:, None, None, -1] + ahead.cumsum(axis=2), ahead / obs.dt)

    def unseen(self, scene: str) -> Predictor:
        """See `Predictor`. Raises InputError where it was trained on the scene and there is no other."""
        if scene not in self.about["scenes"]:
            return self
        if self.trained_without is None:
            raise InputError(f"these weights were trained on {scene}, and so cannot be scored there")
        return self.trained_without(scene)


def spread(
    moves: Float[Tensor, "mode row time 2"], present: Bool[Tensor, "scene pedestrian"]
) -> Float[Tensor, "scene mode time pedestrian 2"]:
    """A generator's displacements where they belong; whoever is absent stands still."""
    modes, _, steps, _ = moves.shape
    everybody = moves.new_zeros((*present.shape, modes, steps, 2))
    everybody[present] = moves.transpose(0, 1)
    return everybody.permute(0, 2, 3, 1, 4)


def lived(crowd: Pedestrians) -> Float[np.ndarray, "world time pedestrian 2"]:
    """The history in metres, its steps before the first that was seen made like that one."""
    history = crowd.history
    last = history.shape[1] - 1
    start = np.clip(last + 1 - crowd.observed, 0, last)
    first, second = (_at(history, time) for time in (start, np.minimum(start + 1, last)))
    before = np.maximum(start[:, None] - np.arange(last + 1)[:, None], 0)[..., None]
    return history - before * (second - first)[:, None]


def _at(
    history: Float[np.ndarray, "world time pedestrian 2"], time: Int[np.ndarray, "world pedestrian"]
) -> Float[np.ndarray, "world pedestrian 2"]:
    """Each pedestrian's position at a time of its own."""
    return np.take_along_axis(history, time[:, None, :, None], axis=1)[:, 0]


def load_social_gan(weights: str, modes: int, rescaled: bool, device: str) -> SocialGAN:
    """The predictor with trained weights.

    Args:
        weights: The name of built-in weights or `file.safetensors`, with its card beside it.
        modes: Number of futures.
        rescaled: Whether displacements are scaled to the time step that the generator was trained on.
        device: `cpu` or `cuda`.

    Returns:
        The predictor. Its `unseen(scene)` loads the weights `<weights>-<scene>`, where there are any.

    Raises:
        InputError: The weights do not exist, are of another network, or their card lacks scenes or time step.
    """
    file = weights_file(weights)
    about = read_card(file).get("training", {})
    generator = load_into(Generator(about.get("pooling", False)), NAME, file, device)
    if not {"dt", "scenes"} <= about.keys():
        raise InputError(
            f"the card of the weights {file} must say on which scenes, in steps of which dt, they were trained"
        )

    def trained_without(scene: str) -> Predictor:
        return load_social_gan(f"{weights}-{scene}", modes, rescaled, device)

    has_others = any(path.stem.startswith(f"{weights}-") for path in built_in())
    return SocialGAN(generator, about, modes, rescaled, trained_without if has_others else None)
