"""The ways that a planner predicted and considered, as a recording shows them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from rerun.chunk import Chunk

WAYS = re.compile(r"/world/planner/\w+/\d")
"""Where `decisions` draws lines over time."""

BEST = 12
"""How many of the ways that a planner considers are read, the best ones."""

STRIPS, COLORS = "LineStrips2D:strips", "LineStrips2D:colors"


class Ways(NamedTuple):
    """Ways in metres that belong to one state.

    Attributes:
        predicted: Those of pedestrians.
        considered: The best of those that the vehicle could drive.
    """

    predicted: list[Float[np.ndarray, "point 2"]]
    considered: list[Float[np.ndarray, "point 2"]]


def read_ways(chunks: Sequence[Chunk], dt: float) -> dict[int, Ways]:
    """The ways in the chunks of an episode, by the number of the state.

    Args:
        chunks: All its chunks.
        dt: Length of a step in seconds.
    """
    found: dict[int, Ways] = {}
    for chunk in chunks:
        if not WAYS.fullmatch(chunk.entity_path) or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        states = np.round(batch["time"].cast(pa.int64()).to_numpy() / (1e9 * dt)).astype(int)
        is_valued = COLORS in batch.schema.names
        for row, state in enumerate(states.tolist()):
            ways = found.setdefault(state, Ways([], []))
            strips = [np.array(strip, float) for strip in batch[STRIPS][row].as_py() or []]
            if is_valued:  # dark to light by their value
                colors = np.array(batch[COLORS][row].as_py() or [], np.uint32).view(np.uint8).reshape(-1, 4)
                best = np.argsort(-colors.sum(axis=1, dtype=int), kind="stable")[:BEST]
                strips = [strips[number] for number in best]
            (ways.considered if is_valued else ways.predicted).extend(strips)
    return found
