"""A metric: the seconds close to pedestrians while the vehicle moves."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import Trace
from crowdbench.core import HOLONOMIC, norm
from crowdbench.metrics import describe, fill_close_seconds

STANDING = 0.1
"""Mean speed in m/s below which the vehicle stands in a step."""


@describe("time close to pedestrians while moving", "less", of_successes=True)
def t_close_moving(trace: Trace) -> Float[np.ndarray, "world"]:
    """`t_close` without the steps in which the vehicle stands [s]."""
    rules = trace.rules.numbers
    stands = norm(np.diff(trace.position[:, :, 0], axis=1)) < STANDING * rules.dt
    # A step counts only with the same person before and after it: another number takes a step out.
    number = np.zeros(trace.person.shape[:2], np.int64)
    number[:, 1:] = np.cumsum(stands, axis=1)
    persons = trace.person + (number * (1 + trace.person.max(initial=0)))[..., None]
    seconds = np.zeros(len(trace))
    states = trace.position, trace.velocity, trace.heading, np.ascontiguousarray(trace.radius)
    fill_close_seconds(*states, persons, trace.steps, rules.body, rules.code != HOLONOMIC, rules.dt, seconds)
    return seconds
