"""Predictors of pedestrians' motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from crowdbench.predict.base import Prediction, Predictor
from crowdbench.predict.linear import ConstantVelocity, ConstantVelocitySampled, Linear
from crowdbench.predict.oracle import Oracle

__all__ = [
    "PREDICTORS",
    "ConstantVelocity",
    "ConstantVelocitySampled",
    "Linear",
    "Oracle",
    "Prediction",
    "Predictor",
]

PREDICTORS: Mapping[str, Callable[..., Predictor]] = {
    "linear": Linear,
    "constant_velocity": ConstantVelocity,
    "constant_velocity_sampled": ConstantVelocitySampled,
    "oracle": Oracle,
}
"""What makes the built-in predictors: classes, or functions that import torch only when they are called."""
