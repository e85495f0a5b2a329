"""Claims about two rows of a table, with margins fixed before the runs, and the verdicts of the measurements."""

from __future__ import annotations

import dataclasses
import enum
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench import Episodes
from crowdbench.metrics import UNDEFINED, Estimate, MetricInfo, Values, mean_of_means, network_estimate
from crowdbench.results import LEAST_SHARED
from crowdbench.utils import Location, Name, TomlTable, choice, markdown, number
from studies.differences import case_means, difference_over_networks, gain_in_success
from studies.networks import PLANNER_MEASURES
from studies.pages import SUCCESS, SUCCESS_RATE, values_of

POINTS = dataclasses.replace(SUCCESS, unit="points")
REDUCTION = MetricInfo("reduction", share=True)

ROUNDING = 1e-9
"""An interval must be separated from a margin by more than this, so that rounding does not decide a verdict."""

NOTES = (
    "A claim states that a figure exceeds a margin. All margins were fixed before the runs. Figures are positive if "
    "the first planner is better. A claim holds if the 95 % interval of its figure lies above the margin, is refuted "
    "if the interval lies below it, and is undecided otherwise. With a single network there is no verdict. Figures "
    "are paired by case, and by network if both rows have the same networks; networks of different trainings are "
    "treated as independent. Differences in success are over all cases, and one discordant case (solved by only one "
    "of the two planners) is added to each side before the interval is computed, as in Bonett and Price (2012, "
    "doi:10.3102/1076998611411915). All other figures are over the cases that all networks of both rows solve; with "
    f"fewer than {LEAST_SHARED} such cases a claim is undecided. Intervals are not corrected for the number of claims."
)


OURS = "not in the paper"
"""The source of a claim that the paper does not make."""


class ClaimSpec(TomlTable):
    """`[[tables.claims]]`: that a row is better than another one by more than `bound`.

    The bound is in the measure's own unit for a difference, and a share of the other row's mean for a reduction.
    """

    text: Name
    source: Name
    row: Name
    than: Name
    measure: str = choice(PLANNER_MEASURES)
    kind: str = choice(("difference", "reduction"))
    bound: float = number(above=-1000.0, below=1000.0)


class Verdict(enum.StrEnum):
    """Verdict of the measurements on a claim."""

    HOLDS = "holds"
    REFUTED = "refuted"
    UNDECIDED = "undecided"
    ONE_NETWORK = "one network"


@dataclass(frozen=True)
class Assessment:
    """A claim, its figure over `cases` cases and `networks` networks of each row, and the verdict.

    The other fields come from `ClaimSpec`.
    """

    text: str
    source: str
    row: str
    than: str
    measure: str
    kind: str
    bound: float
    networks: tuple[int, int]
    cases: int
    figure: Estimate
    verdict: Verdict

    def cells(self) -> list[str]:
        """Return its row in `claims_table`."""
        measure = PLANNER_MEASURES[self.measure]
        title, unit = measure.title, POINTS if measure is SUCCESS else measure
        if self.kind == "reduction":
            title, unit = f"reduction of {title}", REDUCTION
        return [
            f"{self.text} ({self.source})",
            f"{self.row} against {self.than}: {title}",
            f"> {unit.amount(self.bound)}",
            unit.estimate(self.figure, with_unit=True),
            " and ".join(str(number) for number in dict.fromkeys(self.networks)),
            str(self.cases),
            f"**{self.verdict}**",
        ]


def check_claim(claim: ClaimSpec, networks: Mapping[str, Sequence[str]], location: Location) -> None:
    """Check the rows and the measure of a claim.

    Args:
        claim: The claim.
        networks: The networks of each row, by its label.
        location: Its location in the file, for errors.

    Raises:
        InputError: A row does not exist, both rows are the same or share only some of their networks, or a reduction of
            the measure is no gain.
    """
    for key, label in (("row", claim.row), ("than", claim.than)):
        if label not in networks:
            known = ", ".join(f'"{each}"' for each in networks)
            raise location.at(key).wrong(repr(label), f"one of {known}")
    than = location.at("than")
    if claim.than == claim.row:
        raise than.wrong(repr(claim.than), f"another row than {claim.row}")
    ours, theirs = set(networks[claim.row]), set(networks[claim.than])
    if ours & theirs and ours != theirs:
        raise than.wrong(repr(claim.than), f"a row with all networks of {claim.row}, or with none of them")
    measure = PLANNER_MEASURES[claim.measure]
    if claim.kind == "reduction" and measure.sign > 0:
        raise location.at("kind").wrong(repr(claim.kind), f'"difference", since less {measure.title} is no gain')


