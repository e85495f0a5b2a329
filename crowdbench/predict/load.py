"""Predictors by name or from a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from crowdbench import plugins
from crowdbench.errors import InputError
from crowdbench.predict.base import Predictor
from crowdbench.predict.linear import ConstantVelocity, ConstantVelocitySampled, Linear
from crowdbench.predict.oracle import Oracle


def load_predictor(spec: str, options: Mapping[str, Any] | None = None) -> tuple[str, Predictor]:
    """Find a predictor and construct it.

    Args:
        spec: The name of a built-in predictor, `file.py` or `file.py:function`.
        options: Keyword arguments of the predictor.

    Returns:
        The predictor's name, and the predictor.

    Raises:
        InputError: There is no such predictor, it does not take the options, or its file is broken.
    """
    name, factory = find_predictor(spec)
    return name, plugins.make(Predictor, name, factory, options or {})  # type: ignore[type-abstract]


def find_predictor(spec: str) -> tuple[str, Callable[..., object]]:
    """The name of a predictor and what constructs it; spec and errors are those of `load_predictor`."""
    file, function = plugins.file_and_function(spec)
    if file is not None:
        return function or file.stem, plugins.function_of(file, function or "predictor")
    if spec in PREDICTORS:
        return spec, PREDICTORS[spec]
    known = ", ".join(PREDICTORS)
    raise InputError(f"no predictor is called {spec!r}; there are {known}, or give a file: ./mine.py")


def _sgan(weights: str = "sgan", modes: int = 20, rescaled: bool = False, device: str = "cpu") -> Predictor:
    """Social GAN (Gupta et al. 2018): several futures of the crowd, from a generator trained on real pedestrians.

    Args:
        weights: The trained generator: a name (`crowdbench list weights`) or a file.
        modes: Number of futures [1].
        rescaled: Whether displacements are rescaled to the time step that the generator was trained on.
        device: Where the generator runs: `cpu` or `cuda`.

    Returns:
        The predictor.

    Raises:
        InputError: An option is impossible, or the weights are missing or of another network.
    """
    # Imported here, because torch takes a second and most planners do without.
    from crowdbench.predict.social_gan import load_social_gan

    return load_social_gan(weights, modes, rescaled, device)


def _sgan_simulated(modes: int = 20, device: str = "cpu") -> Predictor:
    """Social GAN, from a generator trained on simulated instead of real pedestrians.

    Args:
        modes: Number of futures [1].
        device: Where the generator runs: `cpu` or `cuda`.

    Returns:
        The predictor.

    Raises:
        InputError: An option is impossible.
    """
    return _sgan("sgan_simulated", modes, device=device)


PREDICTORS: Mapping[str, Callable[..., Predictor]] = {
    "linear": Linear,
    "constant_velocity": ConstantVelocity,
    "constant_velocity_sampled": ConstantVelocitySampled,
    "oracle": Oracle,
    "sgan": _sgan,
    "sgan_simulated": _sgan_simulated,
}
"""The built-in predictors: classes, or functions that import torch only when they are called."""
