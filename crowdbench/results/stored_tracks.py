"""The tracks of a run that was not simulated, such as the drives of a robot: all states, in `tracks.parquet`."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from crowdbench.core.types import Rules, Trace
from crowdbench.utils.errors import InputError, describe_error

TRACKS = "tracks.parquet"

FORMAT = 1
"""Version of the format of the file."""

_KEY = b"crowdbench"
"""Key of the metadata of the file: format, split, rules, and the shape of each array in one episode, as JSON."""

_NOT_ARRAYS = ("split", "rules", "logs")


def write_tracks(trace: Trace, path: Path) -> None:
    """Write the states of episodes. The file has a row per episode and a column per array of the trace.

    Each cell is a list of all numbers of the array in the episode, in C order. Logs of planners are not stored.

    Args:
        trace: The episodes.
        path: The file, whose name in a run is `TRACKS`.
    """
    columns: dict[str, pa.Array] = {}
    shapes: dict[str, tuple[int, ...]] = {}
    for field in dataclasses.fields(Trace):
        array = getattr(trace, field.name)
        if field.name in _NOT_ARRAYS or array is None:
            continue
        shapes[field.name] = array.shape[1:]
        size = math.prod(array.shape[1:])
        offsets = pa.array(np.arange(len(trace) + 1) * size, pa.int32())
        columns[field.name] = pa.ListArray.from_arrays(offsets, pa.array(array.ravel()))
    about = {"format": FORMAT, "split": trace.split, "rules": trace.rules.to_table(), "shapes": shapes}
    table = pa.table(columns).replace_schema_metadata({_KEY: json.dumps(about)})
    with path.open("wb") as file:  # opened here, because Arrow accepts only paths in UTF-8
        pq.write_table(table, file, compression="zstd")


def read_tracks(path: Path) -> Trace:
    """Read the episodes that `write_tracks` wrote, equal to the last bit.

    Raises InputError if the file is missing, damaged, or has other contents.
    """
    if not path.is_file():
        raise InputError(f"there is no {path}")
    try:
        with path.open("rb") as file, pq.ParquetFile(file) as parquet:
            table = parquet.read()
        about = json.loads((table.schema.metadata or {})[_KEY])
        if about["format"] != FORMAT:
            raise ValueError(f"it has the format {about['format']}, and this version reads format {FORMAT}")
        arrays: dict[str, Any] = {}
        for name, shape in about["shapes"].items():
            values = table[name].combine_chunks().flatten().to_numpy(zero_copy_only=False)
            arrays[name] = values.reshape(len(table), *shape)
        return Trace(split=about["split"], rules=Rules.of_table(about["rules"]), **arrays)
    except (pa.ArrowException, OSError, LookupError, TypeError, ValueError) as error:
        raise InputError(f"{path} is not a table of tracks as crowdbench writes it: {describe_error(error)}") from None
