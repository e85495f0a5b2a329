"""The CLEAR MOT metrics of tracks (Bernardin and Stiefelhagen 2008), counted in each step of episodes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

NEAR = 0.5
"""Largest distance in metres between a track and its person, as in the evaluation of DROW and DR-SPAAM."""


@dataclass
class Counts:
    """Counts over the steps of one episode.

    Attributes:
        steps: Number of steps.
        people: Sum over the steps of the number of people that could be seen without occlusion.
        misses: Sum over the steps of the number of these people without a track.
        false: Sum over the steps of the number of tracks without a person.
        switches: Number of times that the track of a person has another identity than that person's last track.
        distances: Distance in metres from each person to its track, in all steps.
        speeds: Difference in m/s between the velocities of a person and its track, in all steps.
    """

    steps: int = 0
    people: int = 0
    misses: int = 0
    false: int = 0
    switches: int = 0
    distances: list[float] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    _last: dict[int, int] = field(default_factory=dict)

    def add(
        self,
        person: Int[np.ndarray, "person"],
        truth: Float[np.ndarray, "person 4"],
        is_near: Bool[np.ndarray, "person"],
        identity: Int[np.ndarray, "track"],
        tracks: Float[np.ndarray, "track 4"],
    ) -> None:
        """Count a step.

        A person keeps its track as long as both are within `NEAR`. The others are matched by the smallest sum of
        distances.

        Args:
            person: Numbers of all people.
            truth: Their positions in metres and velocities in m/s.
            is_near: True for people that could be seen without occlusion; the others count neither as seen nor missed.
            identity: Numbers of the tracks.
            tracks: The same of the tracks.
        """
        distance = np.hypot(*(truth[:, None, :2] - tracks[None, :, :2]).transpose(2, 0, 1))
        cost = np.where(distance < NEAR, distance, 1e3)
        for row, number in enumerate(person.tolist()):
            cost[row, (identity == self._last.get(number)) & (distance[row] < NEAR)] -= 1e2
        rows, columns = linear_sum_assignment(cost)
        matched = distance[rows, columns] < NEAR
        rows, columns = rows[matched], columns[matched]
        counted = is_near[rows]
        for number, track in zip(person[rows].tolist(), identity[columns].tolist(), strict=True):
            self.switches += self._last.get(number, track) != track
            self._last[number] = track
        self.steps += 1
        self.people += int(is_near.sum())
        self.misses += int(is_near.sum() - counted.sum())
        self.false += len(identity) - len(rows)
        off = (truth[rows] - tracks[columns])[counted]
        self.distances += np.hypot(off[:, 0], off[:, 1]).tolist()
        self.speeds += np.hypot(off[:, 2], off[:, 3]).tolist()
