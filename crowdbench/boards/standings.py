"""The standings of a board: its entries with their ranks, or why they have none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Int, Shaped

from crowdbench.boards.baselines import entry_folders
from crowdbench.boards.board import LATER, Board
from crowdbench.boards.board_means import board_figures, read_estimates, success_by_family
from crowdbench.boards.entry import MAINTAINERS, Entry, read_entry
from crowdbench.boards.method import rank_methods
from crowdbench.boards.ranking import SCT, SUCCESS, Pair, Rank, compare_all, pareto, ranks, scores
from crowdbench.boards.run_entry import read_episodes
from crowdbench.boards.season import Season
from crowdbench.boards.verdict import (
    DecisionTime,
    Method,
    Unverified,
    Verdict,
    Verification,
    find_verification,
    read_verification,
)
from crowdbench.metrics.summary import NOTHING, Estimate
from crowdbench.runs.results import Episodes
from crowdbench.utils.errors import InputError

MOST_RANKED = 2
"""The most ranked entries of one submitter on a board."""

SHOWN = ("collision_rate", "at_fault_rate", "sct", "navigation_time", "intimate_zone", "imposed_delay", "jerk")
"""The metrics that the table of a board shows beside success."""

OTHER_RULES = "It was made for other rules of this board than the present ones."
REPORTED_ONLY = "The figures are its authors', of the public cases: {}."

Columns = Mapping[str, Shaped[np.ndarray, "scenario case"]]


@dataclass(frozen=True)
class Standing:
    """One entry on its board.

    Attributes:
        entry: The entry.
        verification: What was found in the season; None where nothing was that is believed.
        columns: The metrics case by case, of the season's cases or else of the public ones.
        blocks: The blocks of recorded time of these cases, by scenario; none where nobody was recorded.
        scenarios: By scenario, the means with their intervals; none for those that the planner cannot drive.
        figures: The means over the board, with intervals; undefined for an entry of other rules.
        profile: By family of scenarios, success with its interval; nothing for an entry of other rules.
        reason: Why it has no rank, in a few words; empty where it has one.
        explanation: The same in a sentence.
        rank: Its rank.
        score: What ranks it; undefined where it has no rank.
        method_rank: The rank of its method, where that is known.
        is_pareto: Whether no ranked entry succeeds more often and is quicker.
    """

    entry: Entry
    verification: Verification | None
    columns: Columns
    blocks: Mapping[str, Int[np.ndarray, "case"]]
    scenarios: Mapping[str, Mapping[str, Estimate]]
    figures: Mapping[str, Estimate]
    profile: Mapping[str, Estimate]
    reason: str
    explanation: str
    rank: Rank | None = None
    score: float = np.nan
    method_rank: int | None = None
    is_pareto: bool = False

    @property
    def is_measured(self) -> bool:
        """Whether its figures were measured in the season; otherwise they are what its authors report."""
        return self.verification is not None and bool(self.verification.figures)

    @property
    def decision_time(self) -> DecisionTime | None:
        """How long its decisions took, if that was measured in the season."""
        return self.verification.decision_time if self.verification else None

    @property
    def method(self) -> Method | None:
        """What holds of its method, if that was measured in the season."""
        return self.verification.method if self.verification else None

    @property
    def cases(self) -> int:
        """How many cases of each scenario it drove."""
        return int(self.columns["sct"].shape[1])


@dataclass(frozen=True)
class Standings:
    """All entries of a board.

    Attributes:
        board: The board.
        season: The name of the season.
        ranked: The ranked entries, the best first.
        others: The others, by name.
        pairs: The ranked entries compared with each other.
    """

    board: Board
    season: str
    ranked: Sequence[Standing]
    others: Sequence[Standing]
    pairs: Sequence[Pair]

    @property
    def entries(self) -> Sequence[Standing]:
        """Both."""
        return [*self.ranked, *self.others]

    @property
    def shown(self) -> Sequence[str]:
        """The metrics that are shown beside success: those that any ranked entry has, or any at all without ranks."""
        seen = self.ranked or self.others
        return [name for name in SHOWN if any(np.isfinite(one.figures[name].mean) for one in seen)]

    @property
    def has_methods(self) -> bool:
        """Whether some entry claims something of its method."""
        return any(one.method for one in self.entries)

    def is_tied(self, standing: Standing) -> bool:
        """Whether another entry has the same rank."""
        return [one.rank and one.rank.rank for one in self.ranked].count(standing.rank and standing.rank.rank) > 1

    @property
    def slow(self) -> Sequence[Standing]:
        """The ranked entries that drove fewer cases than others, because a case takes them long."""
        return [one for one in self.ranked if one.cases < self.board.spec.cases]


def read_entries(board: Board, root: Path) -> list[Entry]:
    """The entries of a board, by name. Raises InputError where one of them is not as it must be, see `read_entry`."""
    entries = [read_entry(folder) for folder in entry_folders(root / board.name)]
    for entry in entries:
        if entry.spec.board != board.name:
            raise InputError(f"{entry.directory} is an entry of the board {entry.spec.board}, not of {board.name}")
    return entries


def standings(board: Board, entries: Sequence[Entry], season: Season | None) -> Standings:
    """Rank the entries of a board.

    Args:
        board: The board.
        entries: Its entries.
        season: The season whose verifications rank; None where there is none yet.

    Raises:
        InputError: The runs of an entry are damaged.
    """
    each = _limit_ranked([_standing(board, entry, season) for entry in entries])
    candidates = [one for one in each if not one.reason]
    columns = {one.entry.name: one.columns for one in candidates}
    score = scores(columns, board.weights, board.scale)
    pairs = compare_all(columns, board.weights, board.scale, _blocks(candidates))
    rank = ranks(score, pairs)
    costs = [(-one.figures["success_rate"].mean, one.figures["navigation_time"].mean) for one in candidates]
    # A time that is undefined, because nobody arrives, is the longest.
    best = pareto(np.nan_to_num(np.array(costs).reshape(-1, 2), nan=np.inf)).tolist()
    methods = rank_methods(board, [(one.entry, one.method, one.figures) for one in candidates])
    ranked = [
        replace(one, rank=rank[name], score=score[name], method_rank=methods.get(name), is_pareto=is_best)
        for (name, one), is_best in zip(((one.entry.name, one) for one in candidates), best, strict=True)
    ]
    ranked.sort(key=lambda one: list(score).index(one.entry.name))
    others = sorted((one for one in each if one.reason), key=lambda one: one.entry.name)
    return Standings(board, season.spec.name if season else "", ranked, others, pairs)


def _blocks(each: Sequence[Standing]) -> Int[np.ndarray, "scenario case"] | None:
    """The blocks of recorded time of the cases of a board, by numbers of their own; None where nobody was recorded.

    Args:
        each: The entries that are compared. Those who drove the same cases of a scenario have the same blocks.
    """
    if not any(one.blocks for one in each):
        return None
    numbers: list[np.ndarray] = []
    for name in each[0].scenarios:
        longest = max((one.blocks[name] for one in each if name in one.blocks), key=len, default=np.zeros(1, np.int64))
        own = np.resize(longest, max(one.cases for one in each))
        numbers.append(own + (1 + numbers[-1].max() if numbers else 0))
    return np.stack(numbers)


def _limit_ranked(each: Sequence[Standing]) -> list[Standing]:
    """The same, with a reason for those that are one too many of their submitter, by name."""
    ranked: Counter[str] = Counter()
    limited = []
    for one in each:
        submitter = one.entry.spec.submitted_by
        ranked[submitter] += not one.reason
        if not one.reason and submitter != MAINTAINERS and ranked[submitter] > MOST_RANKED:
            reason = f"more than {MOST_RANKED} of one submitter"
            one = replace(one, reason=reason, explanation="Other entries of its submitter are ranked here.")
        limited.append(one)
    return limited


def _standing(board: Board, entry: Entry, season: Season | None) -> Standing:
    verification, doubt, runs = None, "there is no season", entry.public
    if season:
        try:
            verification = read_verification(entry, board, season)
            runs = find_verification(entry, season) if verification.figures else runs
        except Unverified as error:
            doubt = str(error)
    is_present = entry.spec.board_digest == board.digest
    own = read_episodes(board, runs) if is_present else {}
    length = min((len(run.columns["sct"]) for run in own.values()), default=1)
    columns = {
        metric: np.stack([_column(own.get(name), metric, length) for name in board.scenarios])
        for metric in board.metrics
    }
    scenarios = {name: read_estimates(runs / name, board.metrics) if name in own else {} for name in board.scenarios}
    figures = board_figures(board, scenarios) if is_present else dict.fromkeys(board.metrics, NOTHING)
    profile = success_by_family(board, scenarios) if is_present else {}
    blocks = {name: run.block[:length] for name, run in own.items() if run.block is not None}
    reason, explanation = _why_unranked(board, entry, verification or doubt)
    return Standing(entry, verification, columns, blocks, scenarios, figures, profile, reason, explanation)


def _why_unranked(board: Board, entry: Entry, verification: Verification | str) -> tuple[str, str]:
    """Why an entry has no rank, in a few words and in a sentence; both empty if it has one.

    Args:
        board: The board.
        entry: The entry.
        verification: What was found in the season, or why there is nothing that counts.
    """
    if not board.spec.ranked:
        return "not ranked", "This board has no ranks: it shows how planners drive."
    if entry.spec.privileged:
        return "privileged", "It uses what no vehicle can see, such as the pedestrians' true next velocities."
    if entry.card.ablation:
        return "ablation", "Its authors say that it is a variant made for comparison."
    if entry.spec.board_digest != board.digest:
        return f"of version {entry.spec.board_version}", OTHER_RULES
    if isinstance(verification, str):
        return "reported only", REPORTED_ONLY.format(verification)
    if verification.verdict != Verdict.RERUN:
        return str(verification.verdict), verification.reason
    return "", ""


def _column(run: Episodes | None, metric: str, cases: int) -> Shaped[np.ndarray, "case"]:
    """A metric's values in the cases of a scenario; without a run, what ranks is 0, the rest undefined."""
    if run is not None and metric in run.columns:
        return run.columns[metric][:cases].astype(float)
    if run is not None and metric not in LATER:
        raise InputError(f"the runs of an entry lack the metric {metric}, which its board shows")
    return np.full(cases, 0.0 if metric in (SUCCESS, SCT) else np.nan)
