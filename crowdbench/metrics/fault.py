"""Contacts of the vehicle with pedestrians: the vehicle's share in them, and the relative speed.

The vehicle's share in a contact is

    phi = D_v / (D_v + D_p),  D_v = integral of max(0, v_v . n),  D_p = integral of max(0, -v_p . n)

over the last second before the contact, or since the start or the arrival of the person, if that is later. n is the
unit vector from the nearest point of the vehicle's body to the person, v_v the velocity of this point, v_p that of the
person. Thus phi is the vehicle's part of the approach. Braking in the last moment changes it little.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.dynamics import disc_centres
from crowdbench.core.geometry import dot, least_distance, norm
from crowdbench.core.types import Outcome, Trace

WINDOW = 1.0
"""Seconds before a contact over which the shares are measured."""

SAMPLES = 64
"""Number of sampled times in the window, in the middles of equal parts."""

STANDING = 0.05
"""Length in metres of the path in the window below which the vehicle stands."""

UNDETERMINED = 0.01
"""Sum of both approaches in metres below which the share is undetermined."""

SMALL_SHARE, LARGE_SHARE = 0.1, 0.9
"""Share below which the vehicle was struck, and share above which only the vehicle approached."""

BEHIND = np.cos(np.radians(120.0))
"""Cosine of 120 degrees: pedestrians at larger angles from the vehicle's heading are behind it."""

SAME_TIME = 1e-9
"""Largest time difference of simultaneous contacts, in steps."""


class Fault(enum.IntEnum):
    """Kind of a contact: the first one whose condition is true."""

    NONE = -1
    """There was no contact."""
    STRUCK_STANDING = 0
    """It stood: its path in the window was under 5 cm."""
    STRUCK_BEHIND = 1
    """The vehicle's share is under 0.1, and the pedestrian was behind it."""
    STRUCK = 2
    """Its share is under 0.1."""
    ALONE = 3
    """The vehicle's share is over 0.9, or it drove into an obstacle."""
    BOTH = 4
    """Both came nearer."""
    UNDETERMINED = 5
    """Both together came nearer by less than 1 cm, and the vehicle did not stand."""


_Numbers = Float[np.ndarray, "touch"]
_Indices = Int[np.ndarray, "touch"]


class Contacts(NamedTuple):
    """The contact of each world; of simultaneous contacts, the one with the largest share of the vehicle.

    Attributes:
        fault: Kind of the contact, a `Fault`.
        share: The vehicle's share phi, from 0 to 1; NaN without contact, or if it is undetermined.
        agent: Index of the pedestrian as an agent; 0 without contact with a pedestrian.
        speed: Relative speed of the two in m/s; NaN without contact with a pedestrian.
        saw: True if the pedestrian saw the vehicle.
    """

    fault: Int[np.ndarray, "world"]
    share: Float[np.ndarray, "world"]
    agent: Int[np.ndarray, "world"]
    speed: Float[np.ndarray, "world"]
    saw: Bool[np.ndarray, "world"]


def find_contacts(trace: Trace) -> Contacts:
    """Return the contact that ended each episode, and the vehicle's share in it. See the top of this file."""
    n = len(trace)
    fault, share, speed = np.full(n, Fault.NONE), np.full(n, np.nan), np.full(n, np.nan)
    contacts = Contacts(fault, share, np.zeros(n, np.int64), speed, np.zeros(n, bool))
    wall = trace.outcome == Outcome.WALL_COLLISION
    contacts.fault[wall], contacts.share[wall] = Fault.ALONE, 1.0
    row = np.flatnonzero(trace.outcome == Outcome.COLLISION)
    if len(row) == 0:
        return contacts
    row, agent, time = _first_touches(trace, row)
    share, fault, speed = _attribute(trace, row, agent, time)
    # Of several contacts in a world, the last one is kept: the one with the largest share.
    order = np.argsort(np.nan_to_num(share, nan=-1.0), kind="stable")
    row, agent = row[order], agent[order]
    contacts.fault[row] = fault[order]
    contacts.share[row] = share[order]
    contacts.speed[row] = speed[order]
    contacts.agent[row] = agent
    last = trace.steps[row]
    contacts.saw[row] = trace.rules.visible if trace.noticed is None else trace.noticed[row, last, agent - 1]
    return contacts


