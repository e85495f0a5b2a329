"""Builds the pages: one for all boards, one for each board, one for each entry."""

from __future__ import annotations

import itertools
import shutil
from dataclasses import dataclass
from pathlib import Path

import jinja2

from crowdbench.boards.board import Board, read_boards
from crowdbench.boards.ranking import ALPHA
from crowdbench.boards.season import SEASON, Season, read_season
from crowdbench.boards.site.agreement import groups
from crowdbench.boards.site.cases import case_table
from crowdbench.boards.site.failures import failures
from crowdbench.boards.site.output import INDEX, site_folder
from crowdbench.boards.site.pages import STYLE, environment, write_page
from crowdbench.boards.site.pairs import pair_table
from crowdbench.boards.site.rows import Row, other_rows, ranked_rows, success_axis
from crowdbench.boards.site.scatter import scatter
from crowdbench.boards.standings import Standings, read_entries, standings
from crowdbench.errors import InputError

ENTRY_PAGES = "entries"
"""The folder of the pages of a board's entries, inside the board's."""


@dataclass(frozen=True)
class Shown:
    """A board as the pages show it.

    Attributes:
        board: The board.
        standings: Its standings.
        ranked: The rows of its ranked entries.
        others: The rows of the others.
        seed: The seed of its cases in the season; None where it is not known yet.
    """

    board: Board
    standings: Standings
    ranked: list[Row]
    others: list[Row]

    seed: int | None

    @property
    def has_methods(self) -> bool:
        """Whether some entry claims something of its method."""
        return any(row.verification and row.verification.method for row in (*self.ranked, *self.others))


def build(root: Path, out: Path) -> int:
    """Build all pages; see `crowdbench.boards.site.build_site`.

    Args:
        root: The folder of the boards.
        out: The folder to write.

    Returns:
        The number of pages.
    """
    templates = environment()
    with site_folder(out) as folder:
        season = read_season(root) if (root / SEASON).exists() else None
        boards = [_shown(board, root, season) for board in read_boards(root)]
        shutil.copyfile(STYLE, folder / STYLE.name)
        _write_index(templates, folder, boards, season)
        for shown in boards:
            _write_board(templates, folder / shown.board.name, shown, season)
            for row in (*shown.ranked, *shown.others):
                _write_entry(templates, folder / shown.board.name / ENTRY_PAGES, shown, row, season)
    return 1 + sum(1 + len(shown.ranked) + len(shown.others) for shown in boards)


def _shown(board: Board, root: Path, season: Season | None) -> Shown:
    found = standings(board, read_entries(board, root), season.spec.name if season else "")
    return Shown(board, found, ranked_rows(found), other_rows(found), _seed(season, board.name))


def _seed(season: Season | None, board: str) -> int | None:
    if season is None:
        return None
    try:
        return season.seed(board)
    except InputError:  # the season is still open
        return None


def _write_index(templates: jinja2.Environment, folder: Path, boards: list[Shown], season: Season | None) -> None:
    write_page(
        templates,
        "index.html",
        folder / INDEX,
        top="",
        boards=boards,
        season=season,
        groups=groups([shown.standings for shown in boards]),
    )


def _write_board(templates: jinja2.Environment, folder: Path, shown: Shown, season: Season | None) -> None:
    write_page(
        templates,
        "board.html",
        folder / INDEX,
        top="../",
        shown=shown,
        board=shown.board,
        standings=shown.standings,
        season=season,
        begin=success_axis(shown.standings),
        scatter=scatter(shown.standings),
        pairs=pair_table(shown.standings),
        cases=case_table(shown.standings),
        alpha=ALPHA,
        families=[
            (family, [each.name for each in scenarios])
            for family, scenarios in itertools.groupby(shown.board.scenarios, lambda each: each.family)
        ],
    )


def _write_entry(templates: jinja2.Environment, folder: Path, shown: Shown, row: Row, season: Season | None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    entry = row.standing.entry
    write_page(
        templates,
        "entry.html",
        folder / f"{entry.name}.html",
        top="../../",
        shown=shown,
        board=shown.board,
        row=row,
        entry=entry,
        season=season,
        failures=failures(shown.board, entry, folder),
    )
