"""The pedestrians that a planner is shown where there are more than it could use: the nearest ones."""

from __future__ import annotations

import dataclasses
from typing import no_type_check

import numpy as np
from jaxtyping import Int

from crowdbench.core.types import Observation
from crowdbench.utils.compiled import njit

_OVER_TIME = ("history", "filled")
"""What has an axis `time` before the axis `pedestrian`."""


def with_nearest(obs: Observation, number: int | None) -> Observation:
    """An observation of the nearest pedestrians only.

    Args:
        obs: The observation.
        number: How many pedestrians there are in the new one, if the old one has more; all if None.

    Returns:
        The observation of those whose centres are nearest to the vehicle's position, of two at the same distance the
        one that comes first. They are in the same order as before. Who is not seen only fills the places of a world in
        which fewer are seen.
    """
    crowd = obs.pedestrians
    if number is None or number >= crowd.seen.shape[1]:
        return obs
    index = np.empty((len(obs), number), np.int64)
    _find_nearest(obs.vehicle.position, crowd.position, crowd.seen, index)
    shown = {name: _taken(part, index, name in _OVER_TIME) for name, part in vars(crowd).items() if part is not None}
    future = None if obs.future is None else _taken(obs.future, index, False)
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, **shown), future=future)


def _taken(array: np.ndarray, index: Int[np.ndarray, "world nearest"], is_over_time: bool) -> np.ndarray:
    """The rows of some pedestrians, in an array of its own."""
    row = np.arange(len(index))[:, None]
    return array[row, :, index].swapaxes(1, 2).copy() if is_over_time else array[row, index]


@no_type_check
@njit
def _find_nearest(position, others, seen, index):
    """Find those who are shown, see `with_nearest`.

    Args:
        position: `[world, 2]`, of the vehicle, in metres.
        others: `[world, pedestrian, 2]`, in metres.
        seen: `[world, pedestrian]`.
        index: `[world, nearest]`, filled: pedestrians in ascending order.
    """
    number = index.shape[1]
    distance = np.empty(number)
    for w in range(len(index)):
        n = 0
        for p in range(seen.shape[1]):
            dx, dy = others[w, p, 0] - position[w, 0], others[w, p, 1] - position[w, 1]
            apart = dx * dx + dy * dy if seen[w, p] else np.inf
            if n == number and not apart < distance[n - 1]:
                continue
            slot = n if n < number else n - 1
            while slot > 0 and apart < distance[slot - 1]:
                index[w, slot], distance[slot] = index[w, slot - 1], distance[slot - 1]
                slot -= 1
            index[w, slot], distance[slot] = p, apart
            n = min(n + 1, number)
        index[w].sort()
