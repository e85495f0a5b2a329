"""The commands of a run in `commands.parquet`: with the scenario, they determine all states exactly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from crowdbench.core.types import Trace
from crowdbench.scenario.cases import Cases
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError, describe_error

COMMANDS = "commands.parquet"

_SCHEMA = pa.schema([("case", pa.int64()), ("command", pa.list_(pa.float64()))])
"""A row per vehicle: its case, and both numbers of the command of each step, in the units of the dynamics."""


@dataclass(frozen=True)
class StoredCommands:
    """The commands of several cases.

    Attributes:
        case: Number of each case.
        steps: Number of its commands.
        command: The commands of the first case, then of the second, ...
    """

    case: Int[np.ndarray, "case"]
    steps: Int[np.ndarray, "case"]
    command: Float[np.ndarray, "step 2"]

    def of(self, case: int) -> Float[np.ndarray, "step 2"]:
        """Return the commands of one case in m/s. Raises InputError if there are none."""
        (rows,) = np.nonzero(self.case == case)
        if not len(rows):
            raise InputError(f"{COMMANDS} has no commands of case {case}")
        end = int(np.cumsum(self.steps)[rows[0]])
        return self.command[end - int(self.steps[rows[0]]) : end]

    def pad(self, cases: Cases, steps: int) -> Float[np.ndarray, "episode {steps} 2"]:
        """Return the commands of all vehicles of some cases in m/s, padded with zeros to a number of steps."""
        for case in np.setdiff1d(cases.indices, self.case).tolist():
            raise InputError(f"{COMMANDS} has no commands of case {case}")
        rows, ends = np.flatnonzero(np.isin(self.case, cases.indices)), np.cumsum(self.steps)
        padded = np.zeros((len(rows), steps, 2))
        for row, number, end in zip(padded, self.steps[rows], ends[rows], strict=True):
            row[:number] = self.command[end - number : end]
        return padded


def read_commands(path: Path) -> StoredCommands:
    """Read the commands of a run. Raises InputError if the file is missing or has other contents."""
    table = _read_table(path)
    command = pc.list_flatten(table["command"])
    lengths = pc.list_value_length(table["command"])
    if table["case"].null_count or lengths.null_count or command.null_count or np.any(lengths.to_numpy() % 2):
        raise InputError(f"{path} is not a table of commands as crowdbench writes it: values are missing in it")
    steps = lengths.to_numpy().astype(np.int64) // 2
    return StoredCommands(table["case"].to_numpy(), steps, command.to_numpy().reshape(-1, 2))


def write_commands(tables: Iterable[pa.Table], path: Path) -> None:
    """Write tables of commands of consecutive cases into one file, whose row groups have `BATCH` cases."""
    # Opened here, because Arrow accepts only paths in UTF-8.
    with path.open("wb") as file, pq.ParquetWriter(file, _SCHEMA, compression="zstd") as writer:
        waiting = _SCHEMA.empty_table()
        for table in tables:
            waiting = pa.concat_tables([waiting, table])
            while len(waiting) >= BATCH:
                writer.write_table(waiting.slice(0, BATCH).combine_chunks())
                waiting = waiting.slice(BATCH)
        if len(waiting):
            writer.write_table(waiting.combine_chunks())


def join_commands(parts: Sequence[Path], path: Path) -> None:
    """Write the commands of several runs with consecutive cases into one file, as one run would write them.

    Args:
        parts: The files of the runs. Raises InputError if one is missing or has other contents.
        path: The file to write.
    """
    write_commands(map(_read_table, parts), path)


def commands_table(trace: Trace) -> pa.Table:
    """Return the commands of a trace as a part of the file."""
    is_step = np.arange(trace.command.shape[1]) < trace.steps[:, None]
    ends = np.concatenate([[0], np.cumsum(2 * trace.steps)])
    commands = pa.ListArray.from_arrays(pa.array(ends, pa.int32()), pa.array(trace.command[is_step].ravel()))
    return pa.table([pa.array(trace.case), commands], _SCHEMA)


def _read_table(path: Path) -> pa.Table:
    if not path.is_file():
        raise InputError(
            f"there is no {path}, so that the run cannot be simulated again: it was made with --record none"
        )
    try:
        with path.open("rb") as file, pq.ParquetFile(file) as parquet:
            table = parquet.read()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(f"{path} is cut short, damaged or no Parquet file at all: {describe_error(error)}") from None
    if not table.schema.equals(_SCHEMA):
        columns = ", ".join(f"{field.name}: {field.type}" for field in table.schema)
        raise InputError(f"{path} is not a table of commands as crowdbench writes it: it has the columns {columns}")
    return table
