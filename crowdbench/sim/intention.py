"""The intended velocities of pedestrians: their noise and their inertia. Compiled.

The desired velocity leads to the goal as in `toward_goal`. Ornstein-Uhlenbeck noise is added to it, and the intended
velocity relaxes towards the sum. A policy is queried in worlds whose goals and preferred speeds express the intended
velocities. The avoidance is neither smoothed nor disturbed.

The relaxation time is at most the remaining time to the goal: with a longer one people would circle around goals.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.rng import four_normal, purpose_bits
from crowdbench.core.types import Intention, World
from crowdbench.sim.kernels import in_blocks
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.compiled import njit

SLOWEST, FASTEST = 0.5, 2.0
"""Bounds as shares of the preferred speed. A policy is queried with at least the lower one, so that people who intend
to stand can still give way. No intended velocity is faster than the upper one."""

AHEAD = 2.0
"""Smallest distance of a shown goal, in seconds at the intended speed. Policies slow down at goals that are nearer than
one second."""

BLOCK_PEOPLE = 500
"""Smallest number of people for a thread: the transfer to it takes about 50 microseconds."""

MOST = 2.0
"""Most standard deviations by which the logarithm of an inertia deviates from the mean."""

TINY = 1e-9
"""Replacement of 0 in numbers by which a formula divides."""

_ALONE, _GROUP = purpose_bits("intention"), purpose_bits("intention of a group")


class IntentionState(NamedTuple):
    """The state of intentions in `World.memory`.

    Attributes:
        person: The person with this state; -1 for absent pedestrians.
        noise: The noise of the desired velocity, with a standard deviation of 1.
        inertia: The person's relaxation time in seconds.
        velocity: The intended velocity in m/s.
        max_speed: The largest speed in m/s in the next step; 0 for the preferred one.
    """

    person: Int[np.ndarray, "world pedestrian"]
    noise: Float[np.ndarray, "world pedestrian 2"]
    inertia: Float[np.ndarray, "world pedestrian"]
    velocity: Float[np.ndarray, "world pedestrian 2"]
    max_speed: Float[np.ndarray, "world pedestrian"]


def init_intentions(world: World) -> IntentionState:
    """Return the state before the first step."""
    people = world.person.shape
    vectors, numbers = (*people, 2), people
    shapes = vectors, numbers, vectors, numbers
    return IntentionState(np.full(people, -1), *map(np.zeros, shapes))


def update_intentions(world: World, state: IntentionState) -> tuple[World, IntentionState]:
    """Update the intentions of pedestrians.

    Args:
        world: The worlds as they are now.
        state: The state after the step before.

    Returns:
        The worlds in which the policies are queried, and the new state.
    """
    after = IntentionState(*(array.copy() for array in state))
    goal, speed = world.goal.copy(), world.preferred_speed.copy()
    scene = world.key, world.step, world.position, world.velocity, goals_on_way(world), world.present
    arrays = tuple(map(np.ascontiguousarray, scene)), (world.person, world.group, world.policy)
    habits, dt = _habits(world.rules.intentions, world.rules.dt), world.rules.dt
    in_blocks(
        lambda begin, end: _update(begin, end, habits, dt, *arrays, (goal, speed), tuple(after)),
        len(world),
        BLOCK_PEOPLE // speed.shape[1] + 1,
        len(world),
    )
    view = world.replace(goal=goal, preferred_speed=speed)
    if not world.route.shape[2]:
        return view, after
    # Intending pedestrians have passed all waypoints, so that their local goal is the goal.
    waypoint, points = world.waypoint.copy(), np.isfinite(world.route[:, 1:, :, 0]).sum(axis=2)
    waypoint[:, 1:] = np.where(after.person >= 0, points, waypoint[:, 1:])
    return view.replace(waypoint=waypoint), after


def _habits(intentions: tuple[Intention, ...], dt: float) -> Float[np.ndarray, "policy 4"]:
    """Return, by policy, noise, share of the noise that stays in a step, inertia in seconds, and its spread."""
    return np.array(
        [(one.noise, math.exp(-dt / one.noise_time), one.inertia, one.inertia_spread) for one in intentions]
    )


@no_type_check
@njit(error_model="numpy", nogil=True)
def _update(begin, end, habits, dt, scene, people, shown, state):
    """Replace goals and preferred speeds of intending pedestrians by those that they show, and update their state.

    Args:
        begin (int): The first world.
        end (int): The one after the last.
        habits (array): See `_habits`.
        dt (float): Length of a step in seconds.
        scene (tuple): The arrays `key`, `step`, `position`, `velocity`, local goals and `present` of the worlds.
        people (tuple): The arrays `person`, `group` and `policy`.
        shown (tuple): The arrays `goal` and `preferred_speed`, in which values are replaced.
        state (tuple): The fields of `IntentionState`.
    """
    (key, step, position, velocity, ahead, present), (person, group, policy) = scene, people
    (goal, pace), (known, noise, inertias, intended, max_speed) = shown, state
    for w in range(begin, end):
        for p in range(person.shape[1]):
            a = p + 1
            share, stays, inertia, spread = habits[policy[w, p]]
            if not present[w, a] or (share == 0.0 and inertia == 0.0):
                known[w, p], max_speed[w, p] = -1, 0.0
                continue
            x, y, speed = position[w, a, 0], position[w, a, 1], pace[w, a]
            dx, dy = ahead[w, a, 0] - x, ahead[w, a, 1] - y
            distance = math.sqrt(dx * dx + dy * dy)
            scale = speed / max(distance, speed, TINY)  # as in `toward_goal`
            dx, dy = scale * dx, scale * dy
            row, purpose = (person[w, p], _ALONE) if group[w, p] < 0 else (group[w, p], _GROUP)
            zx, zy, deviation, _ = four_normal(0, row, step[w], np.uint64(0), key[w], purpose)
            ux, uy = intended[w, p, 0], intended[w, p, 1]
            if known[w, p] == person[w, p]:
                fresh = math.sqrt(1.0 - stays * stays)
                zx, zy = stays * noise[w, p, 0] + fresh * zx, stays * noise[w, p, 1] + fresh * zy
            else:
                inertias[w, p] = inertia * math.exp(spread * min(max(deviation, -MOST), MOST))
                ux, uy = velocity[w, a, 0], velocity[w, a, 1]
                if ux == 0.0 and uy == 0.0:
                    ux, uy = dx, dy
            # The time to the goal bounds the relaxation time; the product is 0 for people without a preferred speed.
            rate = 1.0 / max(inertias[w, p], TINY)
            if distance * rate < speed:
                rate = speed / max(distance, TINY)
            gain, deviation = 1.0 - math.exp(-dt * rate), share * scale * distance
            ux, uy = ux + gain * (dx + deviation * zx - ux), uy + gain * (dy + deviation * zy - uy)
            length, fastest = math.sqrt(ux * ux + uy * uy), FASTEST * speed
            if length > fastest:
                ux, uy, length = ux * (fastest / length), uy * (fastest / length), fastest
            known[w, p], max_speed[w, p] = person[w, p], max(speed, length)
            noise[w, p, 0], noise[w, p, 1], intended[w, p, 0], intended[w, p, 1] = zx, zy, ux, uy
            far = max(distance, AHEAD * length) / length if length > SLOWEST * speed else 1.0
            if speed > 0.0:
                pace[w, a], goal[w, a, 0], goal[w, a, 1] = max(length, SLOWEST * speed), x + far * ux, y + far * uy
