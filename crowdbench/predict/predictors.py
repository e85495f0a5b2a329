"""Predictors by name or from a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crowdbench.plugins.kind import Kind
from crowdbench.predict.linear import ConstantVelocity, ConstantVelocitySampled, Linear, Oracle
from crowdbench.predict.predictor import Predictor
from crowdbench.utils.errors import require, require_options


def load_predictor(spec: str, options: Mapping[str, Any] | None = None) -> Predictor:
    """Load a predictor by its name or from a file, and construct it.

    Args:
        spec: The name of a built-in predictor, `file.py` or `file.py:function`.
        options: Keyword arguments of the predictor.

    Raises:
        InputError: There is no such predictor, it does not accept the options, or its file is broken.
    """
    require("predictor", spec, isinstance(spec, str), "a name, or a file such as './mine.py'")
    require_options(options)
    predictor: Predictor = PREDICTORS.load(spec, options)[1]
    return predictor


def _sgan(weights: str = "sgan", modes: int = 20, rescaled: bool = False, device: str = "cpu") -> Predictor:
    """Predict several futures of the crowd by Social GAN (Gupta et al. 2018), trained on real pedestrians.

    Args:
        weights: The trained generator: a name (`crowdbench list weights`) or a file.
        modes: Number of futures [1].
        rescaled: True if displacements are rescaled to the time step that the generator was trained on.
        device: Device of the generator: `cpu` or `cuda`.

    Raises:
        InputError: An option is impossible, or the weights are missing or of another network.
    """
    # Imported here, because importing torch takes a second and most planners do not need it.
    from crowdbench.predict.social_gan import load_social_gan

    return load_social_gan(weights, modes, rescaled, device)


def _sgan_simulated(modes: int = 20, device: str = "cpu") -> Predictor:
    """Predict by Social GAN, trained on simulated instead of real pedestrians.

    Args:
        modes: Number of futures [1].
        device: Device of the generator: `cpu` or `cuda`.

    Raises:
        InputError: An option is impossible.
    """
    return _sgan("sgan_simulated", modes, device=device)


PREDICTORS = Kind(
    "predictor",
    "predictor",
    {
        "linear": Linear,
        "constant_velocity": ConstantVelocity,
        "constant_velocity_sampled": ConstantVelocitySampled,
        "oracle": Oracle,
        "sgan": _sgan,
        "sgan_simulated": _sgan_simulated,
    },
    makes=Predictor,
)
"""The built-in predictors: classes, or functions that import torch only when they are called."""
