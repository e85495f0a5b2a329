"""The episodes of a run, a row each in `episodes.csv`, and the label of a planner with its settings."""

from __future__ import annotations

import csv
import importlib.util
import io
import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int, Shaped

from crowdbench.core.types import Outcome, Trace
from crowdbench.core.types.rules import MAX_VEHICLES
from crowdbench.metrics.registry import Metric, is_rate
from crowdbench.metrics.summary import Estimate, summarize
from crowdbench.metrics.user_metrics import LARGEST, measure
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, describe_error

if TYPE_CHECKING:
    import pyarrow as pa

EPISODES = "episodes.csv"
RECORDING = "run.rrd"
BLOCK = "block"
"""The column of `episodes.csv` with the block of recorded time of each case, if pedestrians are recorded."""
VEHICLE = "vehicle"
"""The column with the vehicle of each episode, if there are several in a world."""


@dataclass(frozen=True)
class Episodes:
    """One row per episode. `to_pandas`, `to_arrow` and `polars.DataFrame(episodes)` are tables of them.

    Iteration yields the row of each case as a dictionary, so that `pandas.DataFrame(episodes)` works, too.

    Attributes:
        case: Number of the case.
        outcome: How the episode ended, an `Outcome`.
        steps: Steps until it ended.
        columns: The values of each metric by its name; booleans are rates, NaN is undefined.
        block: The block of each case, as in `Trace`.
        vehicle: Index of the vehicle of each episode; None with one vehicle in a world.
    """

    case: Int[np.ndarray, "case"]
    outcome: Int[np.ndarray, "case"]
    steps: Int[np.ndarray, "case"]
    columns: Mapping[str, Shaped[np.ndarray, "case"]]
    block: Int[np.ndarray, "case"] | None = None
    vehicle: Int[np.ndarray, "case"] | None = None

    def __len__(self) -> int:
        return len(self.case)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        columns = self._first_columns() | {name: values.tolist() for name, values in self.columns.items()}
        return (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))

    @property
    def failures(self) -> dict[str, list[int]]:
        """The cases that failed, by outcome."""
        failed = [end for end in (Outcome.COLLISION, Outcome.WALL_COLLISION, Outcome.TIMEOUT) if end in self.outcome]
        return {outcome.label: np.unique(self.case[self.outcome == outcome]).tolist() for outcome in failed}

    @property
    def key(self) -> Int[np.ndarray, "case"]:
        """A number for each episode, which is the same in all runs of its split: the case and the vehicle."""
        return self.case * (MAX_VEHICLES + 1) + (0 if self.vehicle is None else self.vehicle)

    @classmethod
    def of(cls, trace: Trace, metrics: Mapping[str, Metric]) -> Episodes:
        """Measure a trace.

        Args:
            trace: The trace.
            metrics: The metrics, by name.

        Raises:
            InputError: A metric raises, or does not return one value per episode.
        """
        columns = {name: measure(name, metric, trace) for name, metric in metrics.items()}
        return cls(trace.case, trace.outcome, trace.steps, columns, trace.block, trace.vehicle)

    @classmethod
    def join(cls, parts: list[Episodes]) -> Episodes:
        """Return the rows of all parts, in order."""
        names = ("case", "outcome", "steps")
        case, outcome, steps = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        columns = {name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns}
        optional = {name: [getattr(part, name) for part in parts] for name in ("block", "vehicle")}
        joined = {name: np.concatenate(arrays) for name, arrays in optional.items() if arrays[0] is not None}
        return cls(case, outcome, steps, columns, **joined)

    @property
    def rates(self) -> list[str]:
        """The names of the metrics that are rates."""
        return [name for name, values in self.columns.items() if is_rate(values)]

    @property
    def blocks(self) -> dict[str, int]:
        """The number of blocks of recorded time, as an entry of results; empty without recorded pedestrians."""
        return {} if self.block is None else {"blocks": len(np.unique(self.block))}

    def take(self, rows: Shaped[np.ndarray, "row"]) -> Episodes:
        """Return the given rows."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        block, vehicle = (None if array is None else array[rows] for array in (self.block, self.vehicle))
        return Episodes(self.case[rows], self.outcome[rows], self.steps[rows], columns, block, vehicle)

    def of_first_vehicle(self) -> Episodes:
        """Return the rows of the first vehicle of each case."""
        return self.take(np.flatnonzero(self.vehicle == 0))

    def without(self, metrics: Collection[str]) -> Episodes:
        """Return all rows without the columns of some metrics."""
        columns = {name: values for name, values in self.columns.items() if name not in metrics}
        return replace(self, columns=columns)

    def summary(self, names: Iterable[str] | None = None) -> dict[str, Estimate]:
        """Return the mean and the interval of the named metrics, or of all metrics."""
        columns = self.columns if names is None else {name: self.columns[name] for name in names}
        return summarize(columns, self.steps, self.block)

    def counts(self) -> dict[str, int]:
        """Return the number of episodes of each outcome, by its label."""
        return {outcome.label: int((self.outcome == outcome).sum()) for outcome in list(Outcome)[1:]}

    def to_arrow(self) -> pa.Table:
        """Return an Arrow table with a row per episode: case, outcome, steps and all metrics. Undefined values are
        null."""
        import pyarrow as pa

        columns = {name: pa.array(values, from_pandas=True) for name, values in self.columns.items()}
        return pa.table({**self._first_columns(), **columns})

    def to_pandas(self) -> Any:
        """Return the same table as a `pandas.DataFrame`. Raises InputError if pandas is not installed."""
        if importlib.util.find_spec("pandas") is None:
            raise InputError("to_pandas needs pandas: install it with pip install pandas, or use to_arrow()")
        return self.to_arrow().to_pandas()

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Return the table as a stream for pandas, polars and others, see Arrow's PyCapsule interface."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)

    def write(self, path: Path) -> None:
        """Write the episodes as CSV. Numbers are exact to the last bit."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            columns = self._first_columns() | {name: _texts(values) for name, values in self.columns.items()}
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))

    def _first_columns(self) -> dict[str, list[Any]]:
        """Return the columns of every table of episodes before the metrics."""
        labels = [Outcome(outcome).label for outcome in self.outcome]
        more = {}
        if self.vehicle is not None:  # the block is the case
            more = {VEHICLE: self.vehicle.tolist()}
        elif self.block is not None:
            more = {BLOCK: self.block.tolist()}
        return {"case": self.case.tolist(), "outcome": labels, "steps": self.steps.tolist(), **more}

    @classmethod
    def read(cls, path: Path) -> Episodes:
        """Read a file that `write` wrote. Raises InputError if the file is missing or has other contents."""
        try:
            header, *rows = csv.reader(io.StringIO(files.read_text(path), newline=""))
            by_name = dict(zip(header, zip(*rows, strict=True), strict=True))
            if len(by_name) < len(header):
                raise ValueError("two columns have the same name")
            case, steps = (np.array([int(text) for text in by_name.pop(name)], np.int64) for name in ("case", "steps"))
            outcome = np.array([Outcome[text.upper()] for text in by_name.pop("outcome")], np.int64)
            block, vehicle = (
                np.array([int(text) for text in by_name.pop(name)], np.int64) if name in by_name else None
                for name in (BLOCK, VEHICLE)
            )
            columns = {name: _values(texts) for name, texts in by_name.items()}
            return cls(case, outcome, steps, columns, block if vehicle is None else case, vehicle)
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror}") from None
        except (ValueError, KeyError, OverflowError, csv.Error) as error:
            raise InputError(f"{path} is no table of episodes of crowdbench: {describe_error(error)}") from None