def _first_touches(trace: Trace, row: Int[np.ndarray, "contact"]) -> tuple[_Indices, _Indices, _Numbers]:
    """Return the first touches in the last step of episodes that ended in a collision with a pedestrian.

    They are the row of each in the trace, the index of the pedestrian as an agent, and the time in steps. If no
    pedestrian touches the vehicle because of rounding errors, the nearest pedestrian counts as touching.
    """
    ends = np.stack([trace.steps[row] - 1, trace.steps[row]], axis=1)
    position, person = trace.position[row[:, None], ends], trace.person[row[:, None], ends]
    discs = disc_centres(trace.rules.body, position[:, :, 0], trace.heading[row[:, None], ends])
    # Axes: contact, pedestrian, disc.
    offset = position[:, :, 1:, None] - discs[:, :, None]
    between, motion = offset[:, 0], offset[:, 1] - offset[:, 0]
    radius = trace.radius[row, ends[:, 0]]
    reach = (radius[:, :1] + radius[:, 1:])[..., None]
    here = np.isfinite(offset).all(axis=(1, 3, 4)) & (person[:, 0] == person[:, 1])
    a, b, c = dot(motion, motion), dot(between, motion), dot(between, between) - reach**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    first = np.where(c <= 0.0, 0.0, np.clip((-b - root) / np.where(a > 0.0, a, 1.0), 0.0, 1.0))
    gap = np.where(here[..., None], least_distance(between, motion) - reach, np.inf)
    is_touch = gap <= np.maximum(gap.min(axis=(1, 2), keepdims=True), 0.0)
    time = np.where(is_touch, first, np.inf).min(axis=2)
    contact, pedestrian = np.nonzero(time <= time.min(axis=1, keepdims=True) + SAME_TIME)
    return row[contact], pedestrian + 1, ends[contact, 0] + time[contact, pedestrian]


def _attribute(trace: Trace, row: _Indices, agent: _Indices, time: _Numbers) -> tuple[_Numbers, _Indices, _Numbers]:
    """Return the vehicle's share in each touch, its kind (a `Fault`), and the relative speed at the touch in m/s."""
    length = _window(trace, row, agent, time)
    parts = length[:, None] * (np.arange(SAMPLES) + 0.5) / SAMPLES
    # The first sample is the touch.
    at = time[:, None] - np.concatenate([np.zeros((len(row), 1)), parts], axis=1)
    step = np.clip(np.floor(at).astype(int), 0, trace.steps[row][:, None] - 1)
    step[:, 0] = trace.steps[row] - 1
    rows, part = row[:, None], (at - step)[..., None]
    before = trace.position[rows, step, agent[:, None]]
    after = trace.position[rows, step + 1, agent[:, None]]
    centre = trace.position[rows, step, 0]
    centre_after = trace.position[rows, step + 1, 0]
    discs = disc_centres(trace.rules.body, centre, trace.heading[rows, step])
    discs_after = disc_centres(trace.rules.body, centre_after, trace.heading[rows, step + 1])
    offset = (before + part * (after - before))[:, :, None] - (discs + part[..., None] * (discs_after - discs))
    disc = norm(offset).argmin(axis=2)[..., None, None]
    normal = np.take_along_axis(offset, disc, axis=2)[:, :, 0]
    moved = np.take_along_axis(discs_after - discs, disc, axis=2)[:, :, 0]
    normal = normal / np.maximum(norm(normal), np.finfo(float).tiny)[..., None]
    dt = trace.rules.dt
    pedestrian, vehicle = (after - before) / dt, moved / dt
    seconds = length * dt / SAMPLES
    by_vehicle = _integrate(np.maximum(dot(vehicle, normal), 0.0), seconds)
    both = by_vehicle + _integrate(np.maximum(-dot(pedestrian, normal), 0.0), seconds)
    share = np.where(both >= UNDETERMINED, by_vehicle / np.where(both > 0.0, both, 1.0), np.nan)
    path = _integrate(norm(centre_after - centre) / dt, seconds)
    heading = trace.heading[row, trace.steps[row]]
    faces = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    is_behind = dot(faces, normal[:, 0]) < BEHIND
    conditions = {
        Fault.STRUCK_STANDING: path < STANDING,
        Fault.STRUCK_BEHIND: (share < SMALL_SHARE) & is_behind,
        Fault.STRUCK: share < SMALL_SHARE,
        Fault.ALONE: share > LARGE_SHARE,
        Fault.BOTH: ~np.isnan(share),
    }
    fault = np.select(list(conditions.values()), list(conditions), Fault.UNDETERMINED)
    return share, fault, norm(pedestrian[:, 0] - vehicle[:, 0])


def _integrate(values: Float[np.ndarray, "touch sample"], seconds: _Numbers) -> _Numbers:
    """Return the integral of samples over the window, without the first sample, which is at the touch."""
    # Summed one after the other, so that a sum does not depend on the number of touches.
    return np.cumsum(values[:, 1:], axis=1)[:, -1] * seconds


def _window(trace: Trace, row: _Indices, agent: _Indices, time: _Numbers) -> _Numbers:
    """Return the length of the window before each touch in steps: a second, or less if the person arrived later."""
    most = WINDOW / trace.rules.dt
    last = trace.steps[row] - 1
    since = last.astype(float)
    is_same = np.ones(len(row), bool)
    for back in range(1, int(np.ceil(most)) + 1):
        step = np.maximum(last - back, 0)
        is_same &= (last >= back) & (trace.person[row, step, agent - 1] == trace.person[row, last, agent - 1])
        is_same &= np.isfinite(trace.position[row, step, agent]).all(axis=1)
        since = np.where(is_same, step, since)
    return np.minimum(most, time - since)
