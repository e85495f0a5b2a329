"""Metrics of encounters of the vehicle with pedestrians: times to collision and between them, near misses, speed."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics import disc_centres
from crowdbench.core.geometry import dot, least_distance, norm
from crowdbench.core.types import DISCOMFORT_GAP, Trace
from crowdbench.metrics.distances import HALL_ZONES
from crowdbench.metrics.info import describe, finite_or_nan, total
from crowdbench.utils.compiled import njit

NEAR_TIME = 1.0
"""Time to collision in seconds below which an encounter is a near miss.

Measured: 2 % of the 14,766 encounters of two pedestrians in six recordings of ETH/UCY have a shorter time. Encounters
are defined as here, for discs of 0.3 m that do not overlap and mostly have a relative speed of 0.5 m/s or more.
"""

TINY = 1e-200
"""Instead of the square of a displacement of 0, so that nothing is divided by 0."""

Counts = Int[np.ndarray, "world"]
Pairs = Float[np.ndarray, "world step pedestrian"]


@describe("time to collision", "more", of_successes=True)
def time_to_collision(trace: Trace) -> Float[np.ndarray, "world"]:
    """Smallest time until the vehicle would touch a pedestrian at the velocities of the step, over successes [s].

    Undefined in an episode in which they would never touch.
    """
    return finite_or_nan(np.min(_approach(trace)[1], axis=(1, 2), initial=np.inf))


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
    """Near misses, as in `near_misses`, per hour of presence of a pedestrian, over successes [1/h].

    n / (3600 sum_t P_t dt) with P_t the number of pedestrians in step t. Undefined without pedestrians.
    """
    _, near, presence = _count_encounters(trace)
    return near / np.where(presence > 0, presence * trace.rules.dt / 3600.0, np.nan)


@describe("post-encroachment time", "more", of_successes=True, source="Allen et al. (1978)")
def post_encroachment_time(trace: Trace) -> Float[np.ndarray, "world"]:
    """Least time between one body leaving a point and the other one reaching it, over successes [s].

    min |t - s| over the times s and t at which the discs of the vehicle at s and of a pedestrian at t overlap. It is
    the entry time of the second body minus the exit time of the first (Allen, Shin and Cooper 1978), with the extent of
    the bodies, and the least over all points of the conflict area (Gettman et al. 2008). 0 would be a contact. It also
    counts if one follows the other. Thresholds from road traffic, such as 5 s, do not apply to pedestrians. Undefined
    in an episode in which vehicle and pedestrians cover separate areas, see `paths_apart`.
    """
    return _encroach(trace)


@describe("separate paths", share=True, of_successes=True)
def paths_apart(trace: Trace) -> Float[np.ndarray, "world"]:
    """Share of successes without a `post_encroachment_time`: the vehicle and pedestrians cover separate areas [1]."""
    return 1.0 * np.isnan(_encroach(trace))


@describe("speed near pedestrians", "less", of_successes=True)
def speed_near_pedestrians(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean speed of the vehicle while it is within Hall's personal distance of a pedestrian, over successes [m/s].

    sum_t |v_t| [g_t < 1.2 m] / sum_t [g_t < 1.2 m] with the vehicle's velocity v_t in step t, and the smallest gap g_t
    in it. The distance is that of Hall (1966); the definition is ours. Undefined in an episode without such a step.
    """
    near = trace.gap < HALL_ZONES["personal"]
    steps = near.sum(axis=1)
    return total(np.where(near, norm(trace.velocity[:, 1:, 0]), 0.0)) / np.where(steps > 0, steps, np.nan)


def _approach(trace: Trace) -> tuple[Pairs, Pairs]:
    """Return the smallest gap of each pedestrian in each step, in m, and the time to collision at its start, in s.

    The gap is NaN if the pedestrian is absent or replaced. The time is infinite if the two would never touch.
    """
    discs = disc_centres(trace.rules.body, trace.position[:, :, 0], trace.heading)
    offset = trace.position[:, :, 1:, None] - discs[:, :, None]
    between, motion = offset[:, :-1], np.diff(offset, axis=1)
    velocity = (trace.velocity[:, 1:, 1:] - trace.velocity[:, 1:, :1])[..., None, :]
    reach = (trace.radius[:, :-1, 1:] + trace.radius[:, :-1, :1])[..., None]
    same = trace.person[:, :-1] == trace.person[:, 1:]
    gap = np.min(least_distance(between, motion) - reach, axis=3)
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


