"""The tracks of a recording: their speeds are checked, and tracks of several pedestrians are split."""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.utils.errors import InputError

FRAME_STEP = 10
"""Difference between the numbers of two consecutive annotated frames."""

ETH_UCY_DT = 0.4
"""Seconds between two consecutive annotated frames."""

LONGEST_ABSENCE = 4.0
"""Seconds without an annotation after which a number denotes another pedestrian."""

FASTEST = 10.0
"""Speed in m/s above which two annotations belong to two pedestrians. The largest speed in ETH/UCY is 6.5 m/s."""

WALKING = (0.2, 3.0)
"""Typical speeds in m/s outside which a warning is logged. In the files of ETH/UCY they are 0.5 to 2.4 m/s."""

MOST_TYPICAL = 5.0
"""Largest typical speed in m/s: no crowd runs faster."""

STRETCH = 1.0
"""Seconds over which typical speeds are measured: over shorter times they are mostly noise of the annotations."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecordedTracks:
    """The annotations of one recording, a row each, ordered by pedestrian and then by frame.

    Attributes:
        name: The name of the file, without suffix.
        frame: The number of the frame.
        pedestrian: The number of the pedestrian.
        position: Position in metres.
        dt: Seconds between two consecutive annotated frames, whose numbers differ by `FRAME_STEP`.
    """

    name: str
    frame: Int[np.ndarray, "row"]
    pedestrian: Int[np.ndarray, "row"]
    position: Float[np.ndarray, "row 2"]
    dt: float = ETH_UCY_DT

    @property
    def seconds(self) -> Float[np.ndarray, "row"]:
        """The time of each annotation in seconds."""
        return self.frame / FRAME_STEP * self.dt


def check_speeds(tracks: RecordedTracks) -> None:
    """Check that the typical speed is that of pedestrians. A warning is logged if it is unusual.

    Raises:
        InputError: The typical speed is impossible, or typical annotations of a pedestrian are too far apart in time.
    """
    starts = np.flatnonzero(np.diff(tracks.pedestrian, prepend=np.nan))
    length = int(np.median(np.diff(starts, append=len(tracks.frame))))
    interval = np.diff(tracks.seconds)[np.diff(tracks.pedestrian) == 0]
    if not len(interval):
        return
    usual = float(np.median(interval))
    if usual > LONGEST_ABSENCE:
        raise InputError(
            f"{tracks.name}: positions of a pedestrian are typically {usual:g} s apart, so these are no seconds: set "
            "tracks.frame_rate, the frames or units of time per second"
        )
    ahead = int(np.clip(round(STRETCH / usual), 1, max(length - 1, 1)))
    seconds = tracks.seconds[ahead:] - tracks.seconds[:-ahead]
    distance = np.hypot(*(tracks.position[ahead:] - tracks.position[:-ahead]).T)
    same = (tracks.pedestrian[ahead:] == tracks.pedestrian[:-ahead]) & (seconds <= LONGEST_ABSENCE) & (distance > 0.0)
    if not same.any():
        return
    speed = float(np.median(distance[same] / seconds[same]))
    keys = "tracks.scale, the metres of a pixel or other unit, or tracks.frame_rate, the frames per second"
    if speed > MOST_TYPICAL:
        raise InputError(
            f"{tracks.name}: pedestrians typically move at {speed:.3g} m/s, which is impossible, so these are no "
            f"metres: set {keys}"
        )
    if not WALKING[0] <= speed <= WALKING[1]:
        _LOG.warning(
            "%s: pedestrians typically move at %.2g m/s, which is unusual; if these are no metres, set %s",
            tracks.name,
            speed,
            keys,
        )


def split_reused_numbers(tracks: RecordedTracks) -> RecordedTracks:
    """Give a new number to each pedestrian that has the number of an earlier one.

    Two annotations with one number belong to two pedestrians if more than `LONGEST_ABSENCE` lies between them, or if
    the speed between them is above `FASTEST`. A warning with the number of new tracks is logged.
    """
    seconds = np.diff(tracks.seconds)
    distance = np.hypot(*np.diff(tracks.position, axis=0).T)
    is_same = np.diff(tracks.pedestrian) == 0
    absent = is_same & (seconds > LONGEST_ABSENCE)
    jumped = is_same & ~absent & (distance > FASTEST * seconds)
    splits = 1 + np.flatnonzero(absent | jumped)
    if not len(splits):
        return tracks
    _LOG.warning(
        "%s: %d tracks were split: %d where a pedestrian was absent for more than %g s, %d where one was faster than "
        "%g m/s",
        tracks.name,
        len(splits),
        absent.sum(),
        LONGEST_ABSENCE,
        jumped.sum(),
        FASTEST,
    )
    pedestrian = tracks.pedestrian.copy()
    ends = np.append(1 + np.flatnonzero(np.diff(tracks.pedestrian)), len(pedestrian))
    for number, first in enumerate(splits, pedestrian.max() + 1):
        pedestrian[first : ends[np.searchsorted(ends, first, side="right")]] = number
    order = np.lexsort((tracks.frame, pedestrian))
    return dataclasses.replace(
        tracks, frame=tracks.frame[order], pedestrian=pedestrian[order], position=tracks.position[order]
    )
