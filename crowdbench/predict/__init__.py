"""Predictors of pedestrians' motion."""

from __future__ import annotations

from crowdbench.predict.base import Prediction, Predictor
from crowdbench.predict.linear import ConstantVelocity, ConstantVelocitySampled, Linear, Oracle

__all__ = ["ConstantVelocity", "ConstantVelocitySampled", "Linear", "Oracle", "Prediction", "Predictor"]
