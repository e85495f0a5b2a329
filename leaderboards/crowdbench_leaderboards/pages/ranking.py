"""The ranks of a board: two blocks by the gate on collisions at fault, and in each block ranks by the score.

An account counts with its best entry for the ranks of others, so that a worse copy changes nothing for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.metrics import Pair, Rank, compare_all, is_competent, ranks

BLOCKS = {"A": "seldom at fault", "B": "often at fault"}
"""The blocks: entries that pass the gate on collisions at fault, and all others."""


@dataclass(frozen=True)
class Candidate:
    """An entry that can have a rank.

    Attributes:
        name: Its name.
        owner: The account that counts with its best entry; for planners that the maintainers enter, the entry itself.
        score: The score of each case; 0 in scenarios that the planner cannot drive.
        at_fault: 1 for each collision at fault, 0 elsewhere, in the scenarios that the planner drives.
    """

    name: str
    owner: str
    score: Float[np.ndarray, "scenario case"]
    at_fault: Float[np.ndarray, "driven case"]

    @property
    def block(self) -> str:
        """The name of its block."""
        return "A" if is_competent(self.at_fault[None]) else "B"


@dataclass(frozen=True)
class Ranking:
    """The ranks of a board.

    Attributes:
        order: The names of the entries: block A first, and in a block by rank and score.
        block: The block of each entry by name.
        rank: The rank of each entry in its block by name.
        pairs: The comparisons within blocks.
    """

    order: list[str]
    block: dict[str, str]
    rank: dict[str, Rank]
    pairs: list[Pair]


def rank_all(
    candidates: Sequence[Candidate],
    weights: Float[np.ndarray, "scenario"],
    blocks_of_time: Sequence[Int[np.ndarray, "case"]] | None = None,
) -> Ranking:
    """Rank entries by their mean score, in two blocks.

    Args:
        candidates: The entries, with the same cases.
        weights: The weights of the scenarios.
        blocks_of_time: The blocks of recorded time of the cases of each scenario; None without recorded pedestrians.
    """
    found = Ranking([], {each.name: each.block for each in candidates}, {}, [])
    for block in BLOCKS:
        own = [each for each in candidates if found.block[each.name] == block]
        mean = {each.name: float(weights @ each.score.mean(axis=1)) for each in own}
        best: dict[str, Candidate] = {}
        for each in own:
            if each.owner not in best or mean[each.name] > mean[best[each.owner].name]:
                best[each.owner] = each
        pairs, rank = _compare(list(best.values()), weights, blocks_of_time)
        found.pairs.extend(pairs)
        found.rank.update(rank)
        for each in own:
            if each.name not in rank:
                rivals = [other for owner, other in best.items() if owner != each.owner]
                own_pairs, own_rank = _compare([*rivals, each], weights, blocks_of_time)
                found.pairs.extend(pair for pair in own_pairs if each.name in (pair.higher, pair.lower))
                found.rank[each.name] = own_rank[each.name]
        found.order.extend(
            sorted(mean, key=lambda name: (found.rank[name].first, found.rank[name].last, -mean[name], name))
        )
    return found


def _compare(candidates: Sequence[Candidate], weights: Any, blocks: Any) -> tuple[list[Pair], dict[str, Rank]]:
    pairs = compare_all({each.name: each.score[None] for each in candidates}, weights, blocks)
    return pairs, ranks([each.name for each in candidates], pairs)


def place(rank: Rank) -> str:
    """Return a rank as a text, such as "1st" or "tied, 1st to 5th"."""
    if rank.first == rank.last:
        return _ordinal(rank.first)
    return f"tied, {_ordinal(rank.first)} to {_ordinal(rank.last)}"


def _ordinal(number: int) -> str:
    if number % 100 in (11, 12, 13):
        return f"{number}th"
    return f"{number}{('th', 'st', 'nd', 'rd', *['th'] * 6)[number % 10]}"