def planner_label(planner: str, settings: Mapping[str, Any]) -> str:
    """Return a planner's name for display, with its options and replanning in brackets and TOML syntax.

    For example, `sarl (modes=5, limits={max_velocity_change=1.0}, explore=false)`.
    """
    return f"{planner} ({_format_table(settings)})" if settings else planner


def result_label(result: Mapping[str, Any]) -> str:
    """Return `planner_label` of a run, from the contents of its `result.json`, with a mark of `Planner.raw`."""
    run = result["run"]
    others = {"others": run["others"]["name"]} if "others" in run else {}
    label = planner_label(run["planner"]["name"], {**run["planner"]["options"], **run["replanning"], **others})
    return f"{label} (raw)" if result["stated"].get("raw") else label


def _format_table(table: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}={_format_value(value)}" for key, value in table.items())


def _format_value(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{{_format_table(value)}}}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def read_estimate(table: Mapping[str, Any]) -> Estimate:
    """Read an estimate from the JSON table that `plain` returns. `None` is NaN."""
    numbers: dict[str, Any] = {name: math.nan if value is None else value for name, value in table.items()}
    return Estimate(**numbers)


def _texts(values: Shaped[np.ndarray, "case"]) -> list[str]:
    if values.dtype == bool:
        return ["true" if value else "false" for value in values]
    return ["" if math.isnan(value) else repr(value) for value in values.tolist()]


def _values(texts: tuple[str, ...]) -> Shaped[np.ndarray, "case"]:
    if set(texts) <= {"true", "false"}:
        return np.array([text == "true" for text in texts])
    values = np.array([float(text) if text else math.nan for text in texts])
    if (np.abs(values) > LARGEST).any():
        raise ValueError(f"a value is beyond {LARGEST:g}")
    return values
