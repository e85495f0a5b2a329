"""Recorded tracks as input of predictors: windows of consecutive frames, the split for training, resampling."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import InputError, Observation
from crowdbench.core import Pedestrians, Vehicle, case_keys, noise_keys
from crowdbench.scenario import FRAME_STEP, RecordedTracks
from studies.social_gan.recordings import scenes

FEWEST = 2
"""The smallest number of pedestrians in a window, as in the evaluation of Social GAN (Gupta et al. 2018)."""

TRAINING_SHARE = 0.8
"""The part of a file's annotated frames that is for training, as in the data of Social GAN (Gupta et al. 2018)."""

ROUNDING = 1e-6
"""Tolerance in steps: an annotation this close to the time of a step is at this time."""


@dataclass(frozen=True)
class Windows:
    """A batch of windows: consecutive annotated frames with the pedestrians that are present in all of them.

    Attributes:
        frame: The number of the first frame of each window.
        pedestrian: The numbers of the pedestrians, 0 where none is `present`.
        present: True if there is a pedestrian; the others are padding.
        position: Positions in metres, 0 where no pedestrian is `present`.
        dt: Seconds between two consecutive frames.
    """

    frame: Int[np.ndarray, "window"]
    pedestrian: Int[np.ndarray, "window pedestrian"]
    present: Bool[np.ndarray, "window pedestrian"]
    position: Float[np.ndarray, "window time pedestrian 2"]
    dt: float

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, rows: slice | np.ndarray) -> Windows:
        """Return the windows of the given rows."""
        return Windows(self.frame[rows], self.pedestrian[rows], self.present[rows], self.position[rows], self.dt)

    def observation(self, seen: int) -> Observation:
        """Return the observation of each window, for a predictor.

        The noise depends on the number of the first frame, instead of the case. There is no vehicle: its values are
        NaN. Recordings have no radii: they are 0.

        Args:
            seen: Number of frames that are observed, the first ones of a window; the last of them is the present.

        Returns:
            The observation, a world per window.
        """
        # A copy, so that a predictor that changes its observation does not change the recording.
        history = self.position[:, :seen].copy()
        nowhere = np.full((len(self), 2), np.nan)
        return Observation(
            vehicle=Vehicle(
                position=nowhere,
                velocity=nowhere,
                heading=nowhere[:, 0],
                angular_speed=nowhere[:, 0],
                goal=nowhere,
                route=np.empty((len(self), 0, 2)),
                waypoint=np.zeros(len(self), np.int64),
                radius=nowhere[:, 0],
                preferred_speed=nowhere[:, 0],
            ),
            pedestrians=Pedestrians(
                position=history[:, -1],
                velocity=(history[:, -1] - history[:, -2]) / self.dt,
                radius=np.zeros(self.present.shape),
                seen=self.present.copy(),
                history=history,
                observed=np.where(self.present, seen, 0),
                age=np.where(self.present, 0.0, np.inf),
            ),
            obstacles=np.empty((len(self), 0, 0, 2)),
            row=np.arange(len(self)),
            noise_key=noise_keys(case_keys(0, "test", self.frame)),
            step=np.full(len(self), seen - 1),
            dt=self.dt,
        )


def windows(tracks: RecordedTracks, length: int) -> Windows:
    """Return all windows of a recording, one for every annotated frame that it can start at.

    A window has the pedestrians that are annotated in all its frames. It is left out if there are fewer than `FEWEST`.

    Args:
        tracks: The recording.
        length: Number of frames of a window.

    Returns:
        The windows, ordered by frame.
    """
    first = np.arange(len(tracks.frame) - length + 1)
    last = first + length - 1
    # Rows are sorted and unique. If `length - 1` rows later it is the same pedestrian and as many frames later, no
    # frame is missing in between.
    complete = (tracks.pedestrian[first] == tracks.pedestrian[last]) & (
        tracks.frame[last] - tracks.frame[first] == FRAME_STEP * (length - 1)
    )
    first = first[complete]
    first = first[np.argsort(tracks.frame[first], kind="stable")]
    _, window, count = np.unique(tracks.frame[first], return_inverse=True, return_counts=True)
    return _padded(tracks, first[count[window] >= FEWEST], length)


def _padded(tracks: RecordedTracks, first: Int[np.ndarray, "stretch"], length: int) -> Windows:
    """Return windows, padded to the largest number of pedestrians.

    `first` has the row of each pedestrian's first frame in a window; rows of the same window follow each other.
    """
    frame, start, window, count = np.unique(
        tracks.frame[first], return_index=True, return_inverse=True, return_counts=True
    )
    widest = int(count.max(initial=0))
    place = np.arange(len(first)) - start[window]
    pedestrian = np.zeros((len(frame), widest), np.int64)
    present = np.zeros((len(frame), widest), bool)
    position = np.zeros((len(frame), length, widest, 2))
    pedestrian[window, place] = tracks.pedestrian[first]
    present[window, place] = True
    position[window, :, place] = tracks.position[first[:, None] + np.arange(length)]
    return Windows(frame, pedestrian, present, position, tracks.dt)


def training_split(
    recordings: Sequence[RecordedTracks], held_out: str | None
) -> tuple[list[RecordedTracks], list[RecordedTracks]]:
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


def resample(tracks: RecordedTracks, dt: float) -> RecordedTracks:
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
    # The new steps from each row to before the next one; if a track ends or has a gap, at most the time of the row.
    first = np.ceil(time - ROUNDING).astype(np.int64)
    end = np.where(continued, np.roll(first, -1), np.floor(time + ROUNDING).astype(np.int64) + 1)
    row = np.repeat(np.arange(len(time)), end - first)
    step = np.arange(len(row)) - np.searchsorted(row, row) + first[row]
    part = np.where(continued[row], (step - time[row]) * dt / tracks.dt, 0.0)
    moved = np.roll(tracks.position, -1, axis=0) - tracks.position
    position = tracks.position[row] + part[:, None] * moved[row]
    return RecordedTracks(tracks.name, step * FRAME_STEP, tracks.pedestrian[row], position, dt)


def _cut(tracks: RecordedTracks) -> tuple[RecordedTracks, RecordedTracks]:
    """Return the first and the last frames of a recording."""
    frames = np.unique(tracks.frame)
    early = tracks.frame < frames[int(TRAINING_SHARE * len(frames))]
    arrays = {"frame": tracks.frame, "pedestrian": tracks.pedestrian, "position": tracks.position}
    first, last = (
        dataclasses.replace(tracks, **{name: array[rows] for name, array in arrays.items()}) for rows in (early, ~early)
    )
    return first, last
