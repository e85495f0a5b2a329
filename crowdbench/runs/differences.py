"""Differences between the files of a run and its replay, one `Difference` for each kind."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Int, Shaped

from crowdbench.core.types import Outcome
from crowdbench.results.episodes import BLOCK, Episodes
from crowdbench.scenario.cases import Cases
from crowdbench.utils.tables import flatten

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


class Differences(list[Difference]):
    """All differences between a run and its replay.

    Attributes:
        cases: The cases of the run.
        exact: True if numbers must agree to the last bit; otherwise they must agree to `TOLERANCE`.
    """

    def __init__(self, cases: Cases, exact: bool) -> None:
        super().__init__()
        self.cases = cases
        self.exact = exact

    def note(self, what: str, texts: Iterable[str], of: int) -> None:
        """Add a difference, unless `texts` is empty.

        Args:
            what: The kind of the difference, as the subject and verb of a sentence.
            texts: A text for each case or value that differs.
            of: Number of the compared cases or values.
        """
        texts = list(texts)
        if texts:
            self.append(Difference(len(texts), of, what, texts[:_SHOWN]))

    def note_pairs(self, what: str, pairs: Iterable[tuple[str, object, object]], of: int) -> None:
        """Add a difference for the cases or values whose recorded and replayed values differ.

        Args:
            what: See `note`.
            pairs: Name, recorded and replayed value of each case or value.
            of: Number of the compared cases or values.
        """
        differ = (pair for pair in pairs if not self._is_same(*pair[1:]))
        self.note(what, (f"{name} ({recorded}, replayed: {replayed})" for name, recorded, replayed in differ), of)

    def name(self, case: int) -> str:
        """Return the name of a case in messages."""
        return f"{self.cases.split}/{case}"

    def note_rows(self, file: str, rows: Int[np.ndarray, "row"], *, some_missing: bool = False) -> None:
        """Add a difference if a file does not have exactly one row for each case.

        Args:
            file: The file.
            rows: The case of each row.
            some_missing: True if cases may have no row.
        """
        counts = Counter(rows.tolist())
        known = Counter(case for case in counts if self.cases.start <= case < self.cases.stop)
        lacking = (self.name(case) for case in range(self.cases.start, self.cases.stop) if case not in known)
        if not some_missing and len(known) < len(self.cases):
            first = list(itertools.islice(lacking, _SHOWN))  # a forged number of cases may be of any size
            what = f"cases have no row in {file}"
            self.append(Difference(len(self.cases) - len(known), len(self.cases), what, first))
        beyond = map(self.name, (counts - known).elements())
        self.note(f"rows of {file} are duplicates, or belong to other cases than {self.cases}", beyond, len(rows))

    def note_values(self, file: str, recorded: Mapping[str, Any], replayed: Mapping[str, Any]) -> None:
        """Add a difference for the values of a file, also in nested tables, that differ from the replay.

        Args:
            file: The file.
            recorded: Its values.
            replayed: Values of the replay.
        """
        ours, theirs = flatten(replayed), flatten(recorded)
        names = list({**ours, **theirs})
        self.note_pairs(f"values in {file} differ", ((n, theirs.get(n), ours.get(n)) for n in names), len(names))

    def note_episodes(self, recorded: Episodes, replayed: Episodes) -> None:
        """Add differences for the rows of `episodes.csv` that differ from the replay; both have the same cases."""
        names = list(map(self.name, recorded.case.tolist()))
        blocks = [table.block if table.block is not None else np.full(len(names), -1) for table in (recorded, replayed)]
        moved = (f"{names[row]} ({BLOCK})" for row in np.flatnonzero(blocks[0] != blocks[1]).tolist())
        figures: dict[int, str] = {}
        for metric in (name for name in replayed.columns if name in recorded.columns):
            columns = recorded.columns[metric], replayed.columns[metric]
            for row in np.flatnonzero(~self.agree(*columns)).tolist():
                figures.setdefault(row, f"{names[row]} ({metric} {columns[0][row]}, replayed: {columns[1][row]})")
        ends = zip(names, _ends(recorded), _ends(replayed), strict=True)
        self.note_pairs("cases end otherwise than episodes.csv says", ends, len(names))
        self.note("cases are of another block of time in episodes.csv", moved, len(names))
        self.note("cases have other figures in episodes.csv", (figures[row] for row in sorted(figures)), len(names))

    def agree(self, a: Shaped[np.ndarray, "*shape"], b: Shaped[np.ndarray, "*shape"]) -> Bool[np.ndarray, "*shape"]:
        """Return an array that is True for each element in which two arrays agree. NaN agrees with NaN."""
        if self.exact or a.dtype.kind != "f" or b.dtype.kind != "f":
            return np.asarray((a == b) | ((a != a) & (b != b)))
        return np.asarray(np.isclose(a, b, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True))

    def _is_same(self, a: object, b: object) -> bool:
        if isinstance(a, float) and isinstance(b, float):
            return bool(self.agree(np.array(a), np.array(b)))
        return type(a) is type(b) and a == b


def _ends(table: Episodes) -> list[str]:
    ends = zip(table.outcome.tolist(), table.steps.tolist(), strict=True)
    return [f"{Outcome(outcome).label} after {steps} steps" for outcome, steps in ends]
