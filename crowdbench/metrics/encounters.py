"""Metrics of encounters of the vehicle with pedestrians: the time to collision, and near misses."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics import disc_centres
from crowdbench.core.geometry import dot, norm
from crowdbench.core.types import DISCOMFORT_GAP, Trace
from crowdbench.metrics.distances import HALL_ZONES
from crowdbench.metrics.info import describe

NEAR_TIME = 1.0
"""Time to collision in seconds below which an encounter is a near miss.

Measured: 2 % of the 14,766 encounters of two people in six recordings of ETH/UCY have a shorter one. They are
defined as here, for discs of 0.3 m that do not overlap and mostly have a relative speed of 0.5 m/s or more.
"""

Counts = Int[np.ndarray, "world"]
Pairs = Float[np.ndarray, "world step pedestrian"]


@describe("time to collision", "more", of_successes=True)
def time_to_collision(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest time until the vehicle would touch a pedestrian at the velocities of the step, over successes [s].

    Undefined in an episode in which they would never touch.
    """
    least = np.min(_approach(trace)[1], axis=(1, 2), initial=np.inf)
    return np.where(np.isfinite(least), least, np.nan)


@describe("near misses", "less", share=True, of_successes=True)
def near_misses(trace: Trace) -> Float[np.ndarray, "world"]:
    """Near misses per encounter of the vehicle with a pedestrian, over successes [1].

    n / N. An encounter is a time without a break in which the gap g of a pedestrian is below 3.6 m, the social distance
    of Hall (1966). It is a near miss if in one of its steps g < 0.2 m (Chen et al. 2019), or the time to collision of
    `time_to_collision` is below `NEAR_TIME`. No encounter of a success has a contact. The definition is ours.
    Undefined in an episode without an encounter.
    """
    encounters, near, _ = _count_encounters(trace)
    return near / np.where(encounters > 0, encounters, np.nan)


@describe("near misses per hour", "less", digits=1, of_successes=True)
def near_misses_per_hour(trace: Trace) -> Float[np.ndarray, "world"]:
    """Near misses, as in `near_misses`, per hour that a pedestrian is there, over successes [1/h].

    n / (3600 sum_t P_t dt) with P_t the number of pedestrians in step t. Undefined where there are no pedestrians.
    """
    _, near, people = _count_encounters(trace)
    return near / np.where(people > 0, people * trace.rules.dt / 3600.0, np.nan)


def _approach(trace: Trace) -> tuple[Pairs, Pairs]:
    """Return the smallest gap of each pedestrian in each step, in m, and the time to collision at its start, in s.

    The gap is NaN where the pedestrian is not there or changes. The time is infinite where the two would never touch.
    """
    discs = disc_centres(trace.rules.body, trace.position[:, :, 0], trace.heading)
    offset = trace.position[:, :, 1:, None] - discs[:, :, None]
    between, motion = offset[:, :-1], np.diff(offset, axis=1)
    velocity = (trace.velocity[:, 1:, 1:] - trace.velocity[:, 1:, :1])[..., None, :]
    reach = (trace.radius[:, :-1, 1:] + trace.radius[:, :-1, :1])[..., None]
    same = trace.person[:, :-1] == trace.person[:, 1:]
    squared = dot(motion, motion)
    nearest = np.clip(-dot(between, motion) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    gap = np.min(norm(between + nearest[..., None] * motion) - reach, axis=3)
    a, b, c = dot(velocity, velocity), dot(between, velocity), dot(between, between) - reach**2
    root = b**2 - a * c
    meets = (b < 0) & (root >= 0) & same[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(meets, c / (np.sqrt(np.where(meets, root, 0.0)) - b), np.inf)
    return np.where(same, gap, np.nan), np.maximum(np.min(time, axis=3), 0.0)


def _count_encounters(trace: Trace) -> tuple[Counts, Counts, Counts]:
    """Return the number of encounters of each world, of near misses among them, and of steps of all pedestrians."""
    gap, time = _approach(trace)
    close = gap < HALL_ZONES["social"]
    near = close & ((gap < DISCOMFORT_GAP) | (time < NEAR_TIME))
    begins = close.copy()
    begins[:, 1:] &= ~close[:, :-1] | (trace.person[:, 1:-1] != trace.person[:, :-2])
    # Encounters are numbered along the steps of each pedestrian: one is near if its number is new among the near steps.
    number = np.where(near, np.cumsum(begins, axis=1), 0)
    before = np.maximum.accumulate(number, axis=1)
    first = near.copy()
    first[:, 1:] &= number[:, 1:] > before[:, :-1]
    return begins.sum(axis=(1, 2)), first.sum(axis=(1, 2)), np.isfinite(gap).sum(axis=(1, 2))
