"""`leaderboards/README.md`: the standings of every board as Markdown."""

from __future__ import annotations

from pathlib import Path

from crowdbench.boards.board import read_boards
from crowdbench.boards.season import read_season
from crowdbench.boards.standings import Standing, Standings, read_entries, standings
from crowdbench.metrics import info_of
from crowdbench.utils import files
from crowdbench.utils.tables import markdown

README = "README.md"

SUCCESS = info_of("success_rate")

INTRODUCTION = """# Leaderboards

Made by `crowdbench leaderboard readme` from the entries in these folders; `python leaderboards/site/build.py --out
DIR` makes pages with figures from them. [docs/boards.md](../docs/boards.md) says how to enter a planner and what a rank
means.

Entries stand in the order of their score: success in per cent, and up to half a point for being quick. A new rank
begins where an entry is worse than one of the present rank by more than chance explains; in brackets is the range of
its true place, with a confidence of 95 % for the whole board. Figures have 95 % intervals. "method" is the rank of the
method, by the mean over networks that were trained with other seeds, and its success with an interval for other
networks and other cases. SCT is success weighted by completion time. "imposed delay" is the total extra travel time of
all pedestrians of a case, where they see the vehicle. "decision" is the 99th percentile of the time for a decision in
one world, on one core of the machine of reference. An asterisk marks the Pareto set: no ranked entry succeeds more
often and is quicker. Entries that are "reported only" have no rank: their figures are those of their authors, of the
public cases. A "pending" entry was made for other rules, scenarios or code.

Season "{season.name}"{rehearsal}. It closes on {season.closes}; the seed of the cases follows from \
the digests of all entries and from round {season.round} of drand.
"""

FILLING = "The boards are being filled: there are no entries yet."


def write_readme(root: Path) -> Path:
    """Write the standings of all boards of a folder, and return the file.

    Raises:
        InputError: A board or an entry is not as it must be.
    """
    season = read_season(root)
    rehearsal = ", a rehearsal: its round was known before it closed" if season.spec.rehearsal else ""
    tables = [standings(board, read_entries(board, root), season) for board in read_boards(root)]
    introduction = INTRODUCTION.format(season=season.spec, rehearsal=rehearsal)
    filling = [] if any(table.entries for table in tables) else [f"{FILLING}\n"]
    parts = [introduction, *filling, *map(section, tables)]
    with files.whole(root / README) as partial:
        partial.write_text("\n".join(parts), encoding="utf-8")
    return root / README


def section(table: Standings) -> str:
    """The standings of one board in Markdown."""
    lines = [f"## {table.board.spec.title} (`{table.board.name}`)", "", table.board.spec.description, ""]
    if not table.entries:
        return "\n".join([*lines, "No entries yet.", ""])
    rows = [_cells(table, one) for one in table.entries]
    lines.append(markdown(list(rows[0]), [list(row.values()) for row in rows]))
    if table.ranked:
        blocks = sum(len(set(own.tolist())) for own in table.ranked[0].blocks.values())
        of_time = f", {blocks} blocks of recorded time in all" if blocks else ""
        lines += ["", f"{table.board.spec.cases} cases of each scenario{of_time}."]
    return "\n".join([*lines, ""])


def _cells(table: Standings, one: Standing) -> dict[str, str]:
    """The cells of an entry, by the headings of the columns of its board."""
    figures, speed, method = one.figures, one.decision_time, one.method
    pareto = " \\*" if one.is_pareto else ""
    slow = "" if speed is None or speed.is_real_time else ", not real-time"
    cells = {
        "rank": "" if one.rank is None else f"{one.rank.rank} ({one.rank.first} to {one.rank.last})",
        "entry": f"{one.entry.name}{pareto}, {one.entry.spec.submitted_by}",
        SUCCESS.heading: SUCCESS.estimate(figures["success_rate"]),
        "score": f"{100.0 * one.score:.2f}" if one.rank else "",
    }
    if table.has_methods:
        success = SUCCESS.estimate(method.metrics["success_rate"], with_unit=True) if method else "as the entry"
        networks = f", {method.networks} networks" if method else ""
        cells["method"] = f"{one.method_rank}: {success}{networks}" if one.method_rank else ""
    for metric in table.shown:
        info = info_of(metric)
        cells[info.heading] = info.estimate(figures[metric])
    untimed = "not timed" if one.verification and one.verification.untimed else ""
    cells["decision"] = untimed if speed is None else f"{speed.calibrated_p99_ms:.0f} ms{slow}"
    cells[""] = one.reason
    return cells
