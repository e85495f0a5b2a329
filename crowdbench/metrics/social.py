"""Metrics of the vehicle's cost to pedestrians: deflection, delay, detour, and social work."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.arrays import Vectors
from crowdbench.core.geometry import norm, wrap_angle
from crowdbench.core.types import Trace
from crowdbench.metrics.info import UNDISTURBED, describe, total

Values = Float[np.ndarray, "world"]
Trips = Float[np.ndarray, "trip"]
Starts = Int[np.ndarray, "trip"]

STRENGTH = 2.1
"""Strength of the social force in m/s^2; it and the next four are taken from HuNavSim."""

VELOCITY_WEIGHT = 2.0
"""Moussaïd's lambda in s/m: the weight of the relative velocity, compared with the direction to the other agent."""

RANGE = 0.35
"""Moussaïd's gamma in m, times the length of the interaction vector."""

TURNING = 2.0
"""Moussaïd's n in 1/m, of the force that turns."""

BRAKING = 3.0
"""Moussaïd's n' in 1/m, of the force that brakes."""

OBSTACLE_STRENGTH = 10.0
"""Strength of the force of the nearest obstacle in m/s^2; it and its range are taken from HuNavSim."""

OBSTACLE_RANGE = 0.2
"""In metres."""


@describe("deflection", "less", needs=frozenset({UNDISTURBED}), of_successes=True)
def deflection(trace: Trace) -> Float[np.ndarray, "world"]:
    """Mean distance of pedestrians from where they would be without the vehicle, over successes [m].

    Mean over pedestrians and steps, as long as the same pedestrians are present. Undefined if pedestrians do not see
    the vehicle, or there are none.
    """
    if trace.undisturbed is None:
        return np.full(len(trace), np.nan)
    moved = norm(trace.position[:, 1:, 1:] - trace.undisturbed[:, 1:])
    compared = np.isfinite(moved).sum(axis=(1, 2))
    return total(total(moved.swapaxes(1, 2))) / np.where(compared > 0, compared, np.nan)


