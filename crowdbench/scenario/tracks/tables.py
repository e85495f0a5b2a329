"""Columns of tables in text files: recordings of pedestrians are such tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float, Int

from crowdbench.utils import files
from crowdbench.utils.errors import InputError


class Labels(NamedTuple):
    """A column of texts: the number of each row's text, and the texts."""

    number: Int[np.ndarray, "row"]
    texts: list[str]


def read_numbers(
    path: Path,
    columns: Sequence[str],
    label: str | None = None,
    *,
    names: Sequence[str] = (),
    skip: int = 0,
    separators: str = ",.",
) -> tuple[dict[str, Float[np.ndarray, "row"]], Labels]:
    """Return columns of a table as numbers, and one of them as labels.

    Args:
        path: The file.
        columns: The columns with numbers.
        label: The column with labels, if any.
        names: The names of all columns, if the file does not begin with them.
        skip: The number of lines before the first row, if `names` are given.
        separators: The separator of columns, and that of decimals.

    Raises:
        InputError: The file cannot be read, lacks a column, has no rows, or a number is missing or not finite.
    """
    types: dict[str, pa.DataType] = dict.fromkeys(columns, pa.float64())
    wanted = ", ".join([*columns, label] if label else columns)
    if label is not None:
        types[label] = pa.dictionary(pa.int32(), pa.string())
    try:
        files.check_regular(path)
        table = pa.csv.read_csv(
            path,
            # Without threads, because only then errors contain the row.
            read_options=pa.csv.ReadOptions(use_threads=False, column_names=list(names), skip_rows=skip),
            parse_options=pa.csv.ParseOptions(delimiter=separators[0]),
            convert_options=pa.csv.ConvertOptions(
                include_columns=list(types), column_types=types, decimal_point=separators[1]
            ),
        )
    except (OSError, pa.ArrowException, KeyError) as error:
        reason = " ".join(str(error).split())[:300]
        raise InputError(f"{path} is no table with columns {wanted}: {reason}") from None
    if not len(table):
        raise InputError(f"{path} is empty, but must have a row with {wanted} for each position")
    numbers = {name: table.column(name).to_numpy() for name in columns}
    for name, values in numbers.items():
        for row in np.flatnonzero(~np.isfinite(values))[:1].tolist():
            raise InputError(f"{path}: {name} of row {row + 1} is {values[row]:g}, but must be a finite number")
    if label is None:
        return numbers, Labels(np.zeros(len(table), np.int32), [""])
    coded = table.column(label).unify_dictionaries().combine_chunks()
    return numbers, Labels(coded.indices.to_numpy(), coded.dictionary.to_pylist())
