"""Whether boards rank planners alike: Kendall's tau."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from crowdbench.boards.site.rows import is_measured
from crowdbench.boards.standings import Standing, Standings

SAME_BUT_PEDESTRIANS = ("five", "visible", "gaussian", "social_force", "square")
"""The boards with five pedestrians each, who move by another model, other parameters, or between other places."""

SUITE = "suite"
"""The only family of the boards of the suite."""

FEWEST = 4
"""With fewer entries in common, a correlation of ranks says nothing."""


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau of two boards.

    Attributes:
        tau: From -1, the reverse order, to 1, the same order; NaN where it is not defined.
        p: The p-value of the hypothesis that the two orders have nothing to do with each other.
        n: How many entries the boards have in common.
    """

    tau: float
    p: float
    n: int

    @property
    def is_known(self) -> bool:
        """Whether there are enough entries, which do not all succeed equally often."""
        return math.isfinite(self.tau)


@dataclass(frozen=True)
class Group:
    """Boards that are compared with each other.

    Attributes:
        question: What the comparison asks.
        boards: The boards.
        taus: Kendall's tau by the names of two boards, in both orders.
    """

    question: str
    boards: Sequence[Standings]
    taus: Mapping[tuple[str, str], Agreement]

    @property
    def known(self) -> Sequence[float]:
        """The taus of all pairs of boards for which there is one."""
        return [one.tau for (a, b), one in self.taus.items() if a < b and one.is_known]

    @property
    def mean(self) -> float:
        """Their mean; NaN where there is none."""
        return sum(self.known) / len(self.known) if self.known else math.nan


def groups(each: Sequence[Standings]) -> list[Group]:
    """The boards that differ only in the pedestrians, and those of the suite, with the agreement of each two.

    Args:
        each: The standings of all boards.

    Returns:
        Both groups.
    """
    same = [found for found in each if found.board.name in SAME_BUT_PEDESTRIANS]
    same.sort(key=lambda found: SAME_BUT_PEDESTRIANS.index(found.board.name))
    suite = [found for found in each if list(found.board.spec.families) == [SUITE]]
    return [
        _group("Do rankings agree across pedestrian models?", same),
        _group("Do rankings agree across the suite?", suite),
    ]


def _group(question: str, boards: Sequence[Standings]) -> Group:
    pairs = {
        (a.board.name, b.board.name): _agreement(a, b) for a in boards for b in boards if a.board.name != b.board.name
    }
    return Group(question, boards, pairs)


def _agreement(a: Standings, b: Standings) -> Agreement:
    from scipy.stats import kendalltau

    success = [{_who(one): one.figures["success_rate"].mean for one in _comparable(found)} for found in (a, b)]
    common = sorted(success[0].keys() & success[1].keys())
    if len(common) < FEWEST:
        return Agreement(math.nan, math.nan, len(common))
    found = kendalltau([success[0][name] for name in common], [success[1][name] for name in common])
    return Agreement(float(found.statistic), float(found.pvalue), len(common))


def _who(one: Standing) -> tuple[str, str]:
    """What says that entries of two boards are the same planner."""
    return one.entry.spec.submitted_by, one.entry.name


def _comparable(found: Standings) -> list[Standing]:
    """The measured entries of a board that use only what a vehicle can see, with a rank or with a flag."""
    everybody = (*found.ranked, *found.others)
    fair = [one for one in everybody if not one.entry.spec.privileged and not one.entry.card.ablation]
    return [one for one in fair if is_measured(one)]
