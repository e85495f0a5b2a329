"""Hook of MkDocs: pages of all boards, of each board and of each entry of the leaderboards, and replays of their cases.

The folder of boards is `extra.boards` of mkdocs.yml. Strangers write the texts of entries, so these never are Markdown:
the Markdown of a page has its headings, and marks where the HTML of its template is put afterwards.
"""

from __future__ import annotations

import functools
import html
import json
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jinja2
import page_tables
import texts
from failures import failures, write_replay
from figures import success_against_time
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from readme import FILLING
from standings import Standing, Standings, standings

from crowdbench.boards.board import MEASURED, read_boards
from crowdbench.boards.entry import read_entries
from crowdbench.boards.season import SEASON, Season, TooEarly, read_season
from crowdbench.metrics import METRICS, info_of
from crowdbench.utils.errors import InputError
from crowdbench.utils.progress import progress

FOLDER = "leaderboards"
"""The folder of the pages in the site, and their item of the menu."""

WIDE = ["navigation", "toc"]
"""What the pages hide, since their tables need the width."""

TEMPLATES = Path(__file__).parent / "templates"

parts: dict[str, list[str]] = {}
"""By page, the HTML before its first heading, and after each heading."""


def on_files(files: Files, config: Any) -> Files:
    """Add the pages and the replays, and list the boards in the menu."""
    root = Path(config.config_file_path).parent / config.extra["boards"]
    try:
        boards = read_boards(root)
        season = read_season(root) if (root / SEASON).exists() else None
        tables = (standings(board, read_entries(board, root), season) for board in boards)
        with progress(2 * len(boards), "of the leaderboards") as report:
            found = [(report(1), table)[1] for table in tables]
            files.append(File.generated(config, f"{FOLDER}/index.md", content=_index(found, season)))
            for table in found:
                for uri, content in _of_board(table, season):
                    files.append(File.generated(config, f"{FOLDER}/{table.board.name}/{uri}", content=content))
                report(1)
    except InputError as error:
        raise PluginError(str(error)) from None
    menu = [{board.spec.title: f"{FOLDER}/{board.name}/index.md"} for board in boards]
    for item in config.nav or []:
        if "Leaderboards" in item:
            item["Leaderboards"] = [{"All boards": f"{FOLDER}/index.md"}, *menu]
    return files


def on_page_content(content: str, page: Any, **kwargs: Any) -> str:
    """Put the HTML of a page where its marks are."""
    return re.sub(r"<!-- part (\d+) -->", lambda mark: parts[page.file.src_uri][int(mark[1])], content)


def _index(tables: Sequence[Standings], season: Season | None) -> str:
    """Return the Markdown of the page of all boards. Boards that tell little, or nothing, come last."""
    seeds = {table.board.name: _find_seed(season, table.board.name) for table in tables}
    boards = sorted(tables, key=lambda table: (not table.entries, table.is_saturated))
    meta = {"title": "Leaderboards", "hide": WIDE}
    return _page("index.md", meta, "index.html", boards=boards, seeds=seeds, season=season)


def _of_board(table: Standings, season: Season | None) -> Iterator[tuple[str, str | bytes]]:
    """Make the page of a board, the pages of its entries, and the replay of its public cases, by their addresses."""
    board = table.board
    failed = {one.name: failures(board, one.entry) for one in table.entries}
    played = [one.entry for one in table.entries if not failed[one.name].problem]
    context = {"standings": table, "season": season, "played": {entry.name for entry in played}}
    meta = {"title": html.escape(board.spec.title), "hide": WIDE, "search": {"boost": 0.5}}
    cases = [found for is_public in (False, True) if (found := page_tables.case_table(table, is_public))]
    more = {"seed": _find_seed(season, board.name), "scatter": success_against_time(table), "cases": cases}
    yield "index.md", _page(f"{board.name}/index.md", meta, "board.html", **context, **more)
    for one in table.entries:
        yield (
            (uri := f"entries/{one.name}.md"),
            _of_entry(f"{board.name}/{uri}", one, failures=failed[one.name], **context),
        )
    if played:
        with tempfile.TemporaryDirectory() as place:
            replay = Path(place) / "replay"
            write_replay(board, played, replay)
            for path in sorted(replay.rglob("*.*")):
                yield path.relative_to(place).as_posix(), path.read_bytes()


def _of_entry(uri: str, one: Standing, **context: Any) -> str:
    title = html.escape(texts.shorten(one.entry.card.title, 60))
    meta = {"title": title, "hide": WIDE, "search": {"exclude": True}}
    return _page(uri, meta, "entry.html", one=one, **context)


def _find_seed(season: Season | None, board: str) -> int | None:
    """Return the seed of the cases of a board; None where it is not known yet."""
    try:
        return season.seed(board) if season else None
    except TooEarly:
        return None


def _page(uri: str, meta: dict[str, Any], template: str, **context: Any) -> str:
    """Return the Markdown of a page, and keep the HTML of its parts, which lines that begin with ## separate."""
    before, *rest = re.split(r"^(## .+)\n", _templates().get_template(template).render(context), flags=re.MULTILINE)
    parts[f"{FOLDER}/{uri}"] = [before, *rest[1::2]]
    marks = [f"{heading}\n\n<!-- part {number} -->" for number, heading in enumerate(["", *rest[::2]])]
    return f"---\n{json.dumps(meta, ensure_ascii=False)}\n---\n" + "\n\n".join(marks)


@functools.cache
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
    headings = {name: info_of(name).heading for name in MEASURED}
    meanings = {name: str(METRICS[name].__doc__).partition(" [")[0] for name in MEASURED}
    templates.globals |= {"METRICS": headings, "METRICS_SAY": meanings, "MANNERS": texts.MANNERS}
    templates.globals |= {"FILLING": FILLING, "tables": page_tables}
    return templates
