"""The table of ranks in a track of sensing: two blocks, and what the order depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from crowdbench.metrics import Pair, Rank, compare_all, info_of, ranks
from crowdbench.utils import Grid
from studies.suite.standing import Standing

SCORE = info_of("score")

VARIANTS = {
    "a second close counts 0.5 s": (0.5, False),
    "a second close counts 2 s": (2.0, False),
    "seconds count as close only while the vehicle moves": (1.0, True),
}
"""Other prices of closeness, under which the order is printed: arguments of `Standing.priced`."""


@dataclass(frozen=True)
class Block:
    """Planners that are ranked together.

    Attributes:
        names: Their names, the largest mean score first.
        pairs: Their comparisons.
        among_others: Their comparisons in a crowd of another kind; none without one.
    """

    names: list[str]
    pairs: list[Pair]
    among_others: list[Pair]

    @classmethod
    def of(cls, standings: Mapping[str, Standing], others: Mapping[str, Standing]) -> Block:
        """Compare planners.

        Args:
            standings: The planners.
            others: The same planners in a crowd of another kind; empty without one.
        """
        return cls(order(standings), compare(standings), compare({name: others[name] for name in standings if others}))

    @property
    def claimed(self) -> list[Pair]:
        """The pairs that both crowds decide alike."""
        alike = {(pair.higher, pair.lower) for pair in self.among_others if pair.is_sure}
        return [pair for pair in self.pairs if pair.is_sure and (pair.higher, pair.lower) in alike]

    def ranks(self) -> list[dict[str, Rank]]:
        """Return the ranks in the suite, in the other crowd, and by the pairs that both decide alike."""
        return [ranks(self.names, pairs) for pairs in (self.pairs, self.among_others, self.claimed)]


def order(standings: Mapping[str, Standing]) -> list[str]:
    """Return the names of planners, the largest mean score first."""
    return sorted(standings, key=lambda name: -standings[name].score.mean())


def compare(standings: Mapping[str, Standing]) -> list[Pair]:
    """Compare the mean scores of all planners; no pairs without planners."""
    scores = {name: standing.score for name, standing in standings.items()}
    return compare_all(scores, next(iter(standings.values())).weights) if scores else []


def blocks(standings: Mapping[str, Standing], others: Mapping[str, Standing]) -> list[Block]:
    """Return the planners that pass the gate on collisions at fault, and all others; arguments as for `Block.of`."""
    passing = {name: each for name, each in standings.items() if each.is_competent}
    failing = {name: each for name, each in standings.items() if name not in passing}
    return [Block.of(each, others) for each in (passing, failing)]


def rank_grid(title: str, standings: Mapping[str, Standing], others: Mapping[str, Standing], crowd: str) -> Grid:
    """Return the table of ranks.

    Args:
        title: Its title.
        standings: The planners.
        others: The same planners in a crowd of another kind; empty without one.
        crowd: The name of that crowd.
    """
    header = ["block", "planner", "rank", "score", "success, %", "at fault, %"]
    header += [f"rank among {crowd}", f"score among {crowd}", "rank that both decide"] if others else []
    rows = []
    for letter, block in zip("AB", blocks(standings, others), strict=True):
        own, among, claimed = block.ranks()
        for name in block.names:
            each = standings[name]
            cells = [str(own[name]), SCORE.estimate(each.mean()), f"{100.0 * each.success.mean():.0f}"]
            cells.append(f"{100.0 * each.at_fault.mean():.1f} (up to {100.0 * each.fault_bound:.1f})")
            if others:
                cells += [str(among[name]), SCORE.number(others[name].mean().mean), str(claimed[name])]
            rows.append([letter, name, *cells])
    return Grid(title, header, rows)


def order_texts(standings: Mapping[str, Standing]) -> list[str]:
    """Return the order of planners under other prices of closeness, one sentence each."""
    usual = order(standings)
    texts = []
    for description, price in VARIANTS.items():
        means = {name: standing.priced(*price).mean() for name, standing in standings.items()}
        found = sorted(means, key=lambda name: -means[name])
        named = ", ".join(f"{name} {SCORE.number(means[name])}" for name in found)
        moved = sum(a != b for a, b in zip(usual, found, strict=True))
        texts.append(f"If {description}, {moved} of {len(found)} planners have another place: {named}.")
    return texts
