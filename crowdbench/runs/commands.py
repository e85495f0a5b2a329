"""The commands of a run in `commands.parquet`: with the scenario, all that it takes to simulate each case again."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from crowdbench.core.types import Trace
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError, describe_error

COMMANDS = "commands.parquet"

_SCHEMA = pa.schema([("case", pa.int64()), ("command", pa.list_(pa.float64()))])
"""A row per case: its number, and x and y of the command of each of its steps, in m/s."""


@dataclass(frozen=True)
class Commands:
    """The commands of several cases.

    Attributes:
        case: Number of each case.
        steps: Number of its commands.
        command: The commands of the first case in m/s, then those of the second, ...
    """

    case: Int[np.ndarray, "case"]
    steps: Int[np.ndarray, "case"]
    command: Float[np.ndarray, "step 2"]

    def pad(self, rows: Int[np.ndarray, "row"], steps: int) -> Float[np.ndarray, "row {steps} 2"]:
        """The commands of some cases, zero after the last one.

        Args:
            rows: Which cases, by their indices.
            steps: For how many steps; later commands are left out.

        Returns:
            Commands in m/s.
        """
        ends = np.cumsum(self.steps)
        padded = np.zeros((len(rows), steps, 2))
        for own, end, length in zip(padded, ends[rows], self.steps[rows], strict=True):
            own[:length] = self.command[end - length : end][:steps]
        return padded


@contextlib.contextmanager
def open_writer(path: Path) -> Iterator[Callable[[Trace], None]]:
    """A function that writes the commands of a trace into a file, one trace after the other.

    Args:
        path: The file, which is complete when the `with` statement ends.
    """
    # Opened here, because Arrow takes only paths that are UTF-8.
    with path.open("wb") as file, pq.ParquetWriter(file, _SCHEMA, compression="zstd") as writer:
        yield lambda trace: writer.write_table(_table(trace))


def _table(trace: Trace) -> pa.Table:
    driven = np.arange(trace.command.shape[1]) < trace.steps[:, None]
    ends = np.concatenate([[0], np.cumsum(2 * trace.steps)])
    commands = pa.ListArray.from_arrays(pa.array(ends, pa.int32()), pa.array(trace.command[driven].ravel()))
    return pa.table([pa.array(trace.case), commands], _SCHEMA)


def join(parts: Sequence[Path], path: Path) -> None:
    """Write the commands of several runs, whose cases follow each other, as one run would write them.

    Args:
        parts: The files of the runs. Raises InputError where one is missing or has other contents.
        path: The file to write.
    """
    table = pa.concat_tables([_table_of(part) for part in parts])
    with path.open("wb") as file, pq.ParquetWriter(file, _SCHEMA, compression="zstd") as writer:
        for start in range(0, len(table), BATCH):
            writer.write_table(table.slice(start, BATCH).combine_chunks())


def read(path: Path) -> Commands:
    """Read what `open_writer` wrote. Raises InputError where the file is missing or has other contents."""
    table = _table_of(path)
    command = pc.list_flatten(table["command"])
    lengths = pc.list_value_length(table["command"])
    if table["case"].null_count or lengths.null_count or command.null_count or np.any(lengths.to_numpy() % 2):
        raise InputError(f"{path} is not a table of commands as crowdbench writes it: values are missing in it")
    steps = lengths.to_numpy().astype(np.int64) // 2
    return Commands(table["case"].to_numpy(), steps, command.to_numpy().reshape(-1, 2))


def _table_of(path: Path) -> pa.Table:
    if not path.is_file():
        raise InputError(
            f"there is no {path}, so that the run cannot be replayed: it was made with --record none or before "
            "crowdbench kept commands"
        )
    try:
        with path.open("rb") as file, pq.ParquetFile(file) as parquet:
            table = parquet.read()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(f"{path} is cut short, damaged or no Parquet file at all: {describe_error(error)}") from None
    if not table.schema.equals(_SCHEMA):
        found = ", ".join(f"{field.name}: {field.type}" for field in table.schema)
        raise InputError(f"{path} is not a table of commands as crowdbench writes it: it has the columns {found}")
    return table
