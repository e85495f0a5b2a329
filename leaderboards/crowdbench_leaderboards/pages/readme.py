"""Writes `leaderboards/README.md`, the standings of every board as Markdown.

python -m crowdbench_leaderboards.pages.readme
"""

from __future__ import annotations

from pathlib import Path

from crowdbench.cli import help_from_docstring, main
from crowdbench.metrics import info_of
from crowdbench.utils import markdown, write_whole
from crowdbench_leaderboards.board import read_boards
from crowdbench_leaderboards.cli import ROOT
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.pages.ranking import place
from crowdbench_leaderboards.pages.standings import Standing, Standings, standings
from crowdbench_leaderboards.pages.texts import shorten
from crowdbench_leaderboards.season import read_season

README = "README.md"

SCORE = info_of("score")

INTRODUCTION = """# Leaderboards

Made by `python -m crowdbench_leaderboards.pages.readme` from the entries in these folders. The documentation site has
their pages with replays. [Enter](../docs/boards.md), [rules](../docs/boards_rules.md).

Entries are ranked by [the score](../docs/methods.md#score), in two blocks: A, seldom at fault, and B, often at fault.
A rank such as "tied, 1st to 3rd" is an interval: the intervals of all entries of a block jointly contain the true ranks
with a confidence of 95 %. Figures have 95 % intervals. "decision" is the 99th percentile of the time of all decisions
in the ranked cases, one world at a time on one core. Entries marked as "raw" have a tracker of their own. Entries that
are "reported only" have no rank: their figures are reported by their authors, on the public cases. A "pending" entry
was made for other rules, scenarios or another simulator.

Season "{season.name}"{rehearsal}. It closes on {season.closes}; the seed of the cases follows from \
the digests of all entries and from round {season.round} of drand.
"""

FILLING = "The boards are being filled: there are no entries yet."


@help_from_docstring
def readme(root: Path = ROOT) -> None:
    """Write README.md of the folder of boards, with the standings of each board.

    Args:
        root: The folder of boards and entries.
    """
    print(f"wrote {write_readme(root)}")


def write_readme(root: Path) -> Path:
    """Write the standings of all boards of a folder, and return the file.

    Raises:
        InputError: A board or an entry is damaged.
    """
    season = read_season(root)
    rehearsal = ", a rehearsal: its round was known before it closed" if season.spec.rehearsal else ""
    tables = [standings(board, read_entries(board, root), season) for board in read_boards(root)]
    introduction = INTRODUCTION.format(season=season.spec, rehearsal=rehearsal)
    filling = [] if any(table.entries for table in tables) else [f"{FILLING}\n"]
    with write_whole(root / README) as partial:
        partial.write_text("\n".join([introduction, *filling, *map(section, tables)]), encoding="utf-8")
    return root / README


def section(table: Standings) -> str:
    """Return the standings of a board in Markdown."""
    lines = [f"## {table.board.spec.title} (`{table.board.name}`)", "", table.board.spec.description, ""]
    # Names and reasons are of strangers: nothing in them ends the code span.
    bad = sorted((name.replace("`", "'"), shorten(why, 200).replace("`", "'")) for name, why in table.bad.items())
    out = [f"- `{name}` is left out: `{why}`" for name, why in bad]
    for name, account in sorted(table.withdrawn.items()):
        out.append(f"- `{name}` was withdrawn by {account or 'the maintainers'} after the freeze")
    if not table.entries:
        return "\n".join([*lines, "No entries yet.", "", *out, *[""] * bool(out)])
    rows = [_cells(table, entry) for entry in table.entries]
    lines.append(markdown(list(rows[0]), [list(row.values()) for row in rows]))
    if table.ranked:
        lines += ["", f"Ranked by the score in {table.board.spec.cases} cases of each scenario."]
    return "\n".join([*lines, "", *out, *[""] * bool(out)])


def _cells(table: Standings, entry: Standing) -> dict[str, str]:
    """Return the cells of an entry, by the headings of the columns of its board."""
    figures, speed = entry.figures, entry.decision_time
    raw = " (raw)" if entry.entry.spec.raw else ""
    cells = {
        "block": entry.block,
        "rank": place(entry.rank) if entry.rank else "",
        "entry": f"{entry.name}{raw}, {entry.submitter}",
        SCORE.heading: SCORE.estimate(figures["score"]),
    }
    for metric in table.shown:
        info = info_of(metric)
        cells[info.heading] = info.estimate(figures[metric])
    cells["decision"] = ""
    if speed is not None:
        cells["decision"] = f"{speed.p99_ms:.0f} ms{'' if speed.is_real_time else ', not real-time'}"
    cells[""] = entry.reason
    return cells


if __name__ == "__main__":
    main(readme)
