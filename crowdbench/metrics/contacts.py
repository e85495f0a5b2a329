"""Metrics of contacts: how fast, and whose fault."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.types import Trace
from crowdbench.sim.contacts import LITTLE, Fault, find_contacts


def impact_speed(trace: Trace) -> Float[np.ndarray, "world"]:
    """Relative speed of the vehicle and the pedestrian with whom it collided, over collisions with pedestrians [m/s].

    That of the point of the vehicle that was touched, in the last step.
    """
    return find_contacts(trace).speed


def at_fault_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended in a collision in which the vehicle had a share of 0.1 or more [1]."""
    return find_contacts(trace).share >= LITTLE


def at_fault_seen_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes in which the vehicle was at fault for a collision with somebody who saw it [1].

    It had a share of 0.1 or more in it, as in `at_fault_rate`.
    """
    contacts = find_contacts(trace)
    return (contacts.share >= LITTLE) & contacts.saw


def struck_standing_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with a pedestrian touching the vehicle, which stood [1].

    Its path in the last second was under 5 cm.
    """
    return find_contacts(trace).fault == Fault.STRUCK_STANDING


def struck_behind_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with a pedestrian walking into the vehicle from behind [1].

    The vehicle's share is under 0.1, and the pedestrian was more than 120 degrees from its heading.
    """
    return find_contacts(trace).fault == Fault.STRUCK_BEHIND


def struck_otherwise_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with a pedestrian walking into the vehicle from the side or from before [1].

    The vehicle's share is under 0.1.
    """
    return find_contacts(trace).fault == Fault.STRUCK


def hit_alone_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with the vehicle driving into somebody or something by itself [1].

    Its share is over 0.9.
    """
    return find_contacts(trace).fault == Fault.ALONE


def hit_both_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended with the vehicle and a pedestrian moving into each other [1]."""
    return find_contacts(trace).fault == Fault.BOTH


def vehicle_share(trace: Trace) -> Float[np.ndarray, "world"]:
    """Part of the approach in the last second before a collision that was the vehicle's, over collisions [1].

    It is phi of `crowdbench.sim.contacts`; 1 for a collision with an obstacle.
    """
    return find_contacts(trace).share
