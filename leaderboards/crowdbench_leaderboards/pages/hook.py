"""Hook of MkDocs: pages of all boards, of each board and of each entry of the leaderboards, and replays of their cases.

The folder of boards is `extra.boards` of mkdocs.yml. Texts of entries are untrusted, and never interpreted as Markdown.
The Markdown of a page has only its headings, and marks that are replaced by the HTML of its template.
"""

from __future__ import annotations

import contextlib
import functools
import html
import json
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jinja2
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

from crowdbench import METRICS, InputError
from crowdbench.metrics import OF_FLEETS, info_of
from crowdbench_leaderboards.board import MEASURED, Board, read_boards
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.pages import page_tables, ranking, texts
from crowdbench_leaderboards.pages.readme import FILLING
from crowdbench_leaderboards.pages.replay import write_replay
from crowdbench_leaderboards.pages.standings import Standings, standings
from crowdbench_leaderboards.season import SEASON, TooEarly, read_season

FOLDER = "leaderboards"
"""The folder of the pages in the site."""

WIDE = {"hide": ["navigation", "toc"]}
"""The pages have no menu at the side, since their tables need the width."""

TEMPLATES = Path(__file__).parent / "templates"

parts: dict[str, list[str]] = {}
"""By page, the HTML before its first heading, and after each heading."""


def on_files(files: Files, config: Any) -> Files:
    """Add the pages and the replays, and list the boards in the menu."""
    root = Path(config.config_file_path).parent / config.extra["boards"]
    try:
        boards = read_boards(root)
        for uri, content in _pages(boards, root):
            files.append(File.generated(config, f"{FOLDER}/{uri}", content=content))
    except InputError as error:
        raise PluginError(str(error)) from None
    menu = [{board.spec.title: f"{FOLDER}/{board.name}/index.md"} for board in boards]
    for item in config.nav or []:
        if "Leaderboards" in item:
            item["Leaderboards"] = [{"All boards": f"{FOLDER}/index.md"}, *menu]
    return files


def on_page_content(content: str, page: Any, **kwargs: Any) -> str:
    """Replace the marks in a page by its HTML."""
    return re.sub(r"<!-- part (\d+) -->", lambda mark: parts[page.file.src_uri][int(mark[1])], content)


def _pages(boards: Sequence[Board], root: Path) -> Iterator[tuple[str, str | bytes]]:
    """Yield all pages and replays, by their addresses. Empty boards come last."""
    season = read_season(root) if (root / SEASON).exists() else None
    seeds: dict[str, int] = {}
    for board in boards:
        with contextlib.suppress(TooEarly):
            seeds |= {board.name: season.seed(board.name)} if season else {}
    tables = [standings(board, read_entries(board, root), season) for board in boards]
    tables.sort(key=lambda table: not table.entries)
    yield _page("index.md", {"title": "Leaderboards"}, "index.html", boards=tables, seeds=seeds, season=season)
    for table in tables:
        yield from _of_board(table, seeds=seeds, season=season)


def _of_board(table: Standings, **context: Any) -> Iterator[tuple[str, str | bytes]]:
    """Yield the page of a board, the pages of its entries, and the replay of its public cases."""
    board = table.board
    with tempfile.TemporaryDirectory() as place:
        problems = write_replay(board, [one.entry for one in table.entries], Path(place) / "replay")
        for path in sorted(Path(place).rglob("*.*")):
            yield f"{board.name}/{path.relative_to(place).as_posix()}", path.read_bytes()
    context |= {"standings": table, "played": {one.name for one in table.entries} - problems.keys()}
    meta = {"title": html.escape(board.spec.title), "search": {"boost": 0.5}}
    yield _page(f"{board.name}/index.md", meta, "board.html", **context, found=page_tables.case_table(table))
    for one in table.entries:
        meta = {"title": html.escape(texts.shorten(one.entry.card.title, 60)), "search": {"exclude": True}}
        uri = f"{board.name}/entries/{one.name}.md"
        yield _page(uri, meta, "entry.html", one=one, problem=problems.get(one.name, ""), **context)


def _page(uri: str, meta: dict[str, Any], template: str, **context: Any) -> tuple[str, str]:
    """Return the Markdown of a page, and store the HTML of its parts, separated by lines that begin with ##."""
    before, *rest = re.split(r"^(## .+)\n", _templates().get_template(template).render(context), flags=re.MULTILINE)
    parts[f"{FOLDER}/{uri}"] = [before, *rest[1::2]]
    marks = [f"{heading}\n\n<!-- part {number} -->" for number, heading in enumerate(["", *rest[::2]])]
    return uri, f"---\n{json.dumps(meta | WIDE, ensure_ascii=False)}\n---\n" + "\n\n".join(marks)


@functools.cache
def _templates() -> jinja2.Environment:
    """Return the templates, which escape every inserted text."""
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters |= {function.__name__: function for function in texts.FILTERS}
    shown = {name: METRICS[name] for name in MEASURED} | OF_FLEETS
    headings = {name: info_of(name).heading for name in shown}
    meanings = {name: str(metric.__doc__).partition(" [")[0] for name, metric in shown.items()}
    templates.globals |= {"METRICS": headings, "METRICS_SAY": meanings, "COMPLIANCE": texts.COMPLIANCE}
    templates.globals |= {"FILLING": FILLING, "tables": page_tables, "place": ranking.place, "BLOCKS": ranking.BLOCKS}
    return templates
