"""Which cases of a scenario have a certificate: commands by which the vehicle succeeds in them.

The others are left out when cases are drawn: case 37 is then the one with that number among those that have one. The
file `certified/NAME.toml` beside the scenario's own file says which these are; `crowdbench certify` makes it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from jaxtyping import Int
from pydantic import AfterValidator, Field

from crowdbench.rng import SPLITS
from crowdbench.scenario.cases import LAST, Cases
from crowdbench.toml_file import Location, Name, TomlTable, integer, number, parsed, read_toml

if TYPE_CHECKING:
    from crowdbench.scenario.scenario import Scenario

FOLDER = "certified"
"""The folder beside a scenario's file that has the file of the same name with its certified cases."""

LARGEST = 100.0
"""Margins are below this, in metres."""

LEFT_OUT = "left_out"
"""The key of a scenario's table in results that has the numbers of the cases without a certificate, by split."""


def _rising(numbers: list[int]) -> list[int]:
    if any(one >= other for one, other in itertools.pairwise(numbers)):
        raise ValueError
    return numbers


Numbers = Annotated[
    list[Annotated[int, Field(ge=0, lt=LAST)]],
    AfterValidator(_rising),
    Field(description="a list of numbers of cases, each larger than the one before"),
]


class Examined(TomlTable):
    """A split of which the first cases were examined.

    Attributes:
        examined: How many were.
        left_out: Those of them without a certificate.
        narrow: Those with a certificate that comes nearer to people or obstacles than the margin.
    """

    examined: int = integer(least=1, most=LAST)
    left_out: Numbers = Field(default=[])
    narrow: Numbers = Field(default=[])


class Certified(TomlTable):
    """The file with the certified cases of a scenario.

    Attributes:
        scenario: The digest of the scenario.
        margin: The wider of the margins that were tried, in metres.
        train: What was examined of training cases.
        val: Of validation cases.
        test: Of test cases.
    """

    scenario: Name
    margin: float = number(least=0.0, below=LARGEST)
    train: Examined | None = Field(default=None, description="a table [train]")
    val: Examined | None = Field(default=None, description="a table [val]")
    test: Examined | None = Field(default=None, description="a table [test]")

    @classmethod
    def read(cls, path: Path) -> Certified | None:
        """Read the file; None where there is none. Raises InputError where it is not as `text` writes it."""
        return parsed(cls, read_toml(path, "file"), Location(str(path))) if path.is_file() else None

    @property
    def splits(self) -> dict[str, Examined]:
        """What was examined, by split."""
        each = {split: getattr(self, split) for split in SPLITS}
        return {split: found for split, found in each.items() if found is not None}

    def text(self) -> str:
        """The file, in TOML."""
        lines = [f'scenario = "{self.scenario}"', f"margin = {float(self.margin)!r}"]
        for split, found in self.splits.items():
            lines += ["", f"[{split}]", f"examined = {found.examined}"]
            lines += [f"left_out = {found.left_out}", f"narrow = {found.narrow}"]
        return "\n".join(lines) + "\n"


class _Splits(TomlTable):
    """Numbers of cases by split."""

    train: Numbers = Field(default=[])
    val: Numbers = Field(default=[])
    test: Numbers = Field(default=[])


class _LeftOut(TomlTable):
    """The part of a scenario's table that has the cases that are left out."""

    left_out: _Splits = _Splits()


@dataclass(frozen=True)
class Told:
    """What there is to say of the certificates of a scenario.

    Attributes:
        asked: The name or the file of the scenario, as a user gives it.
        file: The file with the certified cases.
        certified: What it says.
        is_stale: Whether it is for the scenario as it was before a change.
    """

    asked: str
    file: str
    certified: Certified
    is_stale: bool

    def sentence(self, scenario: Scenario, cases: Cases) -> str:
        """The share of the cases that have a certificate, or what must be done to know it.

        Args:
            scenario: The scenario.
            cases: The cases of a run.
        """
        split, by = cases.split, f"`crowdbench certify {self.asked}"
        if self.is_stale:
            found = f"{self.file} is for the digest {self.certified.scenario}, but {scenario.name} has "
            return f"{found}{scenario.digest} now: no case is left out; {by}` makes it again"
        examined = self.certified.splits.get(split)
        last = int(numbers(scenario.left_out.get(split, ()), np.array([cases.stop - 1]))[0]) + 1
        number = 0 if examined is None else examined.examined
        if examined is None or last > number:
            which = f"from {split}:{number} on " if number else f"of {split} "
            return f"the cases {which}of {scenario.name} have no certificates: {by} --cases {split}:{last}` makes them"
        without = len(examined.left_out)
        share = f"{number - without} of {number} examined {split} cases ({1 - without / number:.1%})"
        return f"{share} of {scenario.name} have a certificate" + (": the others are left out" if without else "")


def numbers(left_out: Iterable[int], cases: Int[np.ndarray, "case"]) -> Int[np.ndarray, "case"]:
    """The numbers by which cases are drawn.

    Args:
        left_out: The numbers that are left out, rising.
        cases: Which of the others, counted from 0.
    """
    skipped = np.array([*left_out], np.int64)
    before = skipped - np.arange(len(skipped))
    return cases + np.searchsorted(before, cases, side="right")


def certified(scenario: Scenario, asked: str, file: Path) -> Scenario:
    """A scenario without the cases that have no certificate.

    Args:
        scenario: With all cases.
        asked: Its name or its file, as a user gives it.
        file: The file with the certified cases.

    Returns:
        The scenario as it is where there is no such file, or it is for another digest.

    Raises:
        InputError: The file is not as `crowdbench certify` writes it.
    """
    found = Certified.read(file)
    if found is None:
        return scenario
    told = Told(asked, str(file), found, found.scenario != scenario.digest)
    chosen = {} if told.is_stale else {split: each.left_out for split, each in found.splits.items()}
    return dataclasses.replace(without(scenario, chosen), certificates=told)


def without(scenario: Scenario, left_out: Mapping[str, list[int]]) -> Scenario:
    """A scenario without some of its cases, which has another digest.

    Args:
        scenario: With all cases.
        left_out: The numbers of these cases by split, rising.
    """
    those = {split: list(cases) for split, cases in left_out.items() if cases}
    if not those:
        return scenario
    return dataclasses.replace(scenario, left_out=those, table={**scenario.table, LEFT_OUT: those})


def without_recorded(scenario: Scenario, table: Mapping[str, Any], source: str) -> Scenario:
    """The scenario of a run, without the cases that the run has left out.

    Args:
        scenario: With all cases.
        table: The table `scenario` of the run's `result.json`.
        source: What that file is called, for errors.

    Raises:
        InputError: What is left out are no rising numbers of cases by split.
    """
    chosen = {key: value for key, value in table.items() if key == LEFT_OUT}
    return without(scenario, parsed(_LeftOut, chosen, Location(source)).left_out.complete())
