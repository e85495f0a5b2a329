"""Windows of crowds to train a generator of futures on: of recorded tracks, or of a scenario's own pedestrians."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.rollout import rollout
from crowdbench.geometry import norm
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.predict.tracks import Tracks, windows
from crowdbench.predict.training_tracks import resampled
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.train.sgan import AHEAD, Samples
from crowdbench.types import HISTORY

LENGTH = HISTORY + AHEAD

EVERY = 4
"""Steps from one window of a simulated crowd to the next."""


def from_tracks(recordings: Sequence[Tracks], dt: float) -> Samples:
    """All windows of recordings, in steps of `dt` seconds."""
    found = [windows(tracks if tracks.dt == dt else resampled(tracks, dt), LENGTH) for tracks in recordings]
    return _joined([_ordered(part.position, part.present) for part in found])


def from_scenario(scenario: Scenario, cases: Cases) -> Samples:
    """Windows of a scenario's pedestrians on their way, as long as a vehicle that they do not see is on its own.

    The steps before the start are those of the first one, as the predictor takes them to be.
    """
    blind = dataclasses.replace(scenario, rules=dataclasses.replace(scenario.rules, visible=False))
    trace = rollout(Driver(ORCAPlanner(), "orca"), blind, cases)
    path = trace.position[:, :, 1:]
    back = np.arange(HISTORY - 2, 0, -1)[:, None, None]
    path = np.concatenate([path[:, :1] - back * (path[:, 1:2] - path[:, :1]), path], axis=1)
    found = []
    for start in range(0, path.shape[1] - LENGTH + 1, EVERY):
        position = path[:, start : start + LENGTH]
        away = norm(position[:, HISTORY - 1] - trace.goal[:, 0, 1:]) >= trace.radius[:, 0, 1:]
        going = trace.present[:, 0, 1:] & away & np.isfinite(position).all(axis=(1, 3))
        found.append(_ordered(position[going.any(axis=1)], going[going.any(axis=1)]))
    return _joined(found)


def _ordered(
    position: Float[np.ndarray, "window time pedestrian 2"], present: Bool[np.ndarray, "window pedestrian"]
) -> Samples:
    """Whoever is present first, told from the first of them, since float32 far from the origin is coarse."""
    order = np.argsort(~present, axis=1, kind="stable")
    present = np.take_along_axis(present, order, axis=1)
    position = np.take_along_axis(position, order[:, None, :, None], axis=2)
    near = position - position[:, HISTORY - 1 : HISTORY, :1]
    return Samples(np.where(present[:, None, :, None], near, 0.0).astype(np.float32), present)


def _joined(parts: Sequence[Samples]) -> Samples:
    widest = max((part.present.shape[1] for part in parts), default=0)

    def padded(array: np.ndarray, axis: int) -> np.ndarray:
        widths = [(0, 0)] * array.ndim
        widths[axis] = (0, widest - array.shape[axis])
        return np.pad(array, widths)

    position = np.concatenate([padded(part.position, 2) for part in parts])
    return Samples(position, np.concatenate([padded(part.present, 1) for part in parts]))
