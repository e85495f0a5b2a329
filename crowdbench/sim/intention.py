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
from jaxtyping import Bool, Float, Int

from crowdbench.core.rng import four_normal, purpose_bits
from crowdbench.core.types import World
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.compiled import njit

SLOWEST, FASTEST = 0.5, 2.0
"""Bounds as shares of the preferred speed. A policy is queried with at least the lower one, so that people who intend
to stand can still give way. No intended velocity is faster than the upper one."""

AHEAD = 2.0
"""Smallest distance of a shown goal, in seconds at the intended speed. Policies slow down at goals that are nearer than
one second."""

TINY = 1e-9
"""Replacement of 0 in numbers by which a formula divides."""

_ALONE, _GROUP = purpose_bits("intention"), purpose_bits("intention of a group")


class IntentionState(NamedTuple):
    """The state of intentions in `World.memory`.

    Attributes:
        person: The person with this state; -1 for absent pedestrians.
        noise: The noise of the desired velocity, with a standard deviation of 1.
        velocity: The intended velocity in m/s.
        max_speed: The largest speed in m/s in the next step; 0 for the preferred one.
    """

    person: Int[np.ndarray, "world pedestrian"]
    noise: Float[np.ndarray, "world pedestrian 2"]
    velocity: Float[np.ndarray, "world pedestrian 2"]
    max_speed: Float[np.ndarray, "world pedestrian"]


def init_intentions(world: World) -> IntentionState:
    """Return the state before the first step."""
    people = world.person.shape
    return IntentionState(np.full(people, -1), np.zeros((*people, 2)), np.zeros((*people, 2)), np.zeros(people))


def update_intentions(world: World, state: IntentionState) -> tuple[World, IntentionState]:
    """Update the intentions of pedestrians.

    Args:
        world: The worlds as they are now.
        state: The state after the step before.

    Returns:
        The worlds in which the policies are queried, and the new state.
    """
    rules, after = world.rules, IntentionState(*(array.copy() for array in state))
    goal, speed = world.goal.copy(), world.preferred_speed.copy()
    scene = world.key, world.step, world.position, world.velocity, goals_on_way(world), world.present
    people = world.person, world.group, world.policy
    _update(np.array(rules.intentions), rules.dt, *map(np.ascontiguousarray, scene + people), goal, speed, *after)
    view = world.replace(goal=goal, preferred_speed=speed)
    if not world.route.shape[2]:
        return view, after
    waypoint, points = world.waypoint.copy(), np.isfinite(world.route[:, 1:, :, 0]).sum(axis=2)
    waypoint[:, 1:] = np.where(_intending(world), points, waypoint[:, 1:])
    return view.replace(waypoint=waypoint), after


def _intending(world: World) -> Bool[np.ndarray, "world pedestrian"]:
    """Return a mask of pedestrians whose policy has noise or inertia."""
    intends = [intention.noise > 0.0 or intention.inertia > 0.0 for intention in world.rules.intentions]
    return np.array(intends)[world.policy]


@no_type_check
@njit(error_model="numpy")
def _update(
    intentions,
    dt,
    key,
    step,
    position,
    velocity,
    ahead,
    present,
    person,
    group,
    policy,
    goal,
    pace,
    known,
    noise,
    intended,
    max_speed,
):
    """Fill goals and preferred speeds of intending pedestrians, and update the fields of `IntentionState`.

    Args:
        intentions (array): `[policy, 3]`, the fields of `Intention`.
        dt (float): Length of a step in seconds.
        ahead (array): Local goals `[world, agent, 2]`.
        goal (array): True goals, replaced.
        pace (array): True preferred speeds, replaced.
    """
    for w in range(len(key)):
        for p in range(person.shape[1]):
            a = p + 1
            share, noise_time, inertia = intentions[policy[w, p]]
            if not present[w, a] or (share == 0.0 and inertia == 0.0):
                known[w, p], max_speed[w, p] = -1, 0.0
                continue
            x, y, speed = position[w, a, 0], position[w, a, 1], pace[w, a]
            dx, dy = ahead[w, a, 0] - x, ahead[w, a, 1] - y
            distance = math.sqrt(dx * dx + dy * dy)
            scale = speed / max(distance, speed, TINY)
            dx, dy = scale * dx, scale * dy
            row, purpose = (person[w, p], _ALONE) if group[w, p] < 0 else (group[w, p], _GROUP)
            zx, zy, _, _ = four_normal(0, row, step[w], np.uint64(0), key[w], purpose)
            if known[w, p] != person[w, p]:
                known[w, p] = person[w, p]
                ux, uy = velocity[w, a, 0], velocity[w, a, 1]
                if ux == 0.0 and uy == 0.0:
                    ux, uy = dx, dy
            else:
                keep = math.exp(-dt / noise_time)
                fresh = math.sqrt(1.0 - keep * keep)
                zx, zy = keep * noise[w, p, 0] + fresh * zx, keep * noise[w, p, 1] + fresh * zy
                ux, uy = intended[w, p, 0], intended[w, p, 1]
            noise[w, p, 0], noise[w, p, 1] = zx, zy
            spread = share * scale * distance
            gain = 1.0 - math.exp(-dt / max(min(inertia, distance / max(speed, TINY)), TINY))
            ux, uy = ux + gain * (dx + spread * zx - ux), uy + gain * (dy + spread * zy - uy)
            length = math.sqrt(ux * ux + uy * uy)
            slower = FASTEST * speed / max(length, FASTEST * speed, TINY)
            ux, uy, length = slower * ux, slower * uy, slower * length
            intended[w, p, 0], intended[w, p, 1], max_speed[w, p] = ux, uy, max(speed, length)
            pace[w, a], far = max(length, SLOWEST * speed), 1.0
            if length > SLOWEST * speed:
                far = max(distance, AHEAD * length) / length
            goal[w, a, 0], goal[w, a, 1] = x + far * ux, y + far * uy
