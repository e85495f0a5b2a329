"""Metrics of contacts: relative speed and fault."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.types import Trace
from crowdbench.metrics.fault import SMALL_SHARE, Contacts, Fault, find_contacts
from crowdbench.metrics.info import describe

_CONTACTS: WeakKeyDictionary[Trace, Contacts] = WeakKeyDictionary()


def contacts_of(trace: Trace) -> Contacts:
    """Return the contacts of a trace, which are computed once for all metrics of this file."""
    if trace not in _CONTACTS:
        _CONTACTS[trace] = find_contacts(trace)
    return _CONTACTS[trace]


@describe("impact speed", "less", over_all=True, among_all=True)
def impact_speed(trace: Trace) -> Float[np.ndarray, "world"]:
    """Relative speed of the vehicle and the pedestrian that it touched, over collisions with pedestrians [m/s].

    The vehicle's velocity is that of its touched point. Both velocities are those in the last step.
    """
    return contacts_of(trace).speed


@describe("at fault", "less", share=True, among_all=True)
def at_fault_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended in a collision in which the vehicle had a share of 0.1 or more [1]."""
    return contacts_of(trace).share >= SMALL_SHARE


@describe("at fault although seen", "less", share=True, among_all=True)
def at_fault_seen_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes in which the vehicle was at fault for a collision with a pedestrian that saw it [1].

    The vehicle's share was 0.1 or more, as in `at_fault_rate`.
    """
    return at_fault_rate(trace) & contacts_of(trace).saw


@describe("struck while standing", "less", share=True, among_all=True)
def struck_standing_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with a pedestrian touching the standing vehicle [1].

    The vehicle's path in the last second was under 5 cm.
    """
    return contacts_of(trace).fault == Fault.STRUCK_STANDING


@describe("struck from behind", "less", share=True, among_all=True)
def struck_behind_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with a pedestrian walking into the vehicle from behind [1].

    The vehicle's share is under 0.1, and the pedestrian was more than 120 degrees from its heading.
    """
    return contacts_of(trace).fault == Fault.STRUCK_BEHIND


@describe("struck from the front or side", "less", share=True, among_all=True)
def struck_otherwise_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with a pedestrian walking into the vehicle from the side or from the front [1].

    The vehicle's share is under 0.1.
    """
    return contacts_of(trace).fault == Fault.STRUCK


@describe("collisions by the vehicle alone", "less", share=True, among_all=True)
def hit_alone_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with the vehicle driving into a pedestrian or an obstacle [1].

    The vehicle's share is over 0.9.
    """
    return contacts_of(trace).fault == Fault.ALONE


@describe("mutual collisions", "less", share=True, among_all=True)
def hit_both_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with the vehicle and a pedestrian moving into each other [1]."""
    return contacts_of(trace).fault == Fault.BOTH


@describe("vehicle's share of the approach", "less", over_all=True, among_all=True)
def vehicle_share(trace: Trace) -> Float[np.ndarray, "world"]:
    """Part of the approach in the last second before a collision that was the vehicle's, over collisions [1].

    It is phi of `crowdbench.metrics.fault`; 1 for a collision with an obstacle.
    """
    return contacts_of(trace).share
