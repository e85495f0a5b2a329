"""Claims about two rows of a table, with margins fixed before the runs, and what the measurements say of them."""

from __future__ import annotations

import dataclasses
import enum
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.results import Episodes
from crowdbench.evaluate.summary import Estimate
from crowdbench.study.intervals import mean_over_networks, reduction_over_networks
from crowdbench.study.measures import LEAST_SHARED, PLANNER_MEASURES, SUCCESS, Measure
from crowdbench.study.schema import ClaimSpec
from crowdbench.study.tables import grid
from crowdbench.toml_file import Location

POINTS = dataclasses.replace(SUCCESS, unit="points")
REDUCTION = Measure("reduction", "reduction", "%", sign=1, digits=1, scale=100.0)

ROUNDING = 1e-9
"""An interval must lie clear of a margin by more than this, so that no rounded sum decides."""

NOTES = (
    "A claim says that a figure is larger than a margin, and all margins were fixed before the runs. Figures are "
    "positive where the first planner is the better one. A claim holds where the 95 % interval of its figure lies "
    "above the margin, is refuted where the interval lies below it, and is undecided otherwise. A single network says "
    "nothing of others: there is no verdict. Figures are paired by case, over the networks that both rows have. "
    "Differences in success are over all cases, and one discordant case (a case that only one of the two planners "
    "solves) is added to each side before the interval is taken, as in the paired interval of Bonett and Price (2012, "
    "doi:10.3102/1076998611411915). All other figures are over the cases that both planners solve; with fewer than "
    f"{LEAST_SHARED} such cases a claim is undecided. The intervals are not corrected for the number of claims."
)


class Verdict(enum.StrEnum):
    """What the measurements say of a claim."""

    HOLDS = "holds"
    REFUTED = "refuted"
    UNDECIDED = "undecided"
    ONE_NETWORK = "one network"


@dataclass(frozen=True)
class Assessment:
    """A claim, its figure over `cases` cases and the networks with these `weights`, and the verdict.

    The other fields are those of `ClaimSpec`.
    """

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

    def cells(self) -> list[str]:
        """As `claims_grid` shows it."""
        word = PLANNER_MEASURES[self.measure].word
        figure = f"{self.row} against {self.than}: " + (f"reduction of {word}" if self.kind == "reduction" else word)
        return [
            f"{self.text} ({self.source})",
            figure,
            f"> {self._shown.number(self.bound)}",
            self._shown.estimate(self.figure),
            str(len(self.weights)),
            str(self.cases),
            f"**{self.verdict}**",
        ]

    @property
    def _shown(self) -> Measure:
        """How the figure is written."""
        if self.kind == "reduction":
            return REDUCTION
        return POINTS if self.measure == SUCCESS.metric else PLANNER_MEASURES[self.measure]


def check_claim(claim: ClaimSpec, networks: Mapping[str, Sequence[str]], location: Location) -> None:
    """Check what a claim says of its table.

    Args:
        claim: The claim.
        networks: The networks of each row, by its label.
        location: Where the claim is.

    Raises:
        InputError: A row does not exist, the two have no network in common, or less of the measure is no gain.
    """
    for key, label in (("row", claim.row), ("than", claim.than)):
        if label not in networks:
            known = ", ".join(f'"{each}"' for each in networks)
            raise location.at(key).wrong(repr(label), f"one of {known}")
    if claim.than == claim.row or not set(networks[claim.row]) & set(networks[claim.than]):
        raise location.at("than").wrong(repr(claim.than), f"another row, with networks that {claim.row} has too")
    measure = PLANNER_MEASURES[claim.measure]
    if claim.kind == "reduction" and measure.sign > 0:
        raise location.at("kind").wrong(repr(claim.kind), f'"difference", since less {measure.word} is no gain')


def assess(claim: ClaimSpec, rows: Mapping[str, Mapping[str, Episodes]]) -> Assessment:
    """What runs say of a claim.

    Args:
        claim: A claim that `check_claim` has passed.
        rows: The episodes of each row by its label, and within a row by the weights of its networks; of the same cases.
    """
    one, two = rows[claim.row], rows[claim.than]
    measure = PLANNER_MEASURES[claim.measure]
    weights = [name for name in one if name in two]
    ours, theirs = ([row[name] for name in weights] for row in (one, two))
    values = measure.of(ours), measure.of(theirs)
    if measure is SUCCESS:
        cases, figure = values[0].shape[1], _gain_in_success(*values)
    else:
        both = (SUCCESS.of(ours) * SUCCESS.of(theirs)).astype(bool)
        x, y = (np.where(both, each, np.nan) for each in values)
        cases = int((~np.isnan(x + y)).any(axis=0).sum())
        if claim.kind == "reduction":
            figure = reduction_over_networks(x, y)
        else:
            figure = mean_over_networks(measure.sign * (x - y))
    return Assessment(
        **dict(claim),
        weights=weights,
        cases=cases,
        figure=figure,
        verdict=_verdict(figure, claim.bound, weights, cases),
    )


def _verdict(figure: Estimate, bound: float, weights: Sequence[str], cases: int) -> Verdict:
    """The verdict on a figure that is over networks with these `weights` and so many `cases`."""
    if len(weights) == 1 and weights[0]:
        return Verdict.ONE_NETWORK
    return verdict(figure, bound) if cases >= LEAST_SHARED else Verdict.UNDECIDED


def verdict(figure: Estimate, bound: float) -> Verdict:
    """The verdict on a claim.

    Args:
        figure: What was measured, with its interval; NaN where nothing was.
        bound: What the claim says that the figure exceeds.

    Returns:
        Holds where the interval lies above the bound, refuted where it lies below, undecided otherwise.
    """
    if figure.low > bound + ROUNDING:
        return Verdict.HOLDS
    return Verdict.REFUTED if figure.high < bound - ROUNDING else Verdict.UNDECIDED


def claims_grid(claims: Sequence[Assessment]) -> str:
    """The claims in a Markdown table."""
    header = ["claim", "figure", "claimed", "measured", "networks", "cases", "verdict"]
    return grid(header, [claim.cells() for claim in claims])


def tally(claims: Sequence[Assessment]) -> str:
    """How many claims there are of each verdict, in a sentence."""
    count = Counter(claim.verdict for claim in claims)
    return f"Claims: {', '.join(f'{count[each]} {each}' for each in Verdict)}."


def _gain_in_success(ours: Float[np.ndarray, "network case"], theirs: Float[np.ndarray, "network case"]) -> Estimate:
    """The difference in success, with an interval that has a width even where both succeed in the same cases.

    One discordant case is added to each side, one that only `ours` solves and one that only `theirs` solve, as in
    Bonett and Price, "Adjusted Wald confidence interval for a difference of binomial proportions based on paired data",
    Journal of Educational and Behavioral Statistics 37(4) (2012), 479-488, doi:10.3102/1076998611411915. Theirs is an
    adjusted Wald interval of one pair of samples; here the cases so completed are those of every network.
    """
    gain = ours - theirs
    won, lost = np.ones((len(gain), 1)), -np.ones((len(gain), 1))
    guarded = mean_over_networks(np.hstack([gain, won, lost]))
    return dataclasses.replace(guarded, mean=float(gain.mean()), n=gain.size, max=float(gain.max()))
