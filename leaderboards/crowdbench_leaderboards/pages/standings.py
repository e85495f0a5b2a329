"""The standings of a board: its entries with their ranks, or the reasons why they have none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from crowdbench import Episodes, InputError, Outcome
from crowdbench.metrics import UNDEFINED, Estimate, Pair, Rank, compare_all, mean_over_scenarios, ranks
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.board_runs import read_episodes
from crowdbench_leaderboards.entry import MAINTAINERS, Entry, fold, is_pending
from crowdbench_leaderboards.means import Estimates, board_figures
from crowdbench_leaderboards.pages.ranking import pareto, sort_entries, tiers
from crowdbench_leaderboards.season import Season
from crowdbench_leaderboards.verdict import (
    DecisionTime,
    Method,
    Unverified,
    Verdict,
    Verification,
    read_verification,
    verification_folder,
)

MAX_RANKED = 2
"""Largest number of ranked entries of a submitter on a board."""

SOCIAL = ("intimate_zone", "imposed_delay", "imposed_delay_positive")
"""The metrics of social compliance among `SHOWN`."""

SHOWN = ("score", "collision_rate", "at_fault_rate", "sct", "navigation_time", *SOCIAL, "jerk")
"""The metrics that the table of a board shows beside success."""

PENDING = "Its board has changed since: it must be submitted again."
REPORTED_ONLY = "Figures are reported by its authors, on public cases: {}."


@dataclass(frozen=True)
class Standing:
    """An entry on its board.

    Attributes:
        entry: The entry.
        verification: The verification of the season; None if none counts.
        outcomes: The outcome of each case of the season, or else of each public case; `RUNNING` in scenarios that the
            planner cannot drive.
        public: The outcome of each public case, or `RUNNING`.
        blocks: The blocks of recorded time of these cases, by scenario; empty without recorded pedestrians.
        scenarios: The means with their intervals by scenario and metric; none for scenarios that the planner cannot
            drive.
        figures: The means over the board, with intervals; undefined for a pending entry.
        profile: Success by family of scenarios, with its interval; empty for a pending entry.
        is_pending: True if it must be submitted again.
        reason: Reason why it has no rank, in a few words; empty if it has a rank.
        explanation: The same in a sentence.
        rank: Its rank.
        is_pareto: True if no ranked entry succeeds more often and is quicker.
        is_best: True for the entry of its submitter that counts for the ranks of others.
    """

    entry: Entry
    verification: Verification | None
    outcomes: Int[np.ndarray, "scenario case"]
    public: Int[np.ndarray, "scenario public_case"]
    blocks: Mapping[str, Int[np.ndarray, "case"]]
    scenarios: Estimates
    figures: Mapping[str, Estimate]
    profile: Mapping[str, Estimate]
    is_pending: bool
    reason: str
    explanation: str
    rank: Rank | None = None
    is_pareto: bool = False
    is_best: bool = False

    @property
    def name(self) -> str:
        """Name of the entry."""
        return self.entry.name

    @property
    def is_baseline(self) -> bool:
        """True if it is a shipped planner, submitted by the maintainers."""
        return fold(self.entry.spec.submitted_by) == MAINTAINERS

    @property
    def is_measured(self) -> bool:
        """True if the figures were measured in the season; otherwise they are reported by the authors."""
        return self.verification is not None and bool(self.verification.figures)

    @property
    def decision_time(self) -> DecisionTime | None:
        """Time of decisions, if it was measured in the season."""
        return self.verification.decision_time if self.verification else None

    @property
    def method(self) -> Method | None:
        """Means of the method, if they were measured in the season."""
        return self.verification.method if self.verification else None


@dataclass(frozen=True)
class Standings:
    """All entries of a board.

    Attributes:
        board: The board.
        season: The name of the season.
        ranked: The ranked entries by their ranks, and within a rank by SCT.
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
        """Ranked and other entries."""
        return [*self.ranked, *self.others]

    @property
    def shown(self) -> Sequence[str]:
        """Metrics beside success that any ranked entry has, or any entry if none is ranked."""
        entries = self.ranked or self.others
        return [name for name in SHOWN if any(np.isfinite(entry.figures[name].mean) for entry in entries)]

    @property
    def has_methods(self) -> bool:
        """True if the method of some entry was measured."""
        return any(entry.method for entry in self.entries)

    @property
    def is_saturated(self) -> bool:
        """True if more than half of the ranked entries may be the best one, so that the board separates few entries."""
        return 2 * sum(one.rank is not None and one.rank.first == 1 for one in self.ranked) > len(self.ranked) > 2

    @property
    def tiers(self) -> Sequence[bool]:
        """For each ranked entry, True if it begins a tier; only the best entry of each submitter can."""
        starts = iter(tiers([entry.rank for entry in self.ranked if entry.rank and entry.is_best]))
        return [entry.is_best and next(starts) for entry in self.ranked]


