"""Metrics of what the vehicle costs the pedestrians: how far and how long they give way, and the social work."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.geometry import Vectors, norm, wrap_angle
from crowdbench.core.types import Trace
from crowdbench.metrics.info import UNDISTURBED, describe, total

Trips = Float[np.ndarray, "trip"]
Starts = Int[np.ndarray, "trip"]

STRENGTH = 2.1
"""Strength of the social force in m/s^2, and the next four, are those of HuNavSim."""

VELOCITY_WEIGHT = 2.0
"""Moussaïd's lambda in s/m: how much a relative velocity counts beside the direction to the other."""

RANGE = 0.35
"""Moussaïd's gamma in m, times the length of the interaction vector."""

TURNING = 2.0
"""Moussaïd's n in 1/m, of the force that turns."""

BRAKING = 3.0
"""Moussaïd's n' in 1/m, of the force that brakes."""

OBSTACLE_STRENGTH = 10.0
"""Strength of the force of the nearest obstacle in m/s^2, and its range, are those of HuNavSim."""

OBSTACLE_RANGE = 0.2
"""In metres."""


@describe("deflection", "less", needs=frozenset({UNDISTURBED}))
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


@describe("imposed delay", "less", needs=frozenset({UNDISTURBED}))
def imposed_delay(trace: Trace) -> Float[np.ndarray, "world"]:
    """Time that all pedestrians together lose to the vehicle: that of their ways, less that without the vehicle [s].

    Each is expected at its goal when it arrives, or else when it could be there from where it was last, straight on at
    its preferred speed. It is negative where they gain. Compared are the ways, from a start to a goal, that begin alike
    in the same case without the vehicle. A place in the arrays has the preferred speed of its first pedestrian.
    Undefined where pedestrians do not see the vehicle, or there are none.
    """
    return _imposed(trace, lambda step, remaining, walked, speed: step * trace.rules.dt + remaining / speed)


@describe("imposed detour", "less", needs=frozenset({UNDISTURBED}))
def imposed_detour(trace: Trace) -> Float[np.ndarray, "world"]:
    """Path that all pedestrians together walk because of the vehicle: that of their ways, less that without it [m].

    The ways are those of `imposed_delay`; what remained at the end of an episode counts as the straight way.
    """
    return _imposed(trace, lambda step, remaining, walked, speed: walked + remaining)


@describe("social work", "less", source="Pérez-Higueras et al. (2023)")
def social_work(trace: Trace) -> Float[np.ndarray, "world"]:
    """Size of the social forces on the vehicle, and of those that it exerts on each pedestrian, over time [m/s].

    HuNavSim (Pérez-Higueras et al. 2023): the size of the sum of the forces of all pedestrians on the vehicle, that of
    the force of the nearest obstacle on it, and the sizes of the vehicle's forces on the pedestrians, with the social
    force of Moussaïd et al. (2009). Here each step counts with its duration, so that the sum does not depend on the
    time step.
    """
    position, velocity = trace.position[:, 1:], trace.velocity[:, 1:]
    between, relative = position[:, :, 1:] - position[:, :, :1], velocity[:, :, :1] - velocity[:, :, 1:]
    on_vehicle = _social_force(between, relative)
    x, y = total(on_vehicle[..., 0]), total(on_vehicle[..., 1])
    obstacle = OBSTACLE_STRENGTH * np.exp(-np.maximum(trace.wall_gap, 0.0) / OBSTACLE_RANGE)
    on_pedestrians = total(norm(_social_force(-between, -relative)))
    return total(np.hypot(x, y) + obstacle + on_pedestrians) * trace.rules.dt


def _imposed(trace: Trace, cost: Callable[..., Trips]) -> Float[np.ndarray, "world"]:
    """What the ways of pedestrians cost more than they would without the vehicle, summed over those of each world.

    Compared are the ways, from a start to a goal, that begin alike with and without the vehicle. A way ends where its
    pedestrian is another person, has another goal, or is gone. NaN in a world without a way that can be compared.

    Args:
        trace: The trace.
        cost: Of ways, by what `_end` returns and the preferred speeds of their pedestrians.
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
    real, alone = by_pedestrian(trace.position[:, :, 1:]), by_pedestrian(trace.undisturbed)
    alike = start[(real[start] == alone[start]).all(axis=1)]
    speed = trace.preferred_speed[:, 1:].ravel()[alike // person.shape[1]]
    alike, speed = alike[speed > 0.0], speed[speed > 0.0]
    goals, radii = by_pedestrian(goal), by_pedestrian(trace.radius[:, :, 1:])
    chosen, costs = np.searchsorted(start, alike), []
    for states in (real, alone):
        end = _end(states, norm(goals - states) - radii, start, person.shape[1])
        costs.append(cost(*(values[chosen] for values in end), speed))
    world = alike // person.shape[1] // max(person.shape[2], 1)
    count = np.bincount(world, minlength=len(trace))
    return np.where(count > 0, np.bincount(world, costs[0] - costs[1], minlength=len(trace)), np.nan)


def _end(
    position: Float[np.ndarray, "state 2"], remaining: Float[np.ndarray, "state"], start: Starts, times: int
) -> tuple[Starts, Trips, Trips]:
    """Where ways end: at the goal, or where the pedestrian was last.

    The states of a pedestrian, `times` of them, lie one after the other; NaN where nobody is. A way goes on from its
    first state, in `start`, to the first state of the next one. `remaining` is the straight way to the goal in metres.

    Returns:
        Steps done then, the straight way to where the pedestrian arrives, and the path from the beginning of the way,
        both in metres.
    """
    state, last = np.arange(len(position)), len(position)
    known = np.isfinite(remaining)
    arrived = np.minimum.reduceat(np.where(known & (remaining < 0.0), state, last), start)
    end = np.where(arrived < last, arrived, np.maximum.reduceat(np.where(known, state, -1), start))
    end = np.maximum(end, start)  # of a way of nobody, which is not compared
    strides = np.zeros((len(position) // times, times))
    strides[:, 1:] = np.nan_to_num(norm(np.diff(position.reshape(-1, times, 2), axis=1)))
    path = np.cumsum(strides, axis=1).ravel()
    return end % times, np.maximum(remaining[end], 0.0), path[end] - path[start]


def _social_force(between: Vectors, relative: Vectors) -> Vectors:
    """The force of another agent in m/s^2 (Moussaïd et al. 2009).

    Args:
        between: The way to the other in metres.
        relative: The agent's own velocity less the other's, in m/s.

    Returns:
        The force; 0 where the interaction vector vanishes.
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
