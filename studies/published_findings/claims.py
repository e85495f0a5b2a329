"""Claims: the range of a figure in which a published finding holds, and the verdict of the measurement."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from crowdbench.metrics import Estimate, MetricInfo
from crowdbench.utils import Grid, Name, Text, TomlTable, number
from studies.li2020.claims import Verdict

UNBOUNDED = 1000.0
"""The bound of a range that is open on this side."""

WORDS = {Verdict.HOLDS: "hold", Verdict.REFUTED: "are refuted", Verdict.UNDECIDED: "are undecided"}

OURS = "not in the paper"
"""Shown for a claim without a reported figure."""


class ClaimSpec(TomlTable):
    """A claim: that a figure is in a range, with the figure that was reported."""

    text: Name
    reported: Text = ""
    low: float = number(-UNBOUNDED, least=-UNBOUNDED, below=UNBOUNDED)
    high: float = number(UNBOUNDED, above=-UNBOUNDED, below=UNBOUNDED + 1.0)


@dataclass(frozen=True)
class Assessment:
    """A claim with its figure and the verdict.

    Attributes:
        claim: The claim.
        unit: The unit of the figure.
        figure: The figure.
    """

    claim: ClaimSpec
    unit: MetricInfo
    figure: Estimate

    @property
    def verdict(self) -> Verdict:
        """The verdict: the claim holds if the interval is within the range, and is refuted if it is outside.

        An interval without width comes from too few events, and decides nothing.
        """
        low, high, figure = self.claim.low, self.claim.high, self.figure
        if not figure.low < figure.high:
            return Verdict.UNDECIDED
        if low <= figure.low and figure.high <= high:
            return Verdict.HOLDS
        return Verdict.REFUTED if figure.high < low or figure.low > high else Verdict.UNDECIDED

    @property
    def range(self) -> str:
        """The range in words."""
        low, high = (self.unit.number(bound) for bound in (self.claim.low, self.claim.high))
        if self.claim.high >= UNBOUNDED:
            return f"{low} or more"
        return f"{high} or less" if self.claim.low <= -UNBOUNDED else f"{low} to {high}"

    def cells(self) -> list[str]:
        """Return the row of the claim in `claims_grid`."""
        figure = self.unit.estimate(self.figure, with_unit=True)
        return [self.claim.text, self.claim.reported or OURS, figure, self.range, f"**{self.verdict}**"]


def claims_grid(title: str, claims: Sequence[Assessment]) -> Grid:
    """Return a table of claims."""
    header = ["claim", "reported", "measured", "holds at", "verdict"]
    return Grid(title, header, [claim.cells() for claim in claims], list(claims))


def tally(claims: Sequence[Assessment]) -> str:
    """Return a sentence with the number of reported claims by verdict."""
    count = Counter(each.verdict for each in claims if each.claim.reported)
    return f"Reported: {', '.join(f'{count[verdict]} {word}' for verdict, word in WORDS.items())}."
