"""Windows of pedestrians to train Social GAN on: of recorded tracks, or of a scenario's simulated pedestrians."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32

from crowdbench import Cases, InputError, Scenario, load_scenario, rollout
from crowdbench.core import HISTORY, norm
from crowdbench.planners import ORCAPlanner
from crowdbench.scenario import RecordedTracks
from studies.social_gan.config import SocialGANConfig
from studies.social_gan.recordings import read_folder
from studies.social_gan.windows import resample, training_split, windows

HORIZON = 8
"""Steps to predict in a window, after the `HISTORY` observed ones."""

LENGTH = HISTORY + HORIZON

STRIDE = 4
"""Steps from the start of one window of simulated pedestrians to the start of the next."""

TRAINING_CASES = Cases("train", 0, 2000)
"""The cases of a scenario to train on."""

VALIDATION_CASES = Cases("val", 0, 200)


@dataclass(frozen=True)
class Samples:
    """Windows of `HISTORY` observed steps and `HORIZON` steps to predict.

    Attributes:
        position: Positions in metres, relative to the window's first pedestrian in the last observed step; 0 for absent
            pedestrians.
        present: True for pedestrians that are present in all steps of a window; these come first.
    """

    position: Float32[np.ndarray, "window time pedestrian 2"]
    present: Bool[np.ndarray, "window pedestrian"]

    def __len__(self) -> int:
        return len(self.present)


def load_samples(config: SocialGANConfig) -> tuple[Samples, Samples]:
    """Load the windows to train on and to validate on.

    Raises:
        InputError: There is no such scenario, or there are no recordings or no such scene in them, or no episode or
            recording is long enough.
    """
    if config.data is None:
        scenario = load_scenario(config.scenario, config.overrides)
        training, validation = (from_scenario(scenario, cases) for cases in (TRAINING_CASES, VALIDATION_CASES))
    else:
        split = training_split(read_folder(Path(config.data)), config.held_out)
        training, validation = (from_tracks(recordings, config.dt) for recordings in split)
    if not (len(training) and len(validation)):
        raise InputError(f"there is no window of {LENGTH} consecutive steps to train and validate on")
    return training, validation


def from_tracks(recordings: Sequence[RecordedTracks], dt: float | None) -> Samples:
    """Cut recordings into windows.

    Args:
        recordings: The recordings.
        dt: Seconds per step to resample to; None for the steps of the recordings.

    Returns:
        The windows.
    """
    samples = [windows(tracks if dt in (None, tracks.dt) else resample(tracks, dt), LENGTH) for tracks in recordings]
    return _join([_order(part.position, part.present) for part in samples])


def from_scenario(scenario: Scenario, cases: Cases) -> Samples:
    """Simulate windows of a scenario's pedestrians until they reach their goals, in episodes as long as the vehicle's.

    The pedestrians do not see the vehicle, which drives with ORCA. The steps before the start are extrapolated
    backwards from the first displacement, as the predictor does.

    Args:
        scenario: The scenario.
        cases: The cases to run.

    Returns:
        The windows that start at every `STRIDE`-th step.
    """
    blind = dataclasses.replace(scenario, rules=dataclasses.replace(scenario.rules, visible=False))
    trace = rollout(ORCAPlanner(), blind, cases)
    path = trace.position[:, :, 1:]
    back = np.arange(HISTORY - 2, 0, -1)[:, None, None]
    path = np.concatenate([path[:, :1] - back * (path[:, 1:2] - path[:, :1]), path], axis=1)
    persons = np.concatenate([trace.person[:, :1].repeat(len(back), axis=1), trace.person], axis=1)
    samples = []
    for start in range(0, path.shape[1] - LENGTH + 1, STRIDE):
        position = path[:, start : start + LENGTH]
        now = start + HISTORY - 1 - len(back)
        under_way = norm(position[:, HISTORY - 1] - trace.goal[:, now, 1:]) >= trace.radius[:, now, 1:]
        person = persons[:, start : start + LENGTH]
        same = (person == person[:, :1]).all(axis=1) & (person[:, 0] >= 0)
        complete = same & under_way & np.isfinite(position).all(axis=(1, 3))
        samples.append(_order(position[complete.any(axis=1)], complete[complete.any(axis=1)]))
    return _join(samples)


def _order(
    position: Float[np.ndarray, "window time pedestrian 2"], present: Bool[np.ndarray, "window pedestrian"]
) -> Samples:
    """Sort present pedestrians to the front, and make positions relative to the first of them.

    float32 is coarse far from the origin, so positions in metres are made relative before they are converted.
    """
    order = np.argsort(~present, axis=1, kind="stable")
    present = np.take_along_axis(present, order, axis=1)
    position = np.take_along_axis(position, order[:, None, :, None], axis=2)
    near = position - position[:, HISTORY - 1 : HISTORY, :1]
    return Samples(np.where(present[:, None, :, None], near, 0.0).astype(np.float32), present)


def _join(parts: Sequence[Samples]) -> Samples:
    """Join windows in one batch, padded to the largest number of pedestrians."""
    widest = max((part.present.shape[1] for part in parts), default=0)
    padding = [(0, widest - part.present.shape[1]) for part in parts]
    position = [np.pad(part.position, [(0, 0), (0, 0), pad, (0, 0)]) for part, pad in zip(parts, padding, strict=True)]
    present = [np.pad(part.present, [(0, 0), pad]) for part, pad in zip(parts, padding, strict=True)]
    return Samples(np.concatenate(position), np.concatenate(present))
