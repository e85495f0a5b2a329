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
from crowdbench_leaderboards.entry import read_entries
from crowdbench_leaderboards.pages.page_tables import near
from crowdbench_leaderboards.pages.ranking import MARGIN
from crowdbench_leaderboards.pages.standings import Standing, Standings, standings
from crowdbench_leaderboards.season import read_season

README = "README.md"

SUCCESS = info_of("success_rate")

INTRODUCTION = """# Leaderboards

Made by `python -m crowdbench_leaderboards.pages.readme` from the entries in these folders. The documentation site has
their pages with figures and replays. [docs/boards.md](../docs/boards.md) says how to enter a planner and what a rank
means.

Success is the primary endpoint of each board. The rank is an interval: the intervals of all entries of a board jointly
contain the true ranks with a confidence of 95 %. Entries of the same rank are listed by SCT, success weighted by
completion time, which is an order and no rank. "As good as" lists entries whose difference is surely below {margin:g}
points of success. Figures have 95 % intervals. "score" is [the score of the suite](../docs/methods.md#score). "method"
is the mean success over networks that were trained with other seeds, with an interval for other networks and other
cases. "imposed delay" is the total extra travel time of all pedestrians of a case, where they see the vehicle.
"decision" is the 99th percentile of the time for a decision in one world, on one core of the reference machine. An
asterisk marks the Pareto set: no ranked entry succeeds more often and is quicker. Entries marked as "raw" have a
tracker of their own. Entries that are "reported only" have no rank: their figures are reported by their authors, on
the public cases. A "pending" entry was made for other rules, scenarios or another simulator.

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
    introduction = INTRODUCTION.format(season=season.spec, rehearsal=rehearsal, margin=100.0 * MARGIN)
    filling = [] if any(table.entries for table in tables) else [f"{FILLING}\n"]
    with write_whole(root / README) as partial:
        partial.write_text("\n".join([introduction, *filling, *map(section, tables)]), encoding="utf-8")
    return root / README


def section(table: Standings) -> str:
    """Return the standings of a board in Markdown."""
    lines = [f"## {table.board.spec.title} (`{table.board.name}`)", "", table.board.spec.description, ""]
    if not table.entries:
        return "\n".join([*lines, "No entries yet.", ""])
    rows = [_cells(table, entry) for entry in table.entries]
    lines.append(markdown(list(rows[0]), [list(row.values()) for row in rows]))
    if table.ranked:
        blocks = sum(len(set(block.tolist())) for block in table.ranked[0].blocks.values())
        of_time = f", {blocks} blocks of recorded time in all" if blocks else ""
        lines += ["", f"Ranked by success in {table.board.spec.cases} cases of each scenario{of_time}."]
    return "\n".join([*lines, ""])


def _cells(table: Standings, entry: Standing) -> dict[str, str]:
    """Return the cells of an entry, by the headings of the columns of its board."""
    figures, speed, method = entry.figures, entry.decision_time, entry.method
    pareto, raw = " \\*" if entry.is_pareto else "", " (raw)" if entry.entry.spec.raw else ""
    cells = {
        "rank": str(entry.rank or ""),
        "entry": f"{entry.name}{raw}{pareto}, {'baseline' if entry.is_baseline else entry.entry.spec.submitted_by}",
        SUCCESS.heading: SUCCESS.estimate(figures["success_rate"]),
        "as good as": ", ".join(near(table, entry)[0]),
    }
    if table.has_methods:
        cells["method"] = ""
        if method:
            mean = SUCCESS.estimate(method.metrics["success_rate"].estimate, with_unit=True)
            cells["method"] = f"{mean}, {method.networks} networks"
    for metric in table.shown:
        info = info_of(metric)
        cells[info.heading] = info.estimate(figures[metric])
    cells["decision"] = "not timed" if entry.verification and entry.verification.untimed else ""
    if speed is not None:
        cells["decision"] = f"{speed.calibrated_p99_ms:.0f} ms{'' if speed.is_real_time else ', not real-time'}"
    cells[""] = entry.reason
    return cells


if __name__ == "__main__":
    main(readme)
