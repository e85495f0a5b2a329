"""Recorded tracks to train predictors on: which of them, and in steps of which length."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from crowdbench.errors import InputError
from crowdbench.predict.tracks import FRAME_STEP, Tracks, scenes

TRAINING_SHARE = 0.8
"""Of a file's annotated frames, how many are for training: where Social GAN (Gupta et al. 2018) cut all of ETH/UCY."""

ROUNDING = 1e-6
"""Steps by which an annotation may miss one and still count as being at it."""


def training_split(recordings: Sequence[Tracks], held_out: str | None) -> tuple[list[Tracks], list[Tracks]]:
    """What to train on and what to validate on: the first and the last frames of every recording.

    The recordings of the scene `held_out`, which is to be tested on, are in neither. Raises InputError where there is
    no such scene, or nothing else.
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
    """The same recording in steps of `dt` seconds, each pedestrian's position interpolated linearly.

    Frame 0 stays frame 0, and one step is `FRAME_STEP` frames again. Gaps stay gaps: only between two annotations
    that follow each other is anything known.
    """
    time = tracks.frame / FRAME_STEP * (tracks.dt / dt)
    goes_on = (np.diff(tracks.pedestrian) == 0) & (np.diff(tracks.frame) == FRAME_STEP)
    goes_on = np.append(goes_on, False)
    # The steps from each row up to the next one, without it; a pedestrian's last row has at most its own.
    first = np.ceil(time - ROUNDING).astype(np.int64)
    end = np.where(goes_on, np.roll(first, -1), np.floor(time + ROUNDING).astype(np.int64) + 1)
    row = np.repeat(np.arange(len(time)), end - first)
    step = np.arange(len(row)) - np.searchsorted(row, row) + first[row]
    share = np.where(goes_on[row], (step - time[row]) * dt / tracks.dt, 0.0)
    moved = np.roll(tracks.position, -1, axis=0) - tracks.position
    position = tracks.position[row] + share[:, None] * moved[row]
    return Tracks(tracks.name, step * FRAME_STEP, tracks.pedestrian[row], position, dt)


def _cut(tracks: Tracks) -> tuple[Tracks, Tracks]:
    frames = np.unique(tracks.frame)
    early = tracks.frame < frames[int(TRAINING_SHARE * len(frames))]
    return _rows(tracks, early), _rows(tracks, ~early)


def _rows(tracks: Tracks, kept: Bool[np.ndarray, "row"]) -> Tracks:
    return dataclasses.replace(
        tracks, frame=tracks.frame[kept], pedestrian=tracks.pedestrian[kept], position=tracks.position[kept]
    )
