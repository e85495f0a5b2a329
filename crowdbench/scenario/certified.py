"""Certificates of the cases of a scenario: commands with which the vehicle succeeds in a case.

The file `certified/NAME.toml` beside the scenario's file lists the cases without one. The study of
certificates writes it.
"""

from __future__ import annotations

import itertools
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from crowdbench.scenario.cases import LAST, Cases
from crowdbench.utils.toml import Location, Name, TomlTable, integer, number, parse_table, read_toml

CERTIFICATES = "certified"
"""Folder beside a scenario's file. It contains the file with the certified cases, which has the same name."""

MAX_MARGIN = 100.0
"""Upper bound of margins in metres."""


def _rising(numbers: list[int]) -> list[int]:
    if any(number >= following for number, following in itertools.pairwise(numbers)):
        raise ValueError
    return numbers


Numbers = Annotated[
    list[Annotated[int, Field(ge=0, lt=LAST)]],
    AfterValidator(_rising),
    Field(description="a list of numbers of cases, each larger than the one before"),
]


class Examined(TomlTable):
    """Certificates of the first cases of a split.

    Attributes:
        examined: Number of examined cases.
        uncertified: Examined cases without a certificate.
        narrow: Cases with a certificate that comes nearer to pedestrians or obstacles than the margin.
    """

    examined: int = integer(least=1, most=LAST)
    uncertified: Numbers = Field(default=[])
    narrow: Numbers = Field(default=[])


class Certified(TomlTable):
    """The file with the certified cases of a scenario.

    Attributes:
        scenario: The digest of the scenario.
        margin: The wider of the margins that were tried, in metres.
        train: Examined training cases.
        val: Examined validation cases.
        test: Examined test cases.
    """

    scenario: Name
    margin: float = number(least=0.0, below=MAX_MARGIN)
    train: Examined | None = Field(default=None, description="a table [train]")
    val: Examined | None = Field(default=None, description="a table [val]")
    test: Examined | None = Field(default=None, description="a table [test]")

    @classmethod
    def read(cls, path: Path) -> Certified | None:
        """Read the file; return None if it does not exist. Raises InputError if it is broken."""
        return parse_table(cls, read_toml(path, "file"), Location(str(path))) if path.is_file() else None


@dataclass(frozen=True)
class CertificateStatus:
    """Certificates of a scenario.

    Attributes:
        spec: The name or the file of the scenario, as entered by the user.
        name: The scenario's name.
        digest: Its digest.
        file: The file with the certified cases.
        certified: Content of the file.
    """

    spec: str
    name: str
    digest: str
    file: Path
    certified: Certified

    def sentence(self, cases: Cases) -> str:
        """Return the number of cases of a run without a certificate, or the command that determines it; an empty text
        if all have one."""
        split, by = cases.split, f"`python studies/certificates/run.py {shlex.quote(self.spec)}"
        if self.certified.scenario != self.digest:
            difference = f"for the digest {self.certified.scenario}, but {self.name} has {self.digest} now"
            return f"{self.file} is {difference}: {by}` makes it again"
        examined: Examined | None = getattr(self.certified, split)
        number = examined.examined if examined else 0
        if examined is None or cases.stop > number:
            which = f"from {split}:{number} on" if number else f"of {split}"
            command = f"{by} --cases {split}:{cases.stop}`"
            return f"the cases {which} of {self.name} have no certificates: {command} makes them"
        lacking = sum(cases.start <= case < cases.stop for case in examined.uncertified)
        if not lacking:
            return ""
        verb = "has" if lacking == 1 else "have"
        return f"{lacking} of the cases {cases} of {self.name} {verb} no certificate that they can be solved"
