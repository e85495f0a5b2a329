"""The standings of a board: its entries with their ranks, or why they have none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from crowdbench.boards.board import Board
from crowdbench.boards.board_means import board_figures, success_by_family
from crowdbench.boards.entry import ENTRY, MAINTAINERS, Entry, read_entry
from crowdbench.boards.kept_runs import read_episodes
from crowdbench.boards.method import rank_methods
from crowdbench.boards.planner_files import has_changed
from crowdbench.boards.ranking import SCT, SUCCESS, Columns, Pair, Rank, compare_all, pareto, ranks, scores
from crowdbench.boards.season import Season
from crowdbench.boards.submission import ENTRIES
from crowdbench.boards.verdict import (
    DecisionTime,
    Method,
    Unverified,
    Verdict,
    Verification,
    read_verification,
    verification_folder,
)
from crowdbench.core.types import Outcome
from crowdbench.metrics.summary import NOTHING, Estimate
from crowdbench.utils.errors import InputError

MOST_RANKED = 2
"""The most ranked entries of one submitter on a board."""

SHOWN = ("collision_rate", "at_fault_rate", "sct", "navigation_time", "intimate_zone", "imposed_delay", "jerk")
"""The metrics that the table of a board shows beside success."""

PENDING = "Its board or its planner had other rules, scenarios or code: it must be submitted again."
REPORTED_ONLY = "The figures are its authors', of the public cases: {}."


@dataclass(frozen=True)
class Standing:
    """One entry on its board.

    Attributes:
        entry: The entry.
        verification: What was found in the season; None where nothing was that is believed.
        outcomes: The outcome of each case of the season, or else of each public case; `RUNNING` in scenarios that the
            planner cannot drive.
        columns: The metrics that rank, in the same cases.
        blocks: The blocks of recorded time of these cases, by scenario; none where nobody was recorded.
        scenarios: By scenario, the means with their intervals; none for those that the planner cannot drive.
        figures: The means over the board, with intervals; undefined for a pending entry.
        profile: By family of scenarios, success with its interval; nothing for a pending entry.
        is_pending: Whether it must be submitted again.
        reason: Why it has no rank, in a few words; empty where it has one.
        explanation: The same in a sentence.
        rank: Its rank.
        score: What ranks it; undefined where it has no rank.
        method_rank: The rank of its method, where that is known.
        is_pareto: Whether no ranked entry succeeds more often and is quicker.
    """

    entry: Entry
    verification: Verification | None
    outcomes: Int[np.ndarray, "scenario case"]
    columns: Columns
    blocks: Mapping[str, Int[np.ndarray, "case"]]
    scenarios: Mapping[str, Mapping[str, Estimate]]
    figures: Mapping[str, Estimate]
    profile: Mapping[str, Estimate]
    is_pending: bool
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


def read_entries(board: Board, root: Path) -> list[Entry]:
    """The entries of a board, by name. Raises InputError where one of them is not as it must be, see `read_entry`."""
    entries = [read_entry(path.parent) for path in sorted((root / board.name).glob(f"{ENTRIES}/*/{ENTRY}"))]
    for entry in entries:
        if entry.spec.board != board.name:
            raise InputError(f"{entry.directory} is an entry of the board {entry.spec.board}, not of {board.name}")
    return entries


def is_pending(board: Board, entry: Entry) -> bool:
    """Check if an entry was made for another digest of the board, or its planner has other code now."""
    return entry.spec.board_digest != board.digest or has_changed(entry)


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


def _blocks(each: Sequence[Standing]) -> Sequence[Int[np.ndarray, "case"]] | None:
    """The blocks of recorded time of the cases of each scenario; None where nobody was recorded.

    Args:
        each: The entries that are compared. All drove the same cases, so that a scenario has the same blocks in all.
    """
    if not any(one.blocks for one in each):
        return None
    blocks = {name: own for one in each for name, own in one.blocks.items()}
    nobody = np.zeros(each[0].outcomes.shape[1], np.int64)
    return [blocks.get(name, nobody) for name in each[0].scenarios]


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
    verification, doubt, pending = None, "there is no season", is_pending(board, entry)
    if season and not pending:
        try:
            verification = read_verification(entry, board, season)
        except Unverified as error:
            doubt = str(error)
    runs, cases, needed, measured = entry.public, board.spec.public_cases, set(board.metrics), {}
    if season and verification and verification.figures:
        runs, cases, needed = verification_folder(entry, season), board.spec.cases, {SCT}
        measured = verification.figures
    own = {} if pending else read_episodes(board, runs)
    shape = len(board.scenarios), cases
    outcomes, sct = np.full(shape, Outcome.RUNNING, np.int64), np.zeros(shape)
    for row, name in enumerate(board.scenarios):
        if name in own:
            if len(own[name]) != cases or not needed <= own[name].columns.keys():
                raise InputError(f"{runs / name} must have {cases} cases with {', '.join(needed)}")
            outcomes[row], sct[row] = own[name].outcome, own[name].columns[SCT]
    scenarios: dict[str, Mapping[str, Estimate]] = {}
    for name in board.scenarios:
        found = {metric: each.estimate for metric, each in measured.get(name, {}).items()}
        scenarios[name] = found or (own[name].summary() if name in own else {})
    reason, explanation = _why_unranked(board, entry, PENDING if pending else verification or doubt)
    return Standing(
        entry,
        verification,
        outcomes,
        {SUCCESS: (outcomes == Outcome.SUCCESS).astype(float), SCT: sct},
        {name: run.block for name, run in own.items() if run.block is not None},
        scenarios,
        dict.fromkeys(board.metrics, NOTHING) if pending else board_figures(board, scenarios),
        {} if pending else success_by_family(board, scenarios),
        pending,
        reason,
        explanation,
    )


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
    if verification == PENDING:
        return "pending", PENDING
    if isinstance(verification, str):
        return "reported only", REPORTED_ONLY.format(verification)
    if verification.verdict != Verdict.RERUN:
        return str(verification.verdict), verification.reason
    return "", ""