def standings(board: Board, entries: Sequence[Entry], season: Season | None) -> Standings:
    """Rank the entries of a board.

    Args:
        board: The board.
        entries: Its entries.
        season: The season whose verifications rank; None if there is none yet.

    Raises:
        InputError: The runs of an entry are damaged.
    """
    all_entries = _limit_ranked([_standing(board, entry, season) for entry in entries])
    candidates = {entry.name: entry for entry in all_entries if not entry.reason}
    pairs, rank = _compare(board, candidates)
    costs = [
        (-entry.figures["success_rate"].mean, entry.figures["navigation_time"].mean) for entry in candidates.values()
    ]
    # A time that is undefined, because no case succeeds, is the longest.
    optimal = pareto(np.nan_to_num(np.array(costs).reshape(-1, 2), nan=np.inf)).tolist()
    order = sort_entries(rank, {name: entry.figures["sct"].mean for name, entry in candidates.items()})
    is_pareto = dict(zip(candidates, optimal, strict=True))
    best = _best_of_each(board, candidates)
    ranked = [
        replace(candidates[name], rank=rank[name], is_pareto=is_pareto[name], is_best=name in best) for name in order
    ]
    others = sorted((entry for entry in all_entries if entry.reason), key=lambda entry: entry.name)
    return Standings(board, season.spec.name if season else "", ranked, others, pairs)


def _best_of_each(board: Board, candidates: Mapping[str, Standing]) -> list[str]:
    """Return the names of the entries that count for the ranks of others: the one of highest success of each submitter.

    Every shipped planner counts.
    """
    best: dict[str, tuple[float, str]] = {}
    for name, entry in candidates.items():
        success = float(board.weights @ (entry.outcomes == Outcome.SUCCESS).mean(axis=1))
        submitter = name if entry.is_baseline else f"by {entry.entry.submitter}"
        if submitter not in best or success > best[submitter][0]:
            best[submitter] = success, name
    return [name for _, name in best.values()]


def _compare(board: Board, candidates: Mapping[str, Standing]) -> tuple[list[Pair], dict[str, Rank]]:
    """Compare the best entries of all submitters with each other, and each other entry with other submitters' best.

    So an entry does not change the rank of others if its submitter has a better one.
    """
    best = _best_of_each(board, candidates)
    pairs, rank = _compare_entries(board, [candidates[name] for name in best])
    for name, entry in candidates.items():
        if name in best:
            continue
        rivals = [
            candidates[each]
            for each in best
            if candidates[each].is_baseline or candidates[each].entry.submitter != entry.entry.submitter
        ]
        own_pairs, own_rank = _compare_entries(board, [*rivals, entry])
        pairs += [pair for pair in own_pairs if name in (pair.higher, pair.lower)]
        rank[name] = own_rank[name]
    return pairs, rank


def _compare_entries(board: Board, entries: Sequence[Standing]) -> tuple[list[Pair], dict[str, Rank]]:
    """Compare entries with each other, and return their pairs and their ranks by name."""
    successes = {entry.name: (entry.outcomes == Outcome.SUCCESS).astype(float)[None] for entry in entries}
    pairs = compare_all(successes, board.weights, _blocks(entries))
    return pairs, ranks([*successes], pairs)


def _blocks(entries: Sequence[Standing]) -> Sequence[Int[np.ndarray, "case"]] | None:
    """Return the blocks of recorded time of the cases of each scenario; None without recorded pedestrians.

    All entries drove the same cases, so that a scenario has the same blocks in all of them.
    """
    blocks = {name: block for entry in entries for name, block in entry.blocks.items()}
    if not blocks:
        return None
    no_blocks = np.zeros(entries[0].outcomes.shape[1], np.int64)
    return [blocks.get(name, no_blocks) for name in entries[0].scenarios]


