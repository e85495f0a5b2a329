"""The episodes of an entry on a board, a row for each case in one Parquet file.

public.parquet   the public cases, with the commands from which they are simulated again
season.parquet   the ranked cases of a season
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from crowdbench import Cases, Episodes, InputError, Outcome
from crowdbench.results import COMMANDS
from crowdbench.utils import describe_error, write_whole
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.entry import PUBLIC
from crowdbench_leaderboards.memory_limit import limit_memory

SCENARIO = "scenario"
COMMAND = "command"

MAX_MEMORY = 4e9
"""Bytes that reading a file of an entry may take."""

MOST_STEPS = 1000
"""Steps of a case in a file of an entry, at most."""

_KEYS = {SCENARIO: pa.string(), "case": pa.int64(), "outcome": pa.string(), "steps": pa.int64()}
_COMMANDS_TYPE = pa.list_(pa.float64())


def write_table(path: Path, episodes: Mapping[str, Episodes], runs: Path | None = None) -> None:
    """Write the episodes of all scenarios into one file, completely or not at all.

    Args:
        path: The file.
        episodes: The episodes by scenario.
        runs: The folder of the runs, with whose commands the file is written; None for a file without commands.
    """
    tables = []
    for name, own in episodes.items():
        table = own.to_arrow()
        table = table.add_column(0, SCENARIO, pa.array([name] * len(own), pa.string()))
        if runs is not None:
            with (runs / name / COMMANDS).open("rb") as file, pq.ParquetFile(file, pre_buffer=False) as parquet:
                command = parquet.read(["command"], use_threads=False)["command"]  # threads may end the process badly
            scored = np.arange(len(own)) * (len(command) // len(own))  # of other vehicles, which the board drives, none
            table = table.append_column(COMMAND, command.take(scored))
        tables.append(table)
    with write_whole(path) as partial:
        pq.write_table(pa.concat_tables(tables), partial, compression="zstd")


def read_table(path: Path, board: Board, cases: Cases, folder: Path | None = None) -> dict[str, Episodes]:
    """Read the episodes of an entry by scenario. The file may come from a stranger.

    Args:
        path: The file.
        board: The board.
        cases: The cases of each scenario that the file must have.
        folder: The folder that gets a folder for each scenario with its commands; None to leave them out.

    Raises:
        InputError: The file is missing, too large, damaged, or has other columns, scenarios or cases.
    """
    try:
        with limit_memory(MAX_MEMORY):
            return _read(path, board, cases, folder)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError, OverflowError) as error:
        raise InputError(f"{path} is missing, damaged or no table of episodes: {describe_error(error)}") from None


def _read(path: Path, board: Board, cases: Cases, folder: Path | None) -> dict[str, Episodes]:
    steps = MOST_STEPS if path.name == PUBLIC else 0
    blocks = {"vehicle": pa.int64()} if board.is_fleet else {"block": pa.int64()} if board.spec.recorded else {}
    commands = {COMMAND: _COMMANDS_TYPE} if path.name == PUBLIC else {}
    expected = [*_KEYS, *blocks, *board.metrics, *commands]
    with path.open("rb") as file, pq.ParquetFile(file, pre_buffer=False) as parquet:
        rows = len(cases) * sum(map(board.scored_vehicles, board.scenarios))
        _check_size(parquet, rows, steps, len(board.metrics))
        if parquet.schema_arrow.names != expected:
            raise InputError(f"its columns are not {', '.join(expected)}")
        if not folder:
            commands = {}
        table = parquet.read([*_KEYS, *blocks, *board.metrics, *commands], use_threads=False)
    for name, kind in {**_KEYS, **blocks, **commands}.items():
        if table.schema.field(name).type != kind or table[name].null_count:
            raise InputError(f"its column {name} must have the type {kind}, and no missing values")
    if unknown := set(pc.unique(table[SCENARIO]).to_pylist()) - set(board.scenarios):
        raise InputError(f"the board has no scenario {min(unknown)!a}")
    episodes = {}
    for name in board.scenarios:
        rows = table.filter(pc.equal(table[SCENARIO], name))
        if not len(rows):
            continue
        vehicles = board.scored_vehicles(name)
        if not np.array_equal(rows["case"].to_numpy(), cases.indices.repeat(vehicles)):
            raise InputError(f"its cases of {name} are not {cases}")
        if board.is_fleet and not np.array_equal(rows["vehicle"].to_numpy(), np.tile(np.arange(vehicles), len(cases))):
            raise InputError(f"its vehicles in {name} are not the first {vehicles}")
        episodes[name] = episodes_of(rows, board)
        if folder:
            (folder / name).mkdir(parents=True)
            pq.write_table(rows.select(["case", COMMAND]), folder / name / COMMANDS)
    if not episodes:
        raise InputError("it has no cases")
    return episodes


def episodes_of(rows: pa.Table, board: Board) -> Episodes:
    """Return the episodes of a scenario from its rows. Raises InputError if a metric has a wrong type."""
    columns: dict[str, Any] = {}
    for name in board.metrics:
        column = rows[name]
        if column.type == pa.bool_() and not column.null_count:
            columns[name] = column.to_numpy()
        elif column.type == pa.float64():
            columns[name] = pc.fill_null(column, np.nan).to_numpy()
        else:
            raise InputError(f"its column {name} has the type {column.type}")
        if np.isinf(columns[name]).any():
            raise InputError(f"its column {name} has an infinite value")
    outcome = np.array([Outcome[text.upper()] for text in rows["outcome"].to_pylist()], np.int64)
    case, vehicle = rows["case"].to_numpy(), rows["vehicle"].to_numpy() if board.is_fleet else None
    block = case if board.is_fleet else rows["block"].to_numpy() if board.spec.recorded else None
    return Episodes(case, outcome, rows["steps"].to_numpy(), columns, block, vehicle)


def _check_size(parquet: pq.ParquetFile, rows: int, steps: int, metrics: int) -> None:
    """Raise InputError if a file is larger than episodes can be, before it is decompressed.

    Args:
        parquet: The file.
        rows: Number of cases of all scenarios.
        steps: Largest number of steps of a case; 0 for a file without commands.
        metrics: Number of metrics.
    """
    groups = [parquet.metadata.row_group(index) for index in range(parquet.metadata.num_row_groups)]
    size = sum(group.column(index).total_uncompressed_size for group in groups for index in range(group.num_columns))
    most = 1_000_000 + 2 * 8 * rows * (2 * (steps + 1) + metrics)  # twice the size of its numbers
    if parquet.metadata.num_rows > rows or size > most:
        raise InputError(
            f"it holds {parquet.metadata.num_rows} cases in {size / 1e6:.0f} MB, but there are {rows} cases in "
            f"{most / 1e6:.0f} MB at most"
        )
