"""`leaderboards/README.md`: the standings of every board as Markdown."""

from __future__ import annotations

import math
from pathlib import Path

from crowdbench import files
from crowdbench.boards.board import read_boards
from crowdbench.boards.season import Season, read_season
from crowdbench.boards.standings import Standing, Standings, read_entries, standings
from crowdbench.evaluate.summary import Estimate

README = "README.md"

HEAD = ("rank", "entry", "success", "method", "collisions", "SCT", "time", "time within 0.45 m", "jerk", "decision", "")

INTRODUCTION = """# Leaderboards

Made by `crowdbench leaderboard readme` from the entries in these folders; `crowdbench leaderboard build --out DIR`
makes pages with figures from them. [docs/boards.md](../docs/boards.md) says how to enter a planner and what a rank
means.

A rank is 1 plus the number of entries that are significantly better (paired by case, all pairs of a board tested
together by Holm's method); in brackets are the ranks that the data allow. Success and SCT (success weighted by
completion time) have 95 % intervals. "decision" is the 99th percentile of the time for a decision in one world, on one
core of the machine of reference. "method" is the mean success over networks that were trained with other seeds, with an
interval for other networks and other cases. "imposed delay" is the time that all pedestrians of a case together lose to
the vehicle, where they see it. An asterisk marks the Pareto set: no ranked entry succeeds more often and is quicker.
"""


def write_readme(root: Path) -> Path:
    """Write the standings of all boards.

    Args:
        root: The folder of boards.

    Returns:
        The file.

    Raises:
        InputError: A board or an entry is not as it must be.
    """
    season = read_season(root)
    parts = [INTRODUCTION + _season(season)]
    for board in read_boards(root):
        parts.append(section(standings(board, read_entries(board, root), season.spec.name)))
    with files.whole(root / README) as partial:
        partial.write_text("\n".join(parts), encoding="utf-8")
    return root / README


def _season(season: Season) -> str:
    spec = season.spec
    rehearsal = ", a rehearsal: its round was known before it closed" if spec.rehearsal else ""
    return (
        f'\nSeason "{spec.name}"{rehearsal}. It closes on {spec.closes}; the seed of the cases follows from '
        f"the digests of all entries and from round {spec.round} of drand.\n"
    )


def section(found: Standings) -> str:
    """The standings of one board.

    Args:
        found: The standings.

    Returns:
        Markdown.
    """
    spec = found.board.spec
    lines = [f"## {spec.title}", "", spec.description, ""]
    if not found.ranked and not found.others:
        return "\n".join([*lines, "No entries yet.", ""])
    worst = len(found.board.scenarios) > 1
    delays = ["imposed delay"] * (spec.flags.imposed_delay is not None)
    head = [*HEAD[:3], *["worst scenario"] * worst, *HEAD[3:-3], *delays, *HEAD[-3:]]
    lines += [_row(head), _row(["---"] * len(head))]
    lines += [_row(_cells(one, worst, one in found.slow)) for one in (*found.ranked, *found.others)]
    if found.ranked:
        counts = sorted({one.cases for one in found.ranked}, reverse=True)
        lines += ["", " ".join(_told_apart(found, cases) for cases in counts)]
    return "\n".join([*lines, ""])


def _told_apart(found: Standings, cases: int) -> str:
    """What difference in success so many cases of each scenario tell apart."""
    total = f"{cases * len(found.board.scenarios)} cases"
    least = found.smallest_difference(cases)
    if found.board.spec.recorded:
        blocks = sum(len(set(own.tolist())) for own in found.ranked[0].blocks.values())
        return f"{total} in {blocks} blocks of recorded time, over which entries are compared."
    if least > 1.0 or len(found.ranked) < 2:
        return f"{total}."
    return (
        f"{total} tell apart a difference in success of {100 * least:.2f} percentage points at best, among "
        f"{len(found.ranked)} entries."
    )


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cells(one: Standing, worst: bool, is_slow: bool) -> list[str]:
    rank = "" if one.rank is None else f"{one.rank.rank} ({one.rank.rank} to {one.rank.last})"
    name = one.entry.name + (" \\*" if one.is_pareto else "")
    figures = one.figures
    speed = one.season.decision_time if one.season else None
    slow = "" if speed is None or speed.is_real_time else ", not real-time"
    cells = [
        rank,
        f"{name}, {one.entry.spec.submitted_by}",
        _percent(figures["success_rate"]),
        _method(one),
        _number(100 * figures["collision_rate"].mean, 1, " %"),
        _with_interval(figures["sct"], 3),
        _number(figures["navigation_time"].mean, 2, " s"),
        _number(100 * figures["intimate_zone"].mean, 0, " %"),
        _number(figures["jerk"].mean, 1, ""),
        "" if speed is None else f"{speed.calibrated_p99_ms:.0f} ms{slow}",
        one.reason or ", ".join([*one.flags, *[f"{one.cases} cases"] * is_slow]),
    ]
    if "imposed_delay" in figures:
        cells.insert(-3, _number(figures["imposed_delay"].mean, 1, " s"))
    return [*cells[:3], _number(100 * one.worst, 1, " %"), *cells[3:]] if worst else cells


def _method(one: Standing) -> str:
    found = one.season.method if one.season else None
    if found is None:
        return ""
    success = found.metrics["success_rate"]
    interval = f"{100 * success.low:.1f} to {100 * success.high:.1f}"
    return f"{100 * success.mean:.1f} % ({interval}), {found.networks} networks"


def _percent(estimate: Estimate) -> str:
    if math.isnan(estimate.mean):
        return ""
    return f"{100 * estimate.mean:.2f} % ({100 * estimate.low:.2f} to {100 * estimate.high:.2f})"


def _with_interval(estimate: Estimate, digits: int) -> str:
    if math.isnan(estimate.mean):
        return ""
    return f"{estimate.mean:.{digits}f} ({estimate.low:.{digits}f} to {estimate.high:.{digits}f})"


def _number(value: float, digits: int, unit: str) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}{unit}"
