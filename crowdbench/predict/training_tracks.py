"""Recorded tracks to train predictors on: the split into training and validation, and resampling."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from crowdbench.errors import InputError
from crowdbench.tracks.eth_ucy import FRAME_STEP, Tracks, scenes

TRAINING_SHARE = 0.8
"""The part of a file's annotated frames that is for training, as in the data of Social GAN (Gupta et al. 2018)."""

ROUNDING = 1e-6
"""Tolerance in steps: an annotation this close to the time of a step is at this time."""


def training_split(recordings: Sequence[Tracks], held_out: str | None) -> tuple[list[Tracks], list[Tracks]]:
    """Split recordings in time: the first frames of each are for training, the last ones for validation.

    Args:
        recordings: The recordings.
        held_out: The scene to test on, which is left out of both, or None.

    Returns:
        The training part and the validation part of every recording.

    Raises:
        InputError: There is no such scene, or there are no other recordings.
    """
    parts = scenes(recordings)
    if held_out is not None and held_out not in parts:
        raise InputError(f"there is no scene {held_out!r} to hold out; there are {', '.join(parts)}")
    tested = [tracks.name for tracks in parts[held_out]] if held_out is not None else []
    used = [tracks for tracks in recordings if tracks.name not in tested]
    if not used:
        raise InputError(f"nothing is left to train on but the scene {held_out}, which is held out")
    first, last = zip(*map(_cut, used), strict=True)
    return list(first), list(last)


def resampled(tracks: Tracks, dt: float) -> Tracks:
    """Resample a recording by linear interpolation of each pedestrian's positions.

    Positions are interpolated only between consecutive annotated frames, so that a gap in a track stays a gap.

    Args:
        tracks: The recording.
        dt: The new time step in seconds.

    Returns:
        The recording with annotations every `dt` seconds, whose frame numbers differ by `FRAME_STEP` again. The time of
        frame 0 is the same.
    """
    time = tracks.frame / FRAME_STEP * (tracks.dt / dt)
    continued = (np.diff(tracks.pedestrian) == 0) & (np.diff(tracks.frame) == FRAME_STEP)
    continued = np.append(continued, False)
    # The new steps from each row to before the next one; where a track stops or has a gap, at most the row's own time.
    first = np.ceil(time - ROUNDING).astype(np.int64)
    end = np.where(continued, np.roll(first, -1), np.floor(time + ROUNDING).astype(np.int64) + 1)
    row = np.repeat(np.arange(len(time)), end - first)
    step = np.arange(len(row)) - np.searchsorted(row, row) + first[row]
    part = np.where(continued[row], (step - time[row]) * dt / tracks.dt, 0.0)
    moved = np.roll(tracks.position, -1, axis=0) - tracks.position
    position = tracks.position[row] + part[:, None] * moved[row]
    return Tracks(tracks.name, step * FRAME_STEP, tracks.pedestrian[row], position, dt)


def _cut(tracks: Tracks) -> tuple[Tracks, Tracks]:
    """The first and the last frames of a recording."""
    frames = np.unique(tracks.frame)
    early = tracks.frame < frames[int(TRAINING_SHARE * len(frames))]
    return _rows(tracks, early), _rows(tracks, ~early)


def _rows(tracks: Tracks, kept: Bool[np.ndarray, "row"]) -> Tracks:
    """Some rows of a recording."""
    return dataclasses.replace(
        tracks, frame=tracks.frame[kept], pedestrian=tracks.pedestrian[kept], position=tracks.position[kept]
    )
