"""Chunks of Rerun: what changes with time and what does not."""

from __future__ import annotations

import numpy as np
import rerun as rr
from jaxtyping import Int
from rerun.chunk import Chunk


def times(start: int, stop: int, dt: float) -> list[rr.TimeColumn]:
    """The timeline of consecutive states: seconds since the start.

    Args:
        start: Number of the first state.
        stop: Number of the state after the last one.
        dt: Length of a step in seconds.
    """
    return moments(np.arange(start, stop), dt)


def moments(steps: Int[np.ndarray, "time"], dt: float) -> list[rr.TimeColumn]:
    """The timeline of the given states. A second one, with numbers of steps, would make files larger by a tenth.

    Args:
        steps: Numbers of the states.
        dt: Length of a step in seconds.
    """
    return [rr.TimeColumn("time", duration=steps * dt)]


def still(entity: str, *archetypes: rr.AsComponents) -> Chunk:
    """A chunk of what does not change with time.

    Args:
        entity: Path of the entity.
        archetypes: What it shows.
    """
    batches = [batch for archetype in archetypes for batch in archetype.as_component_batches()]
    return Chunk.from_columns(entity, [], [batch.partition([len(batch.as_arrow_array())]) for batch in batches])
