"""Differences between the files of a run and its replay, one `Difference` for each kind."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Shaped

from crowdbench.core.types import Outcome
from crowdbench.results.episodes import BLOCK, Episodes

TOLERANCE = 1e-6
"""Absolute and relative tolerance of numbers, if versions or machines differ.

In one minute of interacting pedestrians, a rounding difference of 1e-16 grows to 1e-8 or more.
"""

_SHOWN = 3
"""Largest number of cases or values that a message lists."""


@dataclass(frozen=True)
class Difference:
    """One kind of difference.

    Attributes:
        count: Number of cases or values that differ.
        of: Number of the compared cases or values.
        what: Kind of the cases or values, and their fault.
        first: The first cases or values that differ, as texts.
    """

    count: int
    of: int
    what: str
    first: Sequence[str]

    def __str__(self) -> str:
        more = ", ..." if self.count > len(self.first) else ""
        return f"{self.count} of {self.of} {self.what}: {', '.join(self.first)}{more}"


def find_differences(what: str, texts: Iterable[str], of: int) -> list[Difference]:
    """Return a difference in a list, or an empty list if `texts` is empty.

    Args:
        what: The kind of the difference, as the subject and verb of a sentence.
        texts: A text for each case or value that differs.
        of: Number of the compared cases or values.
    """
    texts = list(texts)
    return [Difference(len(texts), of, what, texts[:_SHOWN])] if texts else []


def compare_values(
    what: str, names: Sequence[str], recorded: Iterable[object], replayed: Iterable[object]
) -> list[Difference]:
    """Return a difference for the named values that are not equal in the run and its replay."""
    pairs = zip(names, recorded, replayed, strict=True)
    texts = [f"{name} ({before}, replayed: {now})" for name, before, now in pairs if before != now]
    return find_differences(what, texts, len(names))


def compare_episodes(names: Sequence[str], recorded: Episodes, replayed: Episodes, exact: bool) -> list[Difference]:
    """Return the differences between the rows of `episodes.csv` and the replay.

    Args:
        names: The name of the case of each row.
        recorded: The rows of the file.
        replayed: The rows of the replay, of the same cases.
        exact: True if numbers must agree to the last bit; otherwise they must agree to `TOLERANCE`.
    """
    blocks = [table.block if table.block is not None else np.full(len(names), -1) for table in (recorded, replayed)]
    moved = (f"{names[row]} ({BLOCK})" for row in np.flatnonzero(blocks[0] != blocks[1]).tolist())
    figures: dict[int, str] = {}
    for metric in (name for name in replayed.columns if name in recorded.columns):
        columns = recorded.columns[metric], replayed.columns[metric]
        for row in np.flatnonzero(~_agree(*columns, exact)).tolist():
            figures.setdefault(row, f"{names[row]} ({metric} {columns[0][row]}, replayed: {columns[1][row]})")
    return [
        *compare_values("cases end otherwise than episodes.csv says", names, _ends(recorded), _ends(replayed)),
        *find_differences("cases are of another block of time in episodes.csv", moved, len(names)),
        *find_differences(
            "cases have other figures in episodes.csv", (figures[row] for row in sorted(figures)), len(names)
        ),
    ]


def _agree(a: Shaped[np.ndarray, "*shape"], b: Shaped[np.ndarray, "*shape"], exact: bool) -> Bool[np.ndarray, "*shape"]:
    """Return an array that is True for each element in which two arrays agree. NaN agrees with NaN."""
    if exact or a.dtype.kind != "f" or b.dtype.kind != "f":
        return np.asarray((a == b) | ((a != a) & (b != b)))
    return np.asarray(np.isclose(a, b, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True))


def _ends(table: Episodes) -> list[str]:
    ends = zip(table.outcome.tolist(), table.steps.tolist(), strict=True)
    return [f"{Outcome(outcome).label} after {steps} steps" for outcome, steps in ends]
