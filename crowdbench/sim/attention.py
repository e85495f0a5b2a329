"""An assumed model of attention: which pedestrians notice the vehicle, and which of them adapt to it. Compiled.

A pedestrian notices the vehicle after it has been in its field of view, not behind walls, for the delay of
`crowdbench.core.types.Attention`, and remembers it for `MEMORY` seconds. Then it adapts, according to its reaction, if
the vehicle would otherwise come near. `World.memory` contains the state.

Sources: Moussaïd et al. (2011) for field of view and range, Rio et al. (2014) for the delay, and Olivier et al. (2012)
for the distance of closest approach below which people adapt. All other numbers are assumptions.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.geometry import norm
from crowdbench.core.rng import purpose_bits, uniform
from crowdbench.core.types import World
from crowdbench.core.types.attention import ATTRACTED, AVOIDS, CLEARANCE, IGNORES, YIELDS_LATE
from crowdbench.sim.lines_of_sight import share_to_walls
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.compiled import njit

RANGE = 10.0
"""A pedestrian can notice the vehicle up to this distance between the centres, in metres."""

HALF_FIELD, HALF_FIELD_DISTRACTED = math.radians(75.0), math.radians(25.0)
"""Half the field of view in radians, around the direction of walking; the second one while looking away."""

MEMORY = 5.0
"""Seconds for which a noticed vehicle is remembered after it was last in view."""

CLOSE = 1.0
"""Pedestrians adapt if the predicted distance of closest approach between the centres is below this, in metres. For a
vehicle that is larger than a person, it increases by the difference of the radii, and for another clearance than
`CLEARANCE` by the difference to it."""

LATE = 1.5
"""Seconds before the closest approach at which pedestrians that yield late adapt."""

LOOKS_AWAY, PERIOD = 4.0, 10.0
"""Seconds for which distracted pedestrians look away in each period, and length of a period in seconds."""

STANDS = 0.2
"""Speed in m/s below which the vehicle stands. All pedestrians that have noticed it then walk around it."""

INTEREST, STAND_OFF = 8.0, 1.2
"""Seconds for which attracted pedestrians approach the vehicle, and their distance to it between rims in metres."""

_REACTION, _PHASE = purpose_bits("reaction to the vehicle"), purpose_bits("distraction")


class AttentionState(NamedTuple):
    """The state of attention in `World.memory`.

    Attributes:
        person: The person with this state; -1 before the first step.
        reaction: One of `REACTIONS`, by index.
        phase: The time in seconds at which a distracted pedestrian first looks away; NaN for others.
        facing: The direction of walking, in radians.
        in_view: Seconds for which the vehicle has been in view; -1 if it is not.
        remaining: Seconds for which the pedestrian will remember the vehicle; 0 if it has not noticed it.
        known: Seconds for which the pedestrian has remembered the vehicle.
    """

    person: Int[np.ndarray, "world pedestrian"]
    reaction: Int[np.ndarray, "world pedestrian"]
    phase: Float[np.ndarray, "world pedestrian"]
    facing: Float[np.ndarray, "world pedestrian"]
    in_view: Float[np.ndarray, "world pedestrian"]
    remaining: Float[np.ndarray, "world pedestrian"]
    known: Float[np.ndarray, "world pedestrian"]


def init_attention(world: World) -> AttentionState:
    """Return the state of pedestrians that have not noticed the vehicle."""
    persons = np.full(world.person.shape, -1)
    return AttentionState(persons, np.zeros_like(persons), *np.zeros((5, *persons.shape)))


def update_attention(
    world: World, intended: Float[np.ndarray, "world pedestrian 2"], state: AttentionState
) -> tuple[Bool[np.ndarray, "world pedestrian"], AttentionState]:
    """Update the attention of pedestrians to the vehicle.

    Args:
        world: The worlds as they are now, in which the vehicle is the smallest disc around its body.
        intended: The velocities in m/s that pedestrians would take without the vehicle.
        state: The state after the step before.

    Returns:
        A mask of the pedestrians that adapt to the vehicle in this step, and the new state.
    """
    attention, dt = world.rules.attention, world.rules.dt
    assert attention is not None
    after = AttentionState(*(array.copy() for array in state))
    adapts = np.zeros(world.person.shape, bool)
    shares = attention.ignores, attention.yields_late, attention.attracted
    close = CLOSE + (attention.distance - CLEARANCE)
    traits = (*np.cumsum(shares), attention.distracted, attention.delay, close, dt)
    scene = world.key, world.step, world.position, world.velocity, goals_on_way(world), world.radius, world.present
    _update(adapts, traits, intended, *scene, world.person, world.obstacles, *after)
    return adapts, after


def adapted_view(world: World, state: AttentionState) -> World:
    """Return worlds as pedestrians who adapt to the vehicle perceive them.

    The vehicle is larger by the clearance, and attracted pedestrians who have just noticed it have a goal beside it.
    """
    attention, radius = world.rules.attention, world.radius.copy()
    assert attention is not None
    radius[:, 0] += attention.distance
    world = world.replace(radius=radius)
    comes = (state.reaction == ATTRACTED) & (state.remaining > 0.0) & (state.known < INTEREST)
    if not comes.any():
        return world
    goal, waypoint = world.goal.copy(), world.waypoint.copy()
    away = world.position[:, 1:] - world.position[:, :1]
    distance = np.maximum(norm(away), 1e-9)
    beside = STAND_OFF - attention.distance + world.radius[:, :1] + world.radius[:, 1:]
    near = world.position[:, :1] + away * np.minimum(beside / distance, 1.0)[..., None]
    goal[:, 1:] = np.where(comes[..., None], near, goal[:, 1:])
    waypoint[:, 1:] = np.where(comes, np.isfinite(world.route[:, 1:, :, 0]).sum(axis=2), waypoint[:, 1:])
    return world.replace(goal=goal, waypoint=waypoint)


@no_type_check
@njit(error_model="numpy")
def _update(adapts, traits, intended, key, step, position, velocity, ahead, radius, present, person, obstacles, *state):
    """Fill `adapts`, and update the fields of `AttentionState`; `ahead` contains local goals `[world, agent, 2]`."""
    known_person, reaction, phase, facing, in_view, remaining, known = state
    ignores, yields_late, attracted, distracted, delay, close, dt = traits
    for w in range(len(key)):
        for p in range(person.shape[1]):
            a = p + 1
            if not present[w, a] or not present[w, 0]:
                continue
            if known_person[w, p] != person[w, p]:
                known_person[w, p] = person[w, p]
                draw = uniform(person[w, p], 0, key[w], _REACTION)
                reaction[w, p] = AVOIDS
                if draw < attracted:
                    reaction[w, p] = IGNORES if draw < ignores else YIELDS_LATE if draw < yields_late else ATTRACTED
                draw = uniform(person[w, p], 0, key[w], _PHASE)
                phase[w, p] = PERIOD * draw / distracted if draw < distracted else math.nan
                facing[w, p] = math.atan2(ahead[w, a, 1] - position[w, a, 1], ahead[w, a, 0] - position[w, a, 0])
                in_view[w, p], remaining[w, p], known[w, p] = -1.0, 0.0, 0.0
            vx, vy = velocity[w, a, 0], velocity[w, a, 1]
            if vx * vx + vy * vy > 0.01:
                facing[w, p] = math.atan2(vy, vx)
            dx, dy = position[w, 0, 0] - position[w, a, 0], position[w, 0, 1] - position[w, a, 1]
            looks_away = not math.isnan(phase[w, p]) and (step[w] * dt - phase[w, p]) % PERIOD < LOOKS_AWAY
            field = HALF_FIELD_DISTRACTED if looks_away else HALF_FIELD
            if _is_in_view(position[w, a], dx, dy, facing[w, p], field, obstacles[w]):
                in_view[w, p] = in_view[w, p] + dt if in_view[w, p] >= 0.0 else 0.0
            else:
                in_view[w, p] = -1.0
            if in_view[w, p] >= 0.0 and (remaining[w, p] > 0.0 or in_view[w, p] >= delay - 1e-9):
                remaining[w, p] = MEMORY
            else:
                remaining[w, p] = max(remaining[w, p] - dt, 0.0)
            known[w, p] = known[w, p] + dt if remaining[w, p] > 0.0 else 0.0
            is_moving = velocity[w, 0, 0] ** 2 + velocity[w, 0, 1] ** 2 > STANDS**2
            if remaining[w, p] == 0.0 or (reaction[w, p] == IGNORES and is_moving):
                continue
            ux, uy = velocity[w, 0, 0] - intended[w, p, 0], velocity[w, 0, 1] - intended[w, p, 1]
            time = max(-(dx * ux + dy * uy), 0.0) / max(ux * ux + uy * uy, 1e-9)
            nearest = math.hypot(dx + time * ux, dy + time * uy) - max(radius[w, 0] - radius[w, a], 0.0)
            comes = reaction[w, p] == ATTRACTED and known[w, p] < INTEREST
            adapts[w, p] = comes or (nearest < close and (time <= LATE or reaction[w, p] != YIELDS_LATE))


@no_type_check
@njit(error_model="numpy")
def _is_in_view(position, dx, dy, facing, half_field, obstacles):
    """Return whether a point at (dx, dy) from a position is in range and in the field of view, not behind walls."""
    distance = math.sqrt(dx * dx + dy * dy)
    if distance > RANGE or dx * math.cos(facing) + dy * math.sin(facing) < math.cos(half_field) * distance:
        return False
    return len(obstacles) == 0 or share_to_walls(position[0], position[1], dx, dy, obstacles) == 1.0
