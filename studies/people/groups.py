"""Groups of persons in recorded tracks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from crowdbench.core import norm

TOGETHER = 10
"""Fewest common frames of two members, 4 s."""

APART, DRIFT = 1.5, 0.3
"""Largest median distance in metres of two members, and largest difference in m/s of their mean velocities."""


def find_groups(position: Float[np.ndarray, "time person 2"], dt: float = 0.4) -> Int[np.ndarray, "person"]:
    """Return the number of each person's group, a separate one for persons that walk alone.

    Two persons belong together if they are present together in at least `TOGETHER` frames, their median distance is at
    most `APART`, and their mean velocities in these frames differ by at most `DRIFT`. Groups are connected pairs.

    Args:
        position: In metres, NaN for absent persons, who are present without a gap.
        dt: Seconds between two frames.
    """
    present = np.isfinite(position[..., 0])
    first, last = present.argmax(axis=0), len(present) - 1 - present[::-1].argmax(axis=0)
    people, pairs = len(first), []
    for i in range(people):
        for j in range(i + 1, people):
            begin, end = max(first[i], first[j]), min(last[i], last[j])
            if end - begin + 1 < TOGETHER:
                continue
            apart = position[begin : end + 1, i] - position[begin : end + 1, j]
            drift = norm(apart[-1] - apart[0]) / ((end - begin) * dt)
            if np.median(norm(apart)) <= APART and drift <= DRIFT:
                pairs.append((i, j))
    rows, columns = np.array(pairs, np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(people, people))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)
