"""The measurements, in the order of the table."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator

from crowdbench.bench import Row, commands, futures, learned, simulator

Measurement = Callable[[], Iterator[Row]]


def measurements(episodes: int) -> list[Measurement]:
    """All of them. How long a training takes is foreseen for so many `episodes`."""
    return [
        simulator.one_world_rows,
        simulator.many_worlds_row,
        simulator.whole_step_row,
        simulator.environment_row,
        learned.batched_rows,
        learned.single_rows,
        learned.share_rows,
        functools.partial(learned.training_row, episodes),
        futures.batched_row,
        futures.single_row,
        commands.start_up_row,
        commands.orca_rows,
        commands.sarl_rows,
        commands.sarl_sgan_kce_rows,
    ]
