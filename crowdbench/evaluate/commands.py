"""The commands of a run in `commands.parquet`: with the scenario, all that it takes to simulate each case again."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from crowdbench.types import Trace

COMMANDS = "commands.parquet"

_SCHEMA = pa.schema([("case", pa.int64()), ("command", pa.list_(pa.float64()))])
"""A row per case: its number, and x and y of the command of each of its steps, in m/s."""


@contextlib.contextmanager
def writing(path: Path) -> Iterator[Callable[[Trace], None]]:
    """A function that writes the commands of a trace into a file, one trace after the other.

    Args:
        path: The file, which is complete when the `with` statement ends.
    """
    with pq.ParquetWriter(path, _SCHEMA, compression="zstd") as writer:
        yield lambda trace: writer.write_table(_table(trace))


def _table(trace: Trace) -> pa.Table:
    driven = np.arange(trace.command.shape[1]) < trace.steps[:, None]
    ends = np.concatenate([[0], np.cumsum(2 * trace.steps)])
    commands = pa.ListArray.from_arrays(pa.array(ends, pa.int32()), pa.array(trace.command[driven].ravel()))
    return pa.table([pa.array(trace.case), commands], _SCHEMA)
