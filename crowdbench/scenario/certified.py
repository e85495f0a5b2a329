"""Which cases of a scenario have a certificate: commands by which the vehicle succeeds in them.

The others are left out when cases are drawn: case 37 is then the one with that number among those that have one. The
file `certified/NAME.toml` beside the scenario's own file says which these are; `crowdbench certify` makes it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Int
from pydantic import AfterValidator, Field

from crowdbench.core.rng import SPLITS
from crowdbench.scenario.cases import LAST, Cases
from crowdbench.utils.toml import Location, Name, TomlTable, integer, number, parse_table, read_toml

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
        return parse_table(cls, read_toml(path, "file"), Location(str(path))) if path.is_file() else None

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


class CasesBySplit(TomlTable):
    """Numbers of cases by split."""

    train: Numbers = Field(default=[])
    val: Numbers = Field(default=[])
    test: Numbers = Field(default=[])


@dataclass(frozen=True)
class CertificateStatus:
    """What there is to say of the certificates of a scenario.

    Attributes:
        spec: The name or the file of the scenario, as a user gives it.
        name: The scenario's name.
        digest: Its digest with all cases.
        file: The file with the certified cases.
        certified: What it says.
    """

    spec: str
    name: str
    digest: str
    file: Path
    certified: Certified

    @property
    def left_out(self) -> dict[str, list[int]]:
        """By split, the cases without a certificate; none where the file is for the scenario before a change."""
        is_stale = self.certified.scenario != self.digest
        return {} if is_stale else {split: each.left_out for split, each in self.certified.splits.items()}

    def certify(self, cases: Cases) -> Bool[np.ndarray, "case"] | None:
        """Which of some cases, counted among all, have a certificate; None where it is not known of each."""
        examined = self.certified.splits.get(cases.split)
        if self.certified.scenario != self.digest or examined is None or examined.examined < cases.stop:
            return None
        return ~np.isin(cases.indices, examined.left_out)

    def sentence(self, cases: Cases) -> str:
        """The share of the cases that have a certificate, or what must be done to know it for those of a run."""
        split, by = cases.split, f"`crowdbench certify {self.spec}"
        if self.certified.scenario != self.digest:
            found = f"{self.file} is for the digest {self.certified.scenario}, but {self.name} has "
            return f"{found}{self.digest} now: no case is left out; {by}` makes it again"
        examined = self.certified.splits.get(split)
        last = int(skip_left_out(self.left_out.get(split, ()), np.array([cases.stop - 1]))[0]) + 1
        number = 0 if examined is None else examined.examined
        if examined is None or last > number:
            which = f"from {split}:{number} on " if number else f"of {split} "
            return f"the cases {which}of {self.name} have no certificates: {by} --cases {split}:{last}` makes them"
        without = len(examined.left_out)
        share = f"{number - without} of {number} examined {split} cases ({1 - without / number:.1%})"
        left_out = ": the others are left out" if without else ""
        return f"{share} of {self.name} have a certificate that they can be solved{left_out}"


def skip_left_out(left_out: Iterable[int], cases: Int[np.ndarray, "case"]) -> Int[np.ndarray, "case"]:
    """The numbers by which cases are drawn.

    Args:
        left_out: The numbers that are left out, rising.
        cases: Which of the others, counted from 0.
    """
    skipped = np.array([*left_out], np.int64)
    before = skipped - np.arange(len(skipped))
    return cases + np.searchsorted(before, cases, side="right")