@describe("imposed delay", "less", share=True, needs=frozenset({UNDISTURBED}), of_successes=True)
def imposed_delay(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time that pedestrians lose to the vehicle per second of exposure, over successes [1].

    sum_i (d_i - d'_i) / v_i / sum_i T_i over the trips i of pedestrians, from start to goal, that begin at the same
    position with and without the vehicle. T_i is the matched time in seconds: from the start of a trip until the
    pedestrian arrives in one of the two simulations, or the episode ends. d_i and d'_i are the straight distances to
    the goal after T_i, in metres, with and without the vehicle; v_i is the preferred speed. The definition is ours.

    The mean is signed, because pedestrians may gain: `imposed_delay_positive` counts only losses. Walls between a
    pedestrian and its goal are ignored. Each column of the arrays has the preferred speed of its first pedestrian.
    Undefined if pedestrians do not see the vehicle, or there are none.
    """
    return _imposed(trace, lambda lost, detour: lost)


@describe("positive imposed delay", "less", share=True, needs=frozenset({UNDISTURBED}), of_successes=True)
def imposed_delay_positive(trace: Trace) -> Float[np.ndarray, "world"]:
    """Positive part of `imposed_delay`: time gains do not offset losses, over successes [1].

    sum_i max(0, d_i - d'_i) / v_i / sum_i T_i. It is above 0 if two simulations of a crowd diverge, for any behaviour
    of the vehicle: compare planners only in the same scenario.
    """
    return _imposed(trace, lambda lost, detour: np.maximum(lost, 0.0))


@describe("imposed detour", "less", needs=frozenset({UNDISTURBED}), of_successes=True)
def imposed_detour(trace: Trace) -> Float[np.ndarray, "world"]:
    """Extra path of all pedestrians together compared with the same case without the vehicle, over successes [m].

    sum_i (l_i + d_i - l'_i - d'_i) over the trips of `imposed_delay`: l is the path and d the straight distance to the
    goal at the end of the matched time.
    """
    return _imposed(trace, lambda lost, detour: detour, per_exposure=False)


@describe("social work", "less", source="Pérez-Higueras et al. (2023)", of_successes=True)
def social_work(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time integral of the social forces on the vehicle and of the vehicle on pedestrians, over successes [m/s].

    HuNavSim (Pérez-Higueras et al. 2023): the size of the sum of the forces of all pedestrians on the vehicle, that of
    the force of the nearest obstacle on it, and the sizes of the vehicle's forces on the pedestrians, with the social
    force of Moussaïd et al. (2009). Here each step counts with its duration, so that the sum does not depend on the
    time step.
    """
    position, velocity = trace.position[:, 1:], trace.velocity[:, 1:]
    between = position[:, :, 1:] - position[:, :, :1]
    relative = velocity[:, :, :1] - velocity[:, :, 1:]
    on_vehicle = _social_force(between, relative)
    x, y = total(on_vehicle[..., 0]), total(on_vehicle[..., 1])
    obstacle = OBSTACLE_STRENGTH * np.exp(-np.maximum(trace.wall_gap, 0.0) / OBSTACLE_RANGE)
    on_pedestrians = total(norm(_social_force(-between, -relative)))
    return total(np.hypot(x, y) + obstacle + on_pedestrians) * trace.rules.dt


def _imposed(trace: Trace, cost: Callable[[Trips, Trips], Trips], per_exposure: bool = True) -> Values:
    """Return a cost of the vehicle to pedestrians, summed over the matched trips of each world.

    Args:
        cost: Cost of trips, a function of the lost time in seconds and of the extra path in metres.
        per_exposure: True to divide by the matched time in seconds.
    """
    if trace.undisturbed is None:
        return np.full(len(trace), np.nan)
    goal, person = trace.goal[:, :, 1:], trace.person
    new = (goal[:, 1:] != goal[:, :-1]).any(axis=3) | (person[:, 1:] != person[:, :-1])
    new |= trace.present[:, 1:, 1:] & ~trace.present[:, :-1, 1:]
    begins = np.ones(person.shape, bool)
    begins[:, 1:] = new

    def by_pedestrian(states: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(states.swapaxes(1, 2)).reshape(-1, *states.shape[3:])

    start = np.flatnonzero(by_pedestrian(begins))
    both = np.stack([by_pedestrian(trace.position[:, :, 1:]), by_pedestrian(trace.undisturbed)])
    remaining = norm(by_pedestrian(goal) - both) - by_pedestrian(trace.radius[:, :, 1:])
    end = np.minimum(*(_end(distance, start) for distance in remaining))
    speed = trace.preferred_speed[:, 1:].ravel()[start // person.shape[1]]
    alike = (both[0, start] == both[1, start]).all(axis=1) & (speed > 0.0)
    start, end, speed = start[alike], end[alike], speed[alike]
    further = np.subtract(*np.maximum(remaining[:, end], 0.0))
    strides = np.zeros((2, remaining.shape[1] // person.shape[1], person.shape[1]))
    strides[..., 1:] = np.nan_to_num(norm(np.diff(both.reshape(*strides.shape, 2), axis=2)))
    path = np.cumsum(strides, axis=2).reshape(remaining.shape)
    detour = np.subtract(*(path[:, end] - path[:, start])) + further

    def by_world(values: Trips) -> Values:
        world = start // person.shape[1] // max(person.shape[2], 1)
        return np.bincount(world, values, minlength=len(trace)).astype(float)

    exposure = by_world((end - start) * trace.rules.dt)
    costs = by_world(cost(further / speed, detour))
    return np.where(exposure > 0.0, costs, np.nan) / np.where(per_exposure & (exposure > 0.0), exposure, 1.0)


def _end(remaining: Float[np.ndarray, "state"], start: Starts) -> Starts:
    """Return the last state of each trip: the arrival, or the last state in which the pedestrian is present.

    Args:
        remaining: Straight distance to the point of arrival in metres, NaN without a pedestrian.
        start: The first state of each trip, which lasts until that of the next one.
    """
    state, last = np.arange(len(remaining)), len(remaining)
    known = np.isfinite(remaining)
    arrived = np.minimum.reduceat(np.where(known & (remaining < 0.0), state, last), start)
    end = np.where(arrived < last, arrived, np.maximum.reduceat(np.where(known, state, -1), start))
    return np.maximum(end, start)  # also of a trip without a pedestrian, which is not compared


def _social_force(between: Vectors, relative: Vectors) -> Vectors:
    """Return the force of another agent in m/s^2 (Moussaïd et al. 2009).

    Args:
        between: The vector to the other agent in metres.
        relative: The agent's velocity minus the other's, in m/s.

    Returns:
        The force; 0 if the interaction vector vanishes.
    """
    distance = norm(between)
    direction = between / np.maximum(distance, np.finfo(float).tiny)[..., None]
    interaction = VELOCITY_WEIGHT * relative + direction
    length = np.maximum(norm(interaction), 1e-9)
    ahead = interaction / length[..., None]
    aside = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    angle = np.arctan2(direction[..., 1], direction[..., 0]) - np.arctan2(ahead[..., 1], ahead[..., 0])
    angle, reach = wrap_angle(angle), RANGE * length
    brakes = np.exp(-distance / reach - (BRAKING * reach * angle) ** 2)
    turns = np.sign(angle) * np.exp(-distance / reach - (TURNING * reach * angle) ** 2)
    return np.asarray(-STRENGTH * (brakes[..., None] * ahead + turns[..., None] * aside))
