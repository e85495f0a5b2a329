"""Windows of recorded tracks: consecutive frames, of which a predictor sees the first ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import rng
from crowdbench.tracks.eth_ucy import FRAME_STEP, Tracks
from crowdbench.types import Observation, Pedestrians, Vehicle

FEWEST = 2
"""The smallest number of pedestrians in a window, as in the evaluation of Social GAN (Gupta et al. 2018)."""


@dataclass(frozen=True)
class Windows:
    """A batch of windows: consecutive annotated frames with the pedestrians that are there in all of them.

    Attributes:
        frame: The number of the first frame of each window.
        pedestrian: The numbers of the pedestrians, 0 where none is `present`.
        present: Whether there is a pedestrian; the others are padding.
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
        """The windows of the given rows."""
        return Windows(self.frame[rows], self.pedestrian[rows], self.present[rows], self.position[rows], self.dt)

    def observation(self, seen: int) -> Observation:
        """The observation of each window, for a predictor.

        The noise depends on the number of the first frame, as elsewhere on the case. There is no vehicle: its values
        are NaN. Recordings have no radii: they are 0.

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
            noise_key=rng.noise_keys(rng.case_keys(0, "test", self.frame)),
            step=np.full(len(self), seen - 1),
            dt=self.dt,
        )


def windows(tracks: Tracks, length: int) -> Windows:
    """All windows of a recording, one for every annotated frame that it can start at.

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


def _padded(tracks: Tracks, first: Int[np.ndarray, "stretch"], length: int) -> Windows:
    """Windows, padded to the largest number of pedestrians.

    Args:
        tracks: The recording.
        first: The row of each pedestrian's first frame in a window; rows of the same window follow each other.
        length: Number of frames of a window.

    Returns:
        The windows.
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
