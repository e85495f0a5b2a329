"""Metrics of what the vehicle costs the pedestrians."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.evaluate.metrics.sums import total
from crowdbench.geometry import norm
from crowdbench.types import Trace


def deflection(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean distance of pedestrians from where they would be in the same case without the vehicle [m].

    Over pedestrians and steps, as long as the same people are there. Undefined where pedestrians do not see the
    vehicle, or there are none.
    """
    if trace.undisturbed is None:
        return np.full(len(trace), np.nan)
    moved = norm(trace.position[:, 1:, 1:] - trace.undisturbed[:, 1:])
    compared = np.isfinite(moved).sum(axis=(1, 2))
    return total(total(moved.swapaxes(1, 2))) / np.where(compared > 0, compared, np.nan)


def imposed_delay(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time that all pedestrians together lose to the vehicle: that of their ways, less that without the vehicle [s].

    Each is expected at its goal when it arrives, or else when it could be there from where it was last, straight on at
    its preferred speed. It is negative where they gain. Compared are the ways, from a start to a goal, that begin alike
    in the same case without the vehicle. A place in the arrays has the preferred speed of its first pedestrian.
    Undefined where pedestrians do not see the vehicle, or there are none.
    """
    ways = _ways(trace)
    if ways is None:
        return np.full(len(trace), np.nan)
    speed = trace.preferred_speed[:, 1:].ravel()[ways.pedestrian]
    times = [end.step * trace.rules.dt + end.remaining / speed for end in (ways.real, ways.alone)]
    return _sum_of_ways(trace, ways, times[0] - times[1])


def imposed_detour(trace: Trace) -> Float[np.ndarray, "world"]:
    """Path that all pedestrians together walk because of the vehicle: that of their ways, less that without it [m].

    The ways are those of `imposed_delay`; what remained at the end of an episode counts as the straight way.
    """
    ways = _ways(trace)
    if ways is None:
        return np.full(len(trace), np.nan)
    lengths = [end.walked + end.remaining for end in (ways.real, ways.alone)]
    return _sum_of_ways(trace, ways, lengths[0] - lengths[1])


class _End(NamedTuple):
    """Where ways ended: at the goal, or where the pedestrian was last.

    Attributes:
        step: Steps done then.
        remaining: Straight way to where the pedestrian arrives, in metres.
        walked: Path from the beginning of the way, in metres.
    """

    step: Int[np.ndarray, "way"]
    remaining: Float[np.ndarray, "way"]
    walked: Float[np.ndarray, "way"]


class _Ways(NamedTuple):
    """The ways of pedestrians that begin alike with and without the vehicle.

    Attributes:
        pedestrian: Whose each is: world times pedestrians, plus pedestrian.
        real: How they ended.
        alone: How they would end without the vehicle.
    """

    pedestrian: Int[np.ndarray, "way"]
    real: _End
    alone: _End


def _sum_of_ways(trace: Trace, ways: _Ways, values: Float[np.ndarray, "way"]) -> Float[np.ndarray, "world"]:
    """The sum over the ways of each world; NaN where there is none."""
    world = ways.pedestrian // max(trace.person.shape[2], 1)
    count = np.bincount(world, minlength=len(trace))
    return np.where(count > 0, np.bincount(world, values, minlength=len(trace)), np.nan)


def _ways(trace: Trace) -> _Ways | None:
    """The ways from a start to a goal that can be compared; None where pedestrians do not see the vehicle.

    A way ends where its pedestrian is another person, has another goal, or is gone.
    """
    if trace.undisturbed is None:
        return None
    goal, person = trace.goal[:, :, 1:], trace.person
    new = (goal[:, 1:] != goal[:, :-1]).any(axis=3) | (person[:, 1:] != person[:, :-1])
    new |= trace.present[:, 1:, 1:] & ~trace.present[:, :-1, 1:]
    begins = np.ones(person.shape, bool)
    begins[:, 1:] = new

    def by_pedestrian(states: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(states.swapaxes(1, 2)).reshape(-1, *states.shape[3:])

    start = np.flatnonzero(by_pedestrian(begins))
    real, alone = by_pedestrian(trace.position[:, :, 1:]), by_pedestrian(trace.undisturbed)
    alike = start[(real[start] == alone[start]).all(axis=1)]
    where = by_pedestrian(goal), by_pedestrian(trace.radius[:, :, 1:])
    pedestrian = alike // person.shape[1]
    walks = trace.preferred_speed[:, 1:].ravel()[pedestrian] > 0.0
    ends = [_end(states, *where, start, person.shape[1]) for states in (real, alone)]
    chosen = np.searchsorted(start, alike[walks])
    return _Ways(pedestrian[walks], *(_End(*(values[chosen] for values in end)) for end in ends))


def _end(
    position: Float[np.ndarray, "state 2"],
    goal: Float[np.ndarray, "state 2"],
    radius: Float[np.ndarray, "state"],
    start: Int[np.ndarray, "way"],
    times: int,
) -> _End:
    """Where ways end.

    Args:
        position: Positions in metres, those of a pedestrian one after the other; NaN where nobody is.
        goal: The goals then, in metres.
        radius: The radii in metres.
        start: The first state of each way; it goes on to the first state of the next one.
        times: The number of states of a pedestrian.
    """
    remaining = norm(goal - position) - radius
    state, last = np.arange(len(position)), len(position)
    known = np.isfinite(remaining)
    arrived = np.minimum.reduceat(np.where(known & (remaining < 0.0), state, last), start)
    end = np.where(arrived < last, arrived, np.maximum.reduceat(np.where(known, state, -1), start))
    end = np.maximum(end, start)  # of a way of nobody, which is not compared
    strides = np.zeros((len(position) // times, times))
    strides[:, 1:] = np.nan_to_num(norm(np.diff(position.reshape(-1, times, 2), axis=1)))
    path = np.cumsum(strides, axis=1).ravel()
    return _End(end % times, np.maximum(remaining[end], 0.0), path[end] - path[start])
