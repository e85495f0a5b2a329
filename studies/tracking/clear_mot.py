"""The CLEAR MOT metrics of tracks (Bernardin and Stiefelhagen 2008), counted in each step of episodes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from crowdbench import Scenario, World, rollout
from crowdbench.core import norm
from crowdbench.metrics import bootstrap_distribution, interval

NEAR = 0.5
"""Largest distance in metres between a track and its person, as in the evaluation of DR-SPAAM (Jia et al. 2020)."""


@dataclass
class Counts:
    """Counts over the steps of one episode.

    Attributes:
        dt: Length of a step in seconds.
        steps: Number of steps.
        people: Sum over the steps of the number of people that could be seen without occlusion.
        false: Sum over the steps of the number of tracks without a person.
        switches: Number of times that the track of a person has another identity than that person's last track.
        seen: Sum over the steps of the number of these people with a track.
        distance: Sum over these people and their steps of the distance in metres to their tracks.
        speed: The same of the difference in m/s between the velocities of a person and its track.
    """

    dt: float
    steps: int = 0
    people: int = 0
    false: int = 0
    switches: int = 0
    seen: int = 0
    distance: float = 0.0
    speed: float = 0.0
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
        off = (truth[rows] - tracks[columns])[counted]
        self.steps += 1
        self.people += int(is_near.sum())
        self.seen += int(counted.sum())
        self.false += len(identity) - len(rows)
        self.distance += float(norm(off[:, :2]).sum())
        self.speed += float(norm(off[:, 2:]).sum())


def count(planner: str, scenario: Scenario, cases: str) -> list[Counts]:
    """Return the counts of each case of a scenario with a detector, driven by a planner."""
    dt = scenario.rules.dt
    counts: dict[int, Counts] = defaultdict(lambda: Counts(dt))
    reach = scenario.rules.sensor.range or np.inf

    def watch(world: World) -> None:
        gap = norm(world.position[:, 1:] - world.position[:, :1]) - world.radius[:, 1:] - world.radius[:, :1]
        truth = np.concatenate([world.position, world.velocity], axis=2)[:, 1:]
        for row, case in enumerate(world.case.tolist()):
            there, shown = world.present[row, 1:], world.sight["unseen"][row] >= 0
            people = world.person[row, there], truth[row, there], (gap <= reach)[row, there]
            counts[case].add(*people, world.sight["identity"][row, shown], world.sight["state"][row, shown, :4])

    trace = rollout(planner, scenario, cases, undisturbed=False, watch=watch)
    return [counts[case] for case in trace.case.tolist()]


ESTIMATES: Mapping[str, tuple[Callable[[Counts], float], Callable[[Counts], float], int]] = {
    "MOTA": (lambda each: each.seen - each.false - each.switches, lambda each: each.people, 2),
    "position error [m]": (lambda each: each.distance, lambda each: each.seen, 2),
    "velocity error [m/s]": (lambda each: each.speed, lambda each: each.seen, 2),
    "missed [%]": (lambda each: each.people - each.seen, lambda each: 0.01 * each.people, 1),
    "false tracks": (lambda each: each.false, lambda each: each.steps, 2),
    "switches [1/min]": (lambda each: each.switches, lambda each: each.people * each.dt / 60.0, 1),
}
"""Two sums of an episode, and the digits of their ratio, by the heading of the column."""


def estimate(name: str, counts: Sequence[Counts]) -> str:
    """Return one of `ESTIMATES` over episodes, with its interval."""
    above, below, digits = ESTIMATES[name]
    values = np.array([above(each) for each in counts], float), np.array([below(each) for each in counts], float)

    def ratio(one: np.ndarray, two: np.ndarray, axis: int) -> np.ndarray:
        return np.asarray(one.sum(axis=axis) / two.sum(axis=axis))

    low, high = interval(bootstrap_distribution(ratio, *values))
    return f"{float(ratio(*values, axis=-1)):.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
