"""The standings of a board: its entries with their ranks, or the reasons why they have none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from crowdbench import Episodes, InputError
from crowdbench.metrics import OF_FLEETS, UNDEFINED, Estimate, Pair, Rank
from crowdbench_leaderboards.board import Board, others_in
from crowdbench_leaderboards.entries import BoardEntries
from crowdbench_leaderboards.entry import PUBLIC, Entry, is_pending
from crowdbench_leaderboards.episode_table import read_table
from crowdbench_leaderboards.means import board_figures, case_means
from crowdbench_leaderboards.pages.ranking import BLOCKS, Candidate, rank_all
from crowdbench_leaderboards.season import MAX_RANKED, Season
from crowdbench_leaderboards.verdict import (
    DecisionTime,
    Method,
    Unverified,
    Verdict,
    Verification,
    read_verification,
)

SHOWN = [
    *("success_rate", "at_fault_rate", "collision_rate", "sct", "navigation_time"),
    *("intimate_zone", "imposed_delay", "imposed_delay_positive", "jerk", "worst_score"),
]
"""The metrics that the table of a board shows beside the score."""

PENDING = "Its board has changed since: it must be submitted again."
REPORTED_ONLY = "Figures are reported by its authors, on public cases: {}."


@dataclass(frozen=True)
class Standing:
    """An entry on its board.

    Attributes:
        entry: The entry.
        is_baseline: True if it is a planner that ships, entered by the maintainers.
        is_of_others: True if it is a network of others, entered by the maintainers.
        verification: The verification of the season; None if none counts.
        episodes: The cases of the season by scenario, or else the public cases; none in scenarios that the planner
            cannot drive.
        public: The public cases by scenario.
        figures: The means over the board, with intervals; undefined for a pending entry.
        is_pending: True if it must be submitted again.
        reason: Reason why it has no rank, in a few words; empty if it has a rank.
        explanation: The same in a sentence.
        rank: Its rank in its block.
        block: The name of its block, see `ranking.BLOCKS`; empty without a rank.
    """

    entry: Entry
    is_baseline: bool
    is_of_others: bool
    verification: Verification | None
    episodes: Mapping[str, Episodes]
    public: Mapping[str, Episodes]
    figures: Mapping[str, Estimate]
    is_pending: bool
    reason: str
    explanation: str
    rank: Rank | None = None
    block: str = ""

    @property
    def name(self) -> str:
        """Name of the entry."""
        return self.entry.name

    @property
    def submitter(self) -> str:
        """The account that has submitted it, or its kind."""
        return "others'" if self.is_of_others else "baseline" if self.is_baseline else self.entry.account

    @property
    def is_measured(self) -> bool:
        """True if the figures were measured in the season; otherwise they are reported by the authors."""
        return self.verification is not None and bool(self.verification.episodes)

    @property
    def decision_time(self) -> DecisionTime | None:
        """Time of decisions, if it was measured in the season."""
        return self.verification.decision_time if self.verification else None

    @property
    def method(self) -> Method | None:
        """Means of the method, if they were measured in the season."""
        return self.verification.method if self.verification else None

    def scenario_figures(self) -> dict[str, dict[str, Estimate]]:
        """Return the means with their intervals by scenario and metric: metrics of all vehicles if it drives all."""
        left_out = {name: OF_FLEETS if others_in(name) else {} for name in self.episodes}
        return {name: own.without(left_out[name]).summary() for name, own in self.episodes.items()}

    def values(self, board: Board, metric: str) -> Float[np.ndarray, "scenario case"]:
        """Return a metric in each case, the mean over its vehicles; 0 in scenarios that the planner cannot drive."""
        means = {name: case_means(own, metric) for name, own in self.episodes.items()}
        none = np.zeros(len(next(iter(means.values()))))
        return np.array([means.get(name, none) for name in board.scenarios])


@dataclass(frozen=True)
class Standings:
    """All entries of a board.

    Attributes:
        board: The board.
        ranked: The ranked entries: block A first, and in a block by rank and score.
        others: The others, by name.
        bad: The reasons of entries that are left out, by name.
        withdrawn: The accounts of entries that were frozen and are no longer there, by name.
        pairs: The ranked entries of each block compared with each other.
    """

    board: Board
    ranked: Sequence[Standing]
    others: Sequence[Standing]
    bad: Mapping[str, str]
    withdrawn: Mapping[str, str]
    pairs: Sequence[Pair]

    @property
    def entries(self) -> Sequence[Standing]:
        """Ranked and other entries."""
        return [*self.ranked, *self.others]

    @property
    def blocks(self) -> dict[str, list[Standing]]:
        """The ranked entries by block, without empty blocks."""
        found = {block: [one for one in self.ranked if one.block == block] for block in BLOCKS}
        return {block: own for block, own in found.items() if own}

    @property
    def shown(self) -> Sequence[str]:
        """Metrics beside the score that any ranked entry has, or any entry if none is ranked."""
        entries = self.ranked or self.others
        figures = [entry.figures for entry in entries]
        return [name for name in SHOWN if any(np.isfinite(own.get(name, UNDEFINED).mean) for own in figures)]

    @property
    def has_methods(self) -> bool:
        """True if the method of some entry was measured."""
        return any(entry.method for entry in self.entries)


def standings(board: Board, entries: BoardEntries, season: Season | None) -> Standings:
    """Rank the entries of a board.

    Args:
        board: The board.
        entries: Its entries.
        season: The season whose verifications rank; None if there is none yet.
    """
    bad, every = dict(entries.bad), []
    for entry in entries.good:
        try:
            every.append(_standing(board, entry, entries, season))
        except InputError as error:
            bad[entry.name] = str(error)
    candidates = {one.name: one for one in every if not one.reason}
    ranking = rank_all(
        [
            Candidate(
                name,
                one.entry.account or f"maintainers: {name}",
                one.values(board, "score"),
                np.array([_of_first(own).columns["at_fault_rate"].astype(float) for own in one.episodes.values()]),
            )
            for name, one in candidates.items()
        ],
        board.weights,
        blocks_of_time(board, list(candidates.values())),
    )
    ranked = [replace(candidates[name], rank=ranking.rank[name], block=ranking.block[name]) for name in ranking.order]
    others = sorted((one for one in every if one.reason), key=lambda one: one.name)
    present = {one.name for one in every}
    frozen = season.frozen.get(board.name, {}) if season else {}
    withdrawn = {name: each.account for name, each in frozen.items() if name not in present | bad.keys()}
    return Standings(board, ranked, others, bad, withdrawn, ranking.pairs)


def _of_first(episodes: Episodes) -> Episodes:
    """Return the episodes of the first vehicle of each case."""
    return episodes if episodes.vehicle is None else episodes.of_first_vehicle()


def blocks_of_time(board: Board, entries: Sequence[Standing]) -> list[Int[np.ndarray, "case"]] | None:
    """Return the blocks of recorded time of the cases of each scenario; None without recorded pedestrians.

    All entries drove the same cases, so that a scenario has the same blocks in all of them.
    """
    blocks = {name: own.block for one in entries for name, own in one.episodes.items() if own.block is not None}
    if not blocks or board.is_fleet:
        return None
    none = np.zeros(board.spec.cases, np.int64)
    return [blocks.get(name, none) for name in board.scenarios]


def _standing(board: Board, entry: Entry, entries: BoardEntries, season: Season | None) -> Standing:
    verification, doubt, pending = None, "there is no season", is_pending(entry, board)
    public = {} if pending else read_table(entry.directory / PUBLIC, board, board.public_cases)
    episodes: Mapping[str, Episodes] = public
    if season and not pending:
        try:
            verification, measured = read_verification(entry, board, season)
            episodes = measured or public
        except Unverified as error:
            doubt = str(error)
    reason, explanation = _why_unranked(board, entry, season, pending, verification or doubt)
    listed = None if entry.account else entries.shipped.get(entry.name)
    figures = {name: own.summary() for name, own in episodes.items()}
    all_figures = {name: figures.get(name, {}) for name in board.scenarios}
    return Standing(
        entry=entry,
        is_baseline=listed is not None,
        is_of_others=listed is not None and listed.others,
        verification=verification,
        episodes=episodes,
        public=public,
        figures=dict.fromkeys(board.metrics, UNDEFINED) if pending else board_figures(board, all_figures),
        is_pending=pending,
        reason=reason,
        explanation=explanation,
    )


def _why_unranked(
    board: Board, entry: Entry, season: Season | None, pending: bool, verification: Verification | str
) -> tuple[str, str]:
    """Return the reason why an entry has no rank, in a few words and in a sentence; both are empty if it has one.

    Args:
        board: The board.
        entry: The entry.
        season: The season, if there is one.
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
    if season and season.takes_part(board.name, entry.name, entry.digest) and not season.ranks(board.name, entry.name):
        return "not named", f"Its account named other entries for ranks before the freeze, {MAX_RANKED} at most."
    if isinstance(verification, str):
        return "reported only", REPORTED_ONLY.format(verification)
    if verification.verdict != Verdict.RERUN:
        return str(verification.verdict), verification.reason
    return "", ""
