"""What differs between the files of a run and its replay, one `Difference` for each kind."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Int, Shaped

from crowdbench.evaluate.results import BLOCK, Episodes
from crowdbench.scenario.cases import Cases
from crowdbench.types import Outcome, Trace

TOLERANCE = 1e-9
"""By how much figures may differ, absolutely or relatively, where versions or machines do."""

_NOT_COMPARED = ("split", "case", "rules", "logs")
"""Parts of a trace that are no states, or that a replay does not have."""

_WITHOUT_TIME = ("outcome", "steps", "preferred_speed", "block")
"""Parts of a trace that have no axis for the time."""

_SHOWN = 3
"""How many cases or values a sentence names."""


@dataclass(frozen=True)
class Difference:
    """One kind of difference.

    Attributes:
        count: In how many cases or values it was found.
        of: Of how many.
        what: What these are, and what is wrong with them.
        first: The first ones, as texts.
    """

    count: int
    of: int
    what: str
    first: Sequence[str]

    def __str__(self) -> str:
        more = ", ..." if self.count > len(self.first) else ""
        return f"{self.count} of {self.of} {self.what}: {', '.join(self.first)}{more}"


def listed(what: str, found: Iterable[str], of: int) -> list[Difference]:
    """A difference, or none where nothing was found.

    Args:
        what: What was found.
        found: A text for each.
        of: Of how many.
    """
    texts = list(found)
    return [Difference(len(texts), of, what, texts[:_SHOWN])] if texts else []


def rows(file: str, cases: Cases, found: Int[np.ndarray, "row"]) -> list[Difference]:
    """Whether a file has one row of each case.

    Args:
        file: The file.
        cases: The cases of the run.
        found: The case of each row.

    Returns:
        The differences.
    """
    known = {case for case in found.tolist() if cases.start <= case < cases.stop}
    lacking = (f"{cases.split}:{case}" for case in range(cases.start, cases.stop) if case not in known)
    first = list(itertools.islice(lacking, _SHOWN))  # no more: a forged number of cases may be of any size
    missing = Difference(len(cases) - len(known), len(cases), f"cases have no row in {file}", first)
    return ([missing] if missing.count else []) + surplus(file, cases, found)


def surplus(file: str, cases: Cases, found: Int[np.ndarray, "row"]) -> list[Difference]:
    """Whether a file has nothing but one row of some of the cases.

    Args:
        file: The file.
        cases: The cases of the run.
        found: The case of each row.

    Returns:
        The difference, if there is one.
    """
    each = Counter(found.tolist())
    known = Counter(case for case in each if cases.start <= case < cases.stop)
    beyond = [f"{cases.split}:{case}" for case in (each - known).elements()]
    return listed(f"rows of {file} are there twice, or of other cases than {cases}", beyond, len(found))


def values(file: str, recorded: Mapping[str, Any], replayed: Mapping[str, Any], exact: bool) -> list[Difference]:
    """Compare values by name, perhaps in tables within tables.

    Args:
        file: The file that holds the recorded ones.
        recorded: What it says.
        replayed: What it should say.
        exact: Whether numbers must agree to the last bit, or else to `TOLERANCE`.

    Returns:
        The differences.
    """
    one, two = dict(_flat(recorded)), dict(_flat(replayed))
    names = list({**two, **one})
    found = [
        f"{name} ({one.get(name)}, replayed: {two.get(name)})"
        for name in names
        if not _is_same_value(one.get(name), two.get(name), exact)
    ]
    return listed(f"values in {file} differ", found, len(names))


def episodes(split: str, recorded: Episodes, replayed: Episodes, exact: bool) -> list[Difference]:
    """Compare the rows of the same cases.

    Args:
        split: The split of the cases.
        recorded: The rows of `episodes.csv`.
        replayed: What they should be.
        exact: Whether figures must agree to the last bit, or else to `TOLERANCE`.

    Returns:
        The differences.
    """
    names = [f"{split}:{case}" for case in recorded.case.tolist()]
    ends = [
        f"{name} ({one}, replayed: {two})"
        for name, one, two in zip(names, _ends(recorded), _ends(replayed), strict=True)
        if one != two
    ]
    moved = [
        f"{name} ({BLOCK})" for name, same in zip(names, _same_blocks(recorded, replayed), strict=True) if not same
    ]
    figures: dict[int, str] = {}
    for metric in (name for name in replayed.columns if name in recorded.columns):
        one, two = recorded.columns[metric], replayed.columns[metric]
        for row in np.flatnonzero(~_same(one, two, exact)).tolist():
            figures.setdefault(row, f"{names[row]} ({metric} {one[row]}, replayed: {two[row]})")
    return [
        *listed("cases end otherwise than episodes.csv says", ends, len(recorded)),
        *listed("cases are of another block of time in episodes.csv", moved, len(recorded)),
        *listed("cases have other figures in episodes.csv", (figures[row] for row in sorted(figures)), len(recorded)),
    ]


def states(
    recorded: Trace,
    replayed: Trace,
    rows: tuple[Int[np.ndarray, "episode"], Int[np.ndarray, "episode"]],
    exact: bool,
) -> list[str]:
    """Compare the states of the same episodes in two traces of one scenario.

    Args:
        recorded: The trace of `run.rrd`.
        replayed: What it should be.
        rows: The rows of the episodes in the one and in the other.
        exact: Whether figures must agree to the last bit, or else to `TOLERANCE`.

    Returns:
        A text for each episode that differs, which names the first array that does, and the step.
    """
    found: dict[int, str] = {}
    if len(rows[0]) == 0:
        return []
    for name in (field.name for field in dataclasses.fields(Trace) if field.name not in _NOT_COMPARED):
        # Recordings of before have no groups.
        if getattr(replayed, name) is None or getattr(recorded, name) is None:
            continue
        one, two = getattr(recorded, name)[rows[0]], getattr(replayed, name)[rows[1]]
        differs = ~_same(one, two, exact)
        for row in np.flatnonzero(differs.reshape(len(one), -1).any(axis=1)).tolist():
            when = "" if name in _WITHOUT_TIME else f" at step {np.argwhere(differs[row])[0, 0]}"
            found.setdefault(row, f"{recorded.split}:{recorded.case[rows[0][row]]} ({name}{when})")
    return [found[row] for row in sorted(found)]


def _same_blocks(recorded: Episodes, replayed: Episodes) -> list[bool]:
    """Whether each case is of the same block of recorded time, if of any."""
    if recorded.block is None or replayed.block is None:
        return [recorded.block is replayed.block] * len(recorded)
    return (recorded.block == replayed.block).tolist()


def _ends(table: Episodes) -> list[str]:
    return [
        f"{Outcome(outcome).label} after {steps} steps"
        for outcome, steps in zip(table.outcome.tolist(), table.steps.tolist(), strict=True)
    ]


def _same(
    one: Shaped[np.ndarray, "*shape"], two: Shaped[np.ndarray, "*shape"], exact: bool
) -> Bool[np.ndarray, "*shape"]:
    """Where two arrays agree. NaN agrees with NaN."""
    if exact or one.dtype.kind != "f" or two.dtype.kind != "f":
        return np.asarray((one == two) | ((one != one) & (two != two)))
    return np.asarray(np.isclose(one, two, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True))


def _is_same_value(one: object, two: object, exact: bool) -> bool:
    if isinstance(one, float) and isinstance(two, float):
        return bool(_same(np.array(one), np.array(two), exact))
    return type(one) is type(two) and one == two


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The values of a table by their dotted keys."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