def _limit_ranked(entries: Sequence[Standing]) -> list[Standing]:
    """Return the same entries, with a reason for entries of a submitter beyond `MAX_RANKED`."""
    ranked: Counter[str] = Counter()
    limited = []
    for entry in entries:
        submitter = entry.entry.submitter
        ranked[submitter] += not entry.reason and not entry.is_baseline
        if not entry.reason and not entry.is_baseline and ranked[submitter] > MAX_RANKED:
            reason = f"more than {MAX_RANKED} of one submitter"
            entry = replace(entry, reason=reason, explanation="Other entries of its submitter are ranked here.")
        limited.append(entry)
    return limited


def _standing(board: Board, entry: Entry, season: Season | None) -> Standing:
    verification, doubt, pending = None, "there is no season", is_pending(entry, board)
    if season and not pending:
        try:
            verification = read_verification(entry, board, season)
        except Unverified as error:
            doubt = str(error)
    reason, explanation = _why_unranked(board, entry, pending, verification or doubt)
    runs = {} if pending else _read_runs(board, entry.public, board.spec.public_cases, set(board.metrics))
    public = outcomes = _outcomes(board, runs, board.spec.public_cases)
    if season and verification and verification.figures:
        runs = _read_runs(board, verification_folder(entry, season), board.spec.cases, set())
        outcomes = _outcomes(board, runs, board.spec.cases)
        measured: Estimates = {
            scenario: {metric: figure.estimate for metric, figure in figures.items()}
            for scenario, figures in verification.figures.items()
        }
    else:
        measured = {name: run.summary() for name, run in runs.items()}
    scenarios = {name: measured.get(name, {}) for name in board.scenarios}
    return Standing(
        entry,
        verification,
        outcomes,
        public,
        {name: run.block for name, run in runs.items() if run.block is not None},
        scenarios,
        dict.fromkeys(board.metrics, UNDEFINED) if pending else board_figures(board, scenarios),
        {} if pending else success_by_family(board, scenarios),
        pending,
        reason,
        explanation,
    )


def _outcomes(board: Board, runs: Mapping[str, Episodes], cases: int) -> Int[np.ndarray, "scenario case"]:
    """Return the outcomes of the cases of each scenario, `RUNNING` where a scenario has no run."""
    none = np.full(cases, Outcome.RUNNING, np.int64)
    return np.array([runs[name].outcome if name in runs else none for name in board.scenarios])


def _read_runs(board: Board, folder: Path, cases: int, metrics: set[str]) -> dict[str, Episodes]:
    """Read the episodes in a folder by scenario. Raises InputError if there are other cases, or metrics are missing."""
    runs = read_episodes(board, folder)
    for name, run in runs.items():
        if len(run) != cases or not metrics <= run.columns.keys():
            raise InputError(f"{folder / name} must have {cases} cases with {', '.join(metrics)}")
    return runs


def success_by_family(board: Board, scenarios: Estimates) -> dict[str, Estimate]:
    """Return the mean success in each family of scenarios; arguments as for `board_figures`."""
    return {
        family: mean_over_scenarios(
            np.full(len(names), 1.0 / len(names)), [scenarios[name].get("success_rate") for name in names]
        )
        for family, names in board.spec.families.items()
    }


def _why_unranked(board: Board, entry: Entry, pending: bool, verification: Verification | str) -> tuple[str, str]:
    """Return the reason why an entry has no rank, in a few words and in a sentence; both are empty if it has one.

    Args:
        board: The board.
        entry: The entry.
        pending: True if it must be submitted again.
        verification: The verification of the season, or the reason why none counts.
    """
    if not board.spec.ranked:
        return "not ranked", "This board has no ranks: it shows results only."
    if entry.spec.privileged:
        return "privileged", "It uses hidden state of the simulator, such as the pedestrians' true next velocities."
    if entry.card.ablation:
        return "ablation", "Its authors say that it is a variant made for comparison."
    if pending:
        return "pending", PENDING
    if isinstance(verification, str):
        return "reported only", REPORTED_ONLY.format(verification)
    if verification.verdict != Verdict.RERUN:
        return str(verification.verdict), verification.reason
    return "", ""
