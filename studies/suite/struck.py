"""Metrics of the study: contacts that the vehicle could not have avoided, and contacts that pedestrians should have."""

import numpy as np
from jaxtyping import Bool

from crowdbench import Trace
from crowdbench.metrics import SMALL_SHARE, Fault, contacts_of, describe


@describe("struck", "less", share=True)
def struck_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes that ended in a contact in which the vehicle had no share, or one below 0.1 [1]."""
    contacts = contacts_of(trace)
    return (contacts.fault != Fault.NONE) & ~(contacts.share >= SMALL_SHARE)


@describe("struck standing though noticed", "less", share=True)
def struck_noticed_rate(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Share of episodes ended by a pedestrian that had noticed the vehicle, and touched it after it stood 1 s [1]."""
    contacts = contacts_of(trace)
    return (contacts.fault == Fault.STRUCK_STANDING) & contacts.saw
