"""The pages of the leaderboards: one for all boards, one for each board, one for each entry, and replays of cases.

They are plain files that need no server and no network, and but for the replays no JavaScript:
python leaderboards/site/build.py --out pages
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any

import jinja2
import page_tables
import texts
import typer
from failures import failures, write_replay
from figures import success_against_time
from markupsafe import Markup
from readme import FILLING
from standings import Standings, standings

from crowdbench.boards.board import MEASURED, Board, read_boards
from crowdbench.boards.entry import read_entries
from crowdbench.boards.season import SEASON, Season, TooEarly, read_season
from crowdbench.cli import main
from crowdbench.cli.boards import ROOT
from crowdbench.cli.options import help_from_docstring
from crowdbench.metrics import METRICS, info_of
from crowdbench.utils.errors import InputError, find_named
from crowdbench.utils.files import new_directory
from crowdbench.utils.progress import progress

INDEX = "index.html"

MARK = '<meta name="generator" content="leaderboards/site/build.py of crowdbench">'
"""Mark of the first page of every site, so that no other folder is replaced."""

ENTRY_PAGES = "entries"
"""The folder of the pages of a board's entries, inside the board's."""

REPLAY = "replay"
"""The folder of the replays, inside the board's."""

HERE = Path(__file__).parent
TEMPLATES = HERE / "templates"
STYLE = HERE / "style.css"


@help_from_docstring
def build(out: Annotated[Path, typer.Option()], board: list[str] | None = None, root: Path = ROOT) -> None:
    """Build the pages of boards.

    Args:
        out: Folder for the pages.
        board: The name of a board; else all. Repeatable.
    """
    pages = build_site(root, out, board or [])
    print(f"{pages} pages; open {out / INDEX}")


def build_site(root: Path, out: Path, names: Collection[str] = ()) -> int:
    """Build the pages of boards.

    The same boards give the same bytes.

    Args:
        root: The folder of boards.
        out: The folder of the pages. One that an earlier build has made is replaced.
        names: The names of the boards; all if there are none.

    Returns:
        The number of pages.

    Raises:
        InputError: There is no such board, a board or an entry is not as it must be, or `out` holds something else or
            cannot be written.
    """
    templates = _templates()
    _check_replaceable(out)
    by_name = {board.name: board for board in read_boards(root)}
    chosen = [find_named("board", name, by_name) for name in names or by_name]
    work = progress(2 * len(chosen), "of the pages")
    with new_directory(out, overwrite=True, mark=INDEX) as folder, work as report:
        season = read_season(root) if (root / SEASON).exists() else None
        templates.globals["season"] = season
        boards = []
        for board in chosen:
            boards.append(standings(board, read_entries(board, root), season))
            report(1)
        seeds = {found.board.name: _find_seed(season, found.board) for found in boards}
        shutil.copyfile(STYLE, folder / STYLE.name)
        _write(folder / INDEX, templates, "index.html", top="", boards=sorted(boards, key=_is_saturated), seeds=seeds)
        for found in boards:
            _write_board(folder / found.board.name, templates, found, seeds[found.board.name])
            report(1)
    return 1 + sum(1 + len(found.entries) for found in boards)


def _find_seed(season: Season | None, board: Board) -> int | None:
    """The seed of the cases of a board; None where it is not known yet."""
    try:
        return season.seed(board.name) if season else None
    except TooEarly:
        return None


def _is_saturated(found: Standings) -> bool:
    """Check if more than half of the ranked entries may be the best one, so that a board tells little."""
    return 2 * sum(one.rank is not None and one.rank.first == 1 for one in found.ranked) > len(found.ranked) > 2


def _check_replaceable(path: Path) -> None:
    """Raise InputError where `path` holds something that no build has made."""
    index = path / INDEX
    is_site = index.is_file() and MARK in index.read_text(encoding="utf-8", errors="replace")
    if path.is_dir() and any(path.iterdir()) and not is_site:
        raise InputError(f"{path.resolve()} holds something other than the pages of leaderboards: choose another --out")


def repository() -> str:
    """Return the address of the repository whose workflow publishes the pages below its documentation; else nothing."""
    name = os.environ.get("GITHUB_REPOSITORY")
    return f"{os.environ.get('GITHUB_SERVER_URL', 'https://github.com')}/{name}" if name else ""


def _templates() -> jinja2.Environment:
    """The templates, which escape every text that they are given."""
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters |= {function.__name__: function for function in texts.FILTERS}
    sort = Markup((TEMPLATES / "sort.js").read_text(encoding="utf-8"))
    headings = {name: info_of(name).heading for name in MEASURED}
    meanings = {name: str(METRICS[name].__doc__).partition(" [")[0] for name in MEASURED}
    templates.globals |= {"METRICS": headings, "METRICS_SAY": meanings, "MANNERS": texts.MANNERS}
    templates.globals |= {"MARK": Markup(MARK), "SORT": sort, "FILLING": FILLING}
    templates.globals["tables"] = page_tables
    templates.globals["REPOSITORY"] = repository()
    return templates


def _write_board(folder: Path, templates: jinja2.Environment, found: Standings, seed: int | None) -> None:
    """Write the page of a board, the pages of its entries, and the replays of their public cases."""
    failed = {one.entry.name: failures(found.board, one.entry) for one in found.entries}
    played = [one.entry for one in found.entries if not failed[one.entry.name].problem]
    (folder / ENTRY_PAGES).mkdir(parents=True)
    if played:
        write_replay(found.board, played, folder / REPLAY)
    context = {"standings": found, "played": {entry.name for entry in played}}
    scatter = success_against_time(found)
    _write(folder / INDEX, templates, "board.html", top="../", seed=seed, scatter=scatter, **context)
    for one in found.entries:
        page = folder / ENTRY_PAGES / f"{one.entry.name}.html"
        _write(page, templates, "entry.html", top="../../", one=one, failures=failed[one.entry.name], **context)


def _write(path: Path, templates: jinja2.Environment, template: str, **context: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    page = templates.get_template(template).render(context)
    path.write_text(page, encoding="utf-8", errors="replace", newline="\n")


if __name__ == "__main__":
    main(build)