def assess(claim: ClaimSpec, rows: Mapping[str, Mapping[str, Episodes]]) -> Assessment:
    """Assess a claim by runs.

    Args:
        claim: A claim that `check_claim` has passed.
        rows: The episodes of each row by its label, and within a row by the weights of its networks; of the same cases.
    """
    one, two = rows[claim.row], rows[claim.than]
    measure = PLANNER_MEASURES[claim.measure]
    paired = set(one) == set(two)
    ours, theirs = list(one.values()), [two[name] for name in (one if paired else two)]
    values = values_of(claim.measure, ours), values_of(claim.measure, theirs)
    if measure is SUCCESS:
        cases, figure = values[0].shape[1], gain_in_success(*values, paired)
    else:
        solved = values_of(SUCCESS_RATE, [*ours, *theirs]).astype(bool).all(axis=0)
        cases, (x, y) = int(solved.sum()), (each[:, solved] for each in values)
        if claim.kind == "reduction":
            figure = reduction_over_networks(x, y, paired)
        else:
            figure = difference_over_networks(measure.sign * x, measure.sign * y, paired)
    networks = (len(ours) if any(one) else 0, len(theirs) if any(two) else 0)
    verdict = _verdict(figure, claim.bound, networks, cases)
    return Assessment(**dict(claim), networks=networks, cases=cases, figure=figure, verdict=verdict)


def _verdict(figure: Estimate, bound: float, networks: tuple[int, int], cases: int) -> Verdict:
    """Return the verdict on a figure over `cases` and the numbers of networks of both rows, 0 for a row without any.

    The claim holds if the interval lies above the bound, and is refuted if it lies below.
    """
    if 1 in networks:
        return Verdict.ONE_NETWORK
    if cases >= LEAST_SHARED and figure.low > bound + ROUNDING:
        return Verdict.HOLDS
    if cases >= LEAST_SHARED and figure.high < bound - ROUNDING:
        return Verdict.REFUTED
    return Verdict.UNDECIDED


def claims_table(claims: Sequence[Assessment]) -> str:
    """Return the claims in a Markdown table."""
    header = ["claim", "figure", "claimed", "measured", "networks", "cases", "verdict"]
    return markdown(header, [claim.cells() for claim in claims])


def tally(claims: Sequence[Assessment]) -> str:
    """Return a sentence with the number of the paper's claims by verdict. Claims of `OURS` do not count."""
    count = Counter(claim.verdict for claim in claims if claim.source != OURS)
    words = ("hold", "are refuted", "are undecided", "have no verdict (one network)")
    verdicts = ", ".join(f"{count[verdict]} {word}" for verdict, word in zip(Verdict, words, strict=True))
    return f"Claims of the paper: {verdicts}."


def reduction_over_networks(ours: Values, theirs: Float[np.ndarray, "their_network case"], paired: bool) -> Estimate:
    """Return the share by which one mean over networks is smaller than another.

    Args:
        ours: As in `difference_over_networks`.
        theirs: As in `difference_over_networks`.
        paired: As in `difference_over_networks`.

    Returns:
        The share with its interval, by linearisation (the delta method); NaN if the mean of `theirs` is 0.
    """
    if np.isnan(ours).all() or np.isnan(theirs).all() or (base := mean_of_means(theirs)) == 0.0:
        return UNDEFINED
    ratio = mean_of_means(ours) / base
    parts = [ours / base, -ratio * theirs / base]
    shares = 1.0 - case_means(ours) / np.where(case_means(theirs) == 0.0, np.nan, case_means(theirs))
    return network_estimate(1.0 - ratio, [parts[0] + parts[1]] if paired else parts, shares)
