"""The table of tests between the ranked entries of a board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from crowdbench.boards.ranking import Comparison
from crowdbench.boards.site.texts import METRICS, metric, p_text
from crowdbench.boards.standings import Standing, Standings

CRITERION_WORDS = {"success_rate": "success", "collision_rate": "collisions", "sct": "SCT"}


@dataclass(frozen=True)
class Cell:
    """A pair of entries, seen from the one in the row.

    Attributes:
        verdict: "better", "worse", or empty where no difference is significant.
        criterion: The metric that decides; success where none does.
        difference: The difference in it, row minus column, with its unit.
        p: Its p-value, corrected for all tests of the board.
    """

    verdict: str
    criterion: str
    difference: str
    p: str


def pair_table(found: Standings) -> list[tuple[Standing, Sequence[Cell | None]]]:
    """A row for each ranked entry with a cell for each ranked entry, None for itself.

    Args:
        found: The standings of the board.
    """
    cells: dict[tuple[int, int], Cell] = {}
    for one in found.comparisons:
        a, b = one.entries
        cells[a, b], cells[b, a] = _cell(one, a, 1.0), _cell(one, b, -1.0)
    places = range(len(found.ranked))
    return [(found.ranked[i], [cells.get((i, j)) for j in places]) for i in places]


def _cell(one: Comparison, row: int, sign: float) -> Cell:
    criterion = one.criterion or "success_rate"
    difference = sign * one.differences[criterion]
    text = metric(difference, criterion)
    return Cell(
        verdict="" if one.better is None else "better" if one.better == row else "worse",
        criterion=CRITERION_WORDS.get(criterion, METRICS[criterion]),
        difference=f"+{text}" if difference > 0.0 else text,
        p=p_text(one.p[criterion]),
    )