def _encroach(trace: Trace) -> Float[np.ndarray, "world"]:
    """Return the post-encroachment time of each world in seconds, NaN where it is undefined."""
    discs = disc_centres(trace.rules.body, trace.position[:, :, 0], trace.heading)
    x, y = np.concatenate([discs, trace.position[:, :, 1:]], axis=2).transpose(3, 0, 2, 1)
    motion, number = np.diff(x + 1j * y, axis=2), discs.shape[2]
    motion[:, number:][(np.diff(trace.person, axis=1) != 0).swapaxes(1, 2)] = np.nan
    least = np.full(len(trace), np.inf)
    repeats = np.ones(trace.radius.shape[2], int)
    repeats[0] = number  # each disc of the vehicle has its radius
    radius = np.repeat(trace.radius, repeats, axis=2).swapaxes(1, 2)
    _find_least_lags((x + 1j * y)[..., :-1], motion, radius, number, np.nanmax(np.abs(motion), initial=0.0), least)
    return finite_or_nan(least * trace.rules.dt)


@no_type_check
@njit
def _find_least_lags(position, motion, radius, discs, longest, least):
    """Find the least post-encroachment time of each world, in steps.

    Args:
        position: `[world, disc, step]`, complex, the discs of the vehicle and then the pedestrians, in metres.
        motion: `[world, disc, step]`, their displacements; NaN where there is none.
        radius: `[world, disc, time]`, in metres.
        discs: The number of discs of the vehicle.
        longest: The longest displacement in metres.
        least: `[world]`, changed; infinite if it is undefined.
    """
    for w in range(len(least)):
        for a in range(discs):
            for b in range(discs, position.shape[1]):
                for first, second in ((a, b), (b, a)):
                    least[w] = _least_lag(position[w], motion[w], radius[w], first, second, longest, least[w])


@no_type_check
@njit
def _least_lag(position, motion, radius, first, second, longest, least):
    """Return the steps between the first disc leaving a point and the second one reaching it, at most `least`."""
    steps = position.shape[1]
    for lag in range(steps):
        if lag - 1 >= least:
            break
        for t in range(steps - lag):
            offset, reach = position[second, t + lag] - position[first, t], radius[first, t] + radius[second, t + lag]
            if offset.real**2 + offset.imag**2 <= (reach + 2.0 * longest) ** 2:
                one, two = motion[first, t], motion[second, t + lag]
                x, y, ax, ay, bx, by = offset.real, offset.imag, one.real, one.imag, two.real, two.imag
                if lag == 0 and _within(x, y, bx - ax, by - ay, reach)[0] <= 1.0:
                    return 0.0
                between = lag + _least_difference(x, y, ax, ay, bx, by, reach)
                if 0.0 <= between < least:
                    least = between
    return least


@no_type_check
@njit
def _least_difference(x, y, ax, ay, bx, by, reach):
    """Return the least t - s with |(x, y) + t (bx, by) - s (ax, ay)| <= reach, both from 0 to 1; infinite if none.

    In real numbers: complex ones take three times as long to compile.
    """
    least = np.inf
    for end in (0.0, 1.0):
        least = min(least, _within(x - end * ax, y - end * ay, bx, by, reach)[0] - end)
        least = min(least, end - _within(x + end * bx, y + end * by, -ax, -ay, reach)[1])
    # If neither is at an end, the vector between the centres is perpendicular to the relative motion.
    area, relative_x, relative_y = ax * by - ay * bx, ax - bx, ay - by
    if area != 0.0:
        relative = math.hypot(relative_x, relative_y)
        for side in (reach, -reach):
            across_x, across_y = side * relative_y / relative - x, -side * relative_x / relative - y
            s, t = (bx * across_y - by * across_x) / area, (ax * across_y - ay * across_x) / area
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                least = min(least, t - s)
    return least


@no_type_check
@njit
def _within(x, y, dx, dy, reach):
    """Return the bounds of the shares s of a step with |(x, y) + s (dx, dy)| <= reach; infinite and -infinite if none.

    Args:
        x: x of the vector between the centres at its start, in metres.
        y: Its y.
        dx: x of its change in the step in metres.
        dy: Its y.
        reach: The sum of the radii in metres.
    """
    a, b = max(math.hypot(dx, dy) ** 2, TINY), x * dx + y * dy
    root = b * b - a * (math.hypot(x, y) ** 2 - reach**2)
    if not root >= 0.0:
        return np.inf, -np.inf
    low, high = max((-b - math.sqrt(root)) / a, 0.0), min((-b + math.sqrt(root)) / a, 1.0)
    return (low, high) if low <= high else (np.inf, -np.inf)
