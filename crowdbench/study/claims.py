"""Claims about two rows of a table, with margins fixed beforehand, and what the measurements say of them."""

from __future__ import annotations

import dataclasses
import enum
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.results import Episodes
from crowdbench.evaluate.summary import Estimate
from crowdbench.study.bootstrap import two_level, two_level_reduction
from crowdbench.study.networks import of_all
from crowdbench.study.tables import JERK, LEAST_SHARED, SUCCESS, TIME, VELOCITY_CHANGE, Measure, grid
from crowdbench.toml_section import Section

MEASURES = {each.metric: each for each in (SUCCESS, TIME, VELOCITY_CHANGE, JERK)}

POINTS = dataclasses.replace(SUCCESS, unit="points")
REDUCTION = Measure("reduction", "reduction", "%", sign=1, digits=1, scale=100.0)

ROUNDING = 1e-9
"""An interval must lie clear of a margin by more than this, so that no rounded sum decides."""

NOTES = (
    "A claim is that a figure exceeds a margin that was fixed before the runs; figures are positive where the "
    "first planner is the better one. It holds where the figure's 95 % interval lies above the margin, is refuted "
    "where it lies below, and is undecided otherwise. Figures are paired by case, over the networks that both rows "
    "have, and their intervals a bootstrap over networks and cases. Success is over all cases, and its interval with "
    "one more case that only the first solves and one that only the second solves (Bonett and Price 2012): rows that "
    "fail in the same cases are no certainty. What else is measured is over the cases that both solve, undecided "
    f"where they are fewer than {LEAST_SHARED}. The claims are not corrected for their number."
)


class Verdict(enum.StrEnum):
    """What the measurements say of a claim."""

    HOLDS = "holds"
    REFUTED = "refuted"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Judged:
    """A claim with its figure, over `cases` that count and the networks with these `weights`."""

    text: str
    source: str
    row: str
    than: str
    measure: str
    kind: str
    bound: float
    weights: list[str]
    cases: int
    figure: Estimate
    verdict: Verdict

    @property
    def shown(self) -> Measure:
        """How the figure is written."""
        if self.kind == "reduction":
            return REDUCTION
        return POINTS if self.measure == SUCCESS.metric else MEASURES[self.measure]

    def cells(self) -> list[str]:
        """As `claims_grid` shows it."""
        word = MEASURES[self.measure].word
        figure = f"{self.row} against {self.than}: " + (f"reduction of {word}" if self.kind == "reduction" else word)
        return [
            f"{self.text} ({self.source})",
            figure,
            f"> {self.shown.number(self.bound)}",
            self.shown.estimate(self.figure),
            str(len(self.weights)),
            str(self.cases),
            f"**{self.verdict}**",
        ]


@dataclass(frozen=True)
class Claim:
    """That the row is better than another by more than `bound`, in a measure's unit or as a share of the other's."""

    text: str
    source: str
    row: str
    than: str
    measure: Measure
    kind: str
    bound: float

    @classmethod
    def of(cls, section: Section, networks: Mapping[str, Sequence[str]]) -> Claim:
        """The claim that a file makes about rows with these networks. Raises InputError where it cannot be judged."""
        labels = tuple(networks)
        claim = cls(
            text=section.needed("text"),
            source=section.needed("source"),
            row=section.choice("row", "", labels),
            than=section.choice("than", "", labels),
            measure=MEASURES[section.choice("measure", "", tuple(MEASURES))],
            kind=section.choice("kind", "", ("difference", "reduction")),
            bound=section.number("bound", math.nan, above=-1000.0, below=1000.0),
        )
        section.close()
        if claim.than == claim.row or not set(networks[claim.row]) & set(networks[claim.than]):
            raise section.wrong("than", f"another row, with networks that {claim.row} has too")
        if claim.kind == "reduction" and claim.measure.sign > 0:
            raise section.wrong("kind", f'"difference", since less {claim.measure.word} is no gain')
        return claim

    def judge(self, rows: Mapping[str, Mapping[str, Episodes]]) -> Judged:
        """What runs of the same cases say of it: the episodes of each row, by its networks' weights."""
        one, two = rows[self.row], rows[self.than]
        weights = [name for name in one if name in two]
        ours, theirs = ([row[name] for name in weights] for row in (one, two))
        values = of_all(ours, self.measure), of_all(theirs, self.measure)
        if self.measure is SUCCESS:
            cases, figure = values[0].shape[1], _gain_in_success(*values)
        else:
            both = (of_all(ours, SUCCESS) * of_all(theirs, SUCCESS)).astype(bool)
            x, y = (np.where(both, each, np.nan) for each in values)
            cases = int((~np.isnan(x + y)).any(axis=0).sum())
            figure = two_level_reduction(x, y) if self.kind == "reduction" else two_level(self.measure.sign * (x - y))
        return Judged(
            **{**vars(self), "measure": self.measure.metric},
            weights=weights,
            cases=cases,
            figure=figure,
            verdict=verdict(figure, self.bound) if cases >= LEAST_SHARED else Verdict.UNDECIDED,
        )


def verdict(figure: Estimate, bound: float) -> Verdict:
    """Whether the figure's interval lies above the bound, below it, or neither (as where there is no figure)."""
    if figure.low > bound + ROUNDING:
        return Verdict.HOLDS
    return Verdict.REFUTED if figure.high < bound - ROUNDING else Verdict.UNDECIDED


def claims_grid(claims: Sequence[Judged]) -> str:
    """The claims in a Markdown table."""
    header = ["claim", "figure", "claimed", "measured", "networks", "cases", "verdict"]
    return grid(header, [claim.cells() for claim in claims])


def tally(claims: Sequence[Judged]) -> str:
    """How many claims there are of each verdict, in a sentence."""
    count = Counter(claim.verdict for claim in claims)
    return f"Claims: {', '.join(f'{count[each]} {each}' for each in Verdict)}."


def _gain_in_success(ours: Float[np.ndarray, "seed case"], theirs: Float[np.ndarray, "seed case"]) -> Estimate:
    """The difference, and the interval with two more cases, one won by each.

    Without them rows that succeed and fail alike would have an interval of no width, however few the cases. Bonett
    and Price, "Adjusted Wald confidence interval for a difference of binomial proportions based on paired data", J. of
    Educational and Behavioral Statistics 37 (2012): they add one to both numbers of cases that only one side wins.
    """
    gain = ours - theirs
    won, lost = np.ones((len(gain), 1)), -np.ones((len(gain), 1))
    guarded = two_level(np.hstack([gain, won, lost]))
    return dataclasses.replace(guarded, mean=float(gain.mean()), n=gain.size, max=float(gain.max()))
