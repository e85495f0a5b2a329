"""Metrics of collisions with pedestrians: how fast, and who ran into whom."""

from __future__ import annotations

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.geometry import Discs, nearest_in_step, norm
from crowdbench.core.types import Trace
from crowdbench.metrics.motion import STANDSTILL
from crowdbench.metrics.outcomes import person_collision_rate
from crowdbench.metrics.sums import dot
from crowdbench.utils.compiled import njit

BEHIND = np.cos(np.radians(45.0))
"""Who is within 45 degrees of straight behind somebody is behind him."""


class _Contacts(NamedTuple):
    """The collision with a pedestrian in each world; NaN where there was none.

    Attributes:
        normal: Direction from the vehicle to the pedestrian at the first contact, of length 1.
        vehicle: Velocity in m/s of that disc of the vehicle that was touched, in the step.
        pedestrian: Velocity of the pedestrian in m/s.
    """

    normal: Float[np.ndarray, "world 2"]
    vehicle: Float[np.ndarray, "world 2"]
    pedestrian: Float[np.ndarray, "world 2"]


def impact_speed(trace: Trace) -> Float[np.ndarray, "world"]:
    """Relative speed of the vehicle and the pedestrian with whom it collided, over collisions with pedestrians [m/s].

    The pedestrian is the one who was nearest in the last step, in which both moved at constant velocity.
    """
    contacts = _contacts(trace)
    return norm(contacts.pedestrian - contacts.vehicle)


def struck_standing_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with a pedestrian walking into the vehicle, which stood [1].

    Slower than 0.05 m/s in the last step.
    """
    stood = norm(trace.velocity[np.arange(len(trace)), trace.steps, 0]) < STANDSTILL
    return stood & (norm(_contacts(trace).pedestrian) >= STANDSTILL)


def struck_behind_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with a pedestrian walking into the vehicle's back [1].

    The pedestrian was within 45 degrees of straight behind the vehicle's disc that was touched, which did not move
    towards him.
    """
    contacts = _contacts(trace)
    heading = trace.heading[np.arange(len(trace)), trace.steps]
    faces = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return (dot(faces, contacts.normal) <= -BEHIND) & (dot(contacts.vehicle, contacts.normal) <= 0.0)


def hit_behind_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with the vehicle driving into a pedestrian's back [1].

    The pedestrian walked, at 0.05 m/s or more, and the vehicle was within 45 degrees of straight behind him.
    """
    contacts = _contacts(trace)
    speed = norm(contacts.pedestrian)
    return (dot(contacts.pedestrian, contacts.normal) >= BEHIND * speed) & (speed >= STANDSTILL)


def _contacts(trace: Trace) -> _Contacts:
    """The collisions with pedestrians, as everybody moved in the last step."""
    row = np.flatnonzero(person_collision_rate(trace))
    ends = np.stack([trace.steps[row] - 1, trace.steps[row]], axis=1)
    position, heading = trace.position[row[:, None], ends], trace.heading[row[:, None], ends]
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    body = np.array(trace.rules.body)
    discs = position[:, :, :1] + body[:, None] * direction[:, :, None]
    radius = trace.radius[row, ends[:, 0]]
    person = trace.person[row[:, None], ends]
    present = np.isfinite(position[:, :, 1:]).all(axis=(1, 3)) & (person[:, 0] == person[:, 1])
    disc, agent = _find_touched(discs, np.ascontiguousarray(position), np.ascontiguousarray(radius), present).T
    each = np.arange(len(row))
    vehicle, pedestrian = discs[each, :, disc], position[each, :, agent]
    between, motion = pedestrian[:, 0] - vehicle[:, 0], np.diff(pedestrian - vehicle, axis=1)[:, 0]
    reach = radius[:, 0] + radius[each, agent]
    at_contact = between + _first_touch(between, motion, reach)[:, None] * motion
    contacts = _Contacts(*np.full((3, len(trace), 2), np.nan))
    contacts.normal[row] = at_contact / np.maximum(norm(at_contact), np.finfo(float).tiny)[:, None]
    contacts.vehicle[row] = (vehicle[:, 1] - vehicle[:, 0]) / trace.rules.dt
    contacts.pedestrian[row] = (pedestrian[:, 1] - pedestrian[:, 0]) / trace.rules.dt
    return contacts


def _first_touch(
    between: Float[np.ndarray, "contact 2"], motion: Float[np.ndarray, "contact 2"], reach: Float[np.ndarray, "contact"]
) -> Float[np.ndarray, "contact"]:
    """The share of a step after which two discs touch, or else after which they are nearest.

    `between` is the way from the one to the other before the step, `motion` how it changes, `reach` the sum of radii.
    """
    a, b, c = dot(motion, motion), dot(between, motion), dot(between, between) - reach**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    share = np.where(a > 0.0, (-b - root) / np.where(a > 0.0, a, 1.0), 0.0)
    return np.clip(share, 0.0, 1.0)


@no_type_check
@njit
def _find_touched(discs, position, radius, present):
    """The disc and the pedestrian that came nearest to each other in a step.

    Args:
        discs: `[contact, 2, disc, 2]`, centres of the vehicle's discs before and after the step, in metres.
        position: `[contact, 2, agent, 2]`, positions before and after it, in metres.
        radius: `[contact, agent]`, in metres.
        present: `[contact, pedestrian]`, who was there before and after it.

    Returns:
        `[contact, 2]`, the index of the disc, and that of the agent.
    """
    touched = np.zeros((len(discs), 2), np.int64)
    agents = radius.shape[1]
    begin, motion, counts = np.empty((agents, 2)), np.empty((agents, 2)), np.zeros(agents, np.bool_)
    for w in range(len(discs)):
        for a in range(1, agents):
            begin[a, 0], begin[a, 1], counts[a] = position[w, 0, a, 0], position[w, 0, a, 1], present[w, a - 1]
            motion[a, 0], motion[a, 1] = position[w, 1, a, 0] - begin[a, 0], position[w, 1, a, 1] - begin[a, 1]
        least = np.inf
        for d in range(discs.shape[2]):
            begin[0, 0], begin[0, 1] = discs[w, 0, d, 0], discs[w, 0, d, 1]
            motion[0, 0], motion[0, 1] = discs[w, 1, d, 0] - begin[0, 0], discs[w, 1, d, 1] - begin[0, 1]
            gap, nearest = nearest_in_step(0, Discs(begin, motion, radius[w], counts))
            if gap < least:
                least, touched[w, 0], touched[w, 1] = gap, d, nearest
    return touched
