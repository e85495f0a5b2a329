"""Findings of other papers: what was reported, our claims with figures and verdicts, and what differs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field

from crowdbench.runs import Run
from crowdbench.utils import Grid, Location, Name, Text, TomlTable, markdown, printed_by
from studies.published_findings.claims import Assessment, claims_grid, tally
from studies.published_findings.pairs import Pair, PairSpec
from studies.published_findings.sweeps import Sweep, SweepSpec
from studies.schema import StudyHead


class FindingSpec(TomlTable):
    """`[[findings]]`: a published finding, the conditions here, and what differs."""

    title: Name
    reported: Name
    differs: list[Text] = Field(description="a list of texts in quotes")
    sweeps: list[SweepSpec] = Field(default=[])
    pairs: list[PairSpec] = Field(default=[])


class FindingsStudy(StudyHead):
    """The file of the study."""

    findings: list[FindingSpec] = Field(min_length=1, description="one table or more")


@dataclass(frozen=True)
class Finding:
    """A finding with its runs."""

    spec: FindingSpec
    sweeps: list[Sweep]
    pairs: list[Pair]

    @classmethod
    def load(cls, spec: FindingSpec, networks: Path, location: Location) -> Finding:
        """Plan the runs of a finding; see `Pair.load`."""
        sweeps = [Sweep.load(each, location.at("sweeps", i)) for i, each in enumerate(spec.sweeps)]
        pairs = [Pair.load(each, networks, location.at("pairs", i)) for i, each in enumerate(spec.pairs)]
        return cls(spec, sweeps, pairs)

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        swept = [run for sweep in self.sweeps for run in sweep.runs]
        return swept + [run for pair in self.pairs for run in pair.runs]

    def fill(self, out: Path) -> FilledFinding:
        """Return the finding with its figures, from the runs in the folder `out`."""
        swept = [each.fill(out) for each in self.sweeps]
        claims = [claim for found, _ in swept for claim in found]
        claims += [claim for each in self.pairs for claim in each.fill(out)]
        return FilledFinding(self.spec, claims, [grid for _, grid in swept])


@dataclass(frozen=True)
class FilledFinding:
    """A finding with its figures."""

    spec: FindingSpec
    claims: list[Assessment]
    details: list[Grid]

    @property
    def grids(self) -> list[Grid]:
        """The tables of the finding."""
        return [claims_grid(self.spec.title, self.claims), *self.details]

    def markdown(self) -> str:
        """Return the section of the finding."""
        claims, *details = self.grids
        parts = [f"## {self.spec.title}", self.spec.reported, markdown(claims.header, claims.rows)]
        for grid in details:
            parts += [f"{grid.title}. {grid.note}", markdown(grid.header, grid.rows)]
        return "\n\n".join([*parts, *self.spec.differs])


def page(spec: FindingsStudy, findings: Sequence[FilledFinding]) -> str:
    """Return the page in Markdown."""
    head = [printed_by("python studies/published_findings/run.py NETWORKS"), spec.description]
    claims = [claim for each in findings for claim in each.claims]
    return "\n\n".join([*head, tally(claims), *(each.markdown() for each in findings), *spec.sources])
