"""Pairs: two rows of planners and networks, and claims about the difference or the reduction of a measure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import Field

from crowdbench import Episodes
from crowdbench.metrics import MetricInfo, info_of, mean_of_means
from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Location, Name, Names, TomlTable, Values, choice
from studies.differences import gain_in_success
from studies.folder import read_episodes
from studies.li2020.claims import POINTS, REDUCTION, reduction_over_networks
from studies.pages import SUCCESS, SUCCESS_RATE, values_of
from studies.published_findings.claims import Assessment, ClaimSpec
from studies.schema import CasesText

WITHOUT_CONTACT = "without_contact"
"""A success whose smallest gap is not negative."""

MEASURES = {
    SUCCESS_RATE: SUCCESS,
    WITHOUT_CONTACT: replace(SUCCESS, title="success without contact"),
    "group_intrusion": info_of("group_intrusion"),
}

KINDS: dict[str, MetricInfo] = {"difference": POINTS, "reduction": REDUCTION}


class SideSpec(TomlTable):
    """A planner, with its networks in the folder of networks, in a scenario."""

    planner: Name
    weights: Names = Field(default=[])
    options: Values = Field(default={})
    overrides: Values = Field(default={})

    def load(self, scenario: str, cases: CasesText, networks: Path) -> list[Run]:
        """Load a run with each network; without networks, one run."""
        base = RunSpec(self.planner, scenario, cases, overrides=self.overrides, record="none")
        choices = [{"weights": str(networks / f"{name}.safetensors")} for name in self.weights] or [{}]
        return [load_run(replace(base, options={**self.options, **choice})) for choice in choices]


class PairClaimSpec(ClaimSpec):
    """A claim about two rows: the measure of `row` less that of `than`, or its reduction, as a share."""

    measure: str = choice(MEASURES)
    kind: str = choice(KINDS)


class PairSpec(TomlTable):
    """`[[findings.pairs]]`: two rows in a scenario, and claims about them."""

    scenario: Name
    cases: CasesText
    row: SideSpec
    than: SideSpec
    claims: list[PairClaimSpec] = Field(min_length=1, description="one table or more")


@dataclass(frozen=True)
class Pair:
    """A pair with the runs of both rows."""

    spec: PairSpec
    row: list[Run]
    than: list[Run]

    @classmethod
    def load(cls, spec: PairSpec, networks: Path, location: Location) -> Pair:
        """Plan the runs. Raises InputError if a planner, its weights or the scenario do not exist."""
        with location.named():
            row, than = (side.load(spec.scenario, spec.cases, networks) for side in (spec.row, spec.than))
        return cls(spec, row, than)

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return [*self.row, *self.than]

    def fill(self, out: Path) -> list[Assessment]:
        """Return the claims with their figures, from the runs in the folder `out`."""
        row, than = ([read_episodes(run, out) for run in runs] for runs in (self.row, self.than))
        is_paired = self.spec.row.weights == self.spec.than.weights
        return [assess(claim, row, than, is_paired) for claim in self.spec.claims]


def assess(claim: PairClaimSpec, row: list[Episodes], than: list[Episodes], is_paired: bool) -> Assessment:
    """Assess a claim about two rows.

    Args:
        claim: The claim.
        row: The episodes of each network of one row.
        than: The episodes of each network of the other row.
        is_paired: True if both rows have the same networks.
    """
    ours, theirs = (measure(claim.measure, side) for side in (row, than))
    if claim.kind == "difference":
        figure = gain_in_success(ours, theirs, is_paired)
    else:
        both = ~np.isnan(np.concatenate([ours, theirs])).any(axis=0)
        ours, theirs = ours[:, both], theirs[:, both]
        figure = reduction_over_networks(ours, theirs, is_paired)
    names = (MEASURES[claim.measure].number(mean_of_means(side)) for side in (theirs, ours))
    text = f"{claim.text} ({MEASURES[claim.measure].title} {' to '.join(names)} %)"
    return Assessment(claim.model_copy(update={"text": text}), KINDS[claim.kind], figure)


def measure(name: str, episodes: list[Episodes]) -> Float[np.ndarray, "network case"]:
    """Return the values of one of `MEASURES`; that of groups is NaN in failures."""
    if name != WITHOUT_CONTACT:
        return values_of(name, episodes)
    success, gap = (values_of(each, episodes) for each in (SUCCESS_RATE, "minimum_gap"))
    return success * ~(gap < 0.0)
