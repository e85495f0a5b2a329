"""Verifies an entry: replays its public cases, drives the ranked cases, and compares.

The public cases are simulated from their recorded commands in this process, which never loads the planner. The planner
drives the ranked cases in a separate process. docs/trust.md lists the attacks that a verification cannot detect.
"""

from __future__ import annotations

import datetime
import secrets
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench import Cases, Episodes, InputError, Scenario, rollout
from crowdbench.isolation import PROCESS, describe_limits, level
from crowdbench.results import COMMANDS, RunResult, commands_table, read_commands, write_commands
from crowdbench.runs import Playback, Progress, code, replay_run
from crowdbench.sim import SIMULATOR
from crowdbench.utils import Executor, MachineFault, plain
from crowdbench_leaderboards.board import Board, others_in
from crowdbench_leaderboards.board_runs import CaseSet, EntryPlanner, InUse, drive, lock_runs
from crowdbench_leaderboards.consistency_test import lower_than_claimed
from crowdbench_leaderboards.entries import check_entry
from crowdbench_leaderboards.entry import PUBLIC, Entry, read_entry
from crowdbench_leaderboards.episode_table import MAX_MEMORY, read_table
from crowdbench_leaderboards.means import check_networks_differ, method_cases, method_networks, summarize_method
from crowdbench_leaderboards.memory_limit import limit_memory
from crowdbench_leaderboards.planner_files import Files, locate_named_files
from crowdbench_leaderboards.ranked_run import MIN_IN_TIME, RankedRun, RankedTask, drive_all, read_ranked
from crowdbench_leaderboards.season import Season
from crowdbench_leaderboards.signature import find_signer
from crowdbench_leaderboards.verdict import (
    DecisionTime,
    Unverified,
    Verdict,
    Verification,
    read_verification,
    write_verification,
)


class NotReproduced(InputError):
    """Raised if commands do not reproduce the public cases of an entry. The message states the difference."""


@dataclass(frozen=True)
class Verifier:
    """The setting of verifications.

    Attributes:
        board: The board.
        root: The folder of boards.
        work: The folder of unfinished runs.
        external: The files outside of entries that their options name.
        executor: Workers that drive the ranked cases, if any.
        progress: Called with the progress, in cases.
    """

    board: Board
    root: Path
    work: Path
    external: Files
    executor: Executor | None = None
    progress: Progress = lambda done: None

    def runs(self, entry: Entry) -> Path:
        """Return the folder of the unfinished runs of an entry in a season."""
        return self.work / f"verify-{self.board.name}-{entry.name}"

    def tasks(self, entry: Entry, case_set: CaseSet, runs: Path) -> list[RankedTask]:
        """Return the ranked cases of an entry, scenario by scenario."""
        planner = EntryPlanner(entry.directory, entry.spec.planner, entry.spec.options, self.external)
        names = self.board.scenarios
        return [RankedTask(planner, case_set, name, entry.digest, runs / "ranked" / f"{name}.jsonl") for name in names]

    def verify(self, entry: Entry, cases: Cases | None = None) -> tuple[Verification, dict[str, Episodes]]:
        """Verify an entry on cases of a seed that is drawn now, and record nothing.

        Args:
            entry: The entry.
            cases: The cases of each scenario; as many as in a season if None.

        Returns:
            The verification, and the ranked cases by scenario.

        Raises:
            MachineFault: `work` cannot be written, or crowdbench has changed meanwhile.
            InputError: The entry belongs to another board or to another digest of the board, its name is taken, or no
                sandbox is available.
        """
        self._check(entry)
        self.work.mkdir(parents=True, exist_ok=True)
        case_set = CaseSet(self.board, cases or self.board.cases, secrets.randbits(63))
        with tempfile.TemporaryDirectory(prefix=f"verify-{self.board.name}-{entry.name}-", dir=self.work) as folder:
            return self._verify(entry, case_set, Path(folder), "", "")

    def verify_in_season(self, entry: Entry, season: Season, key: Path) -> Verification:
        """Verify an entry on the cases of a season, and record and sign the verdict.

        Args:
            entry: The entry.
            season: The season.
            key: The key of the maintainer who verifies the entry, see `signature.sign`.

        Raises:
            MachineFault: `work` or the verdict cannot be written, or crowdbench has changed meanwhile.
            InputError: The entry belongs to another board, takes no part in the season or was verified in it before,
                the key belongs to no maintainer, or no sandbox is available.
            KeyboardInterrupt: The user interrupted it. The same call goes on with finished cases.
        """
        by = find_signer(key, season.root)
        self._check_season(entry, season)
        runs = self.runs(entry)
        with lock_runs(runs):
            entry = read_entry(entry.directory)
            self._check_season(entry, season)  # another process may have verified it
            case_set = CaseSet(self.board, self.board.cases, season.seed(self.board.name))
            verification, episodes = self._verify(entry, case_set, runs, by, season.spec.name)
            verification = write_verification(entry.directory, verification, episodes, key)
            shutil.rmtree(runs, ignore_errors=True)
        return verification

    def count_cases(self, entry: Entry, cases: Cases) -> int:
        """Return how many cases a verification replays and drives; `cases` are the cases of each scenario."""
        count = (len(cases) + self.board.spec.public_cases) * len(self.board.scenarios)
        return count + len(method_networks(entry, self.board)) * len(method_cases(cases))

    def _check(self, entry: Entry) -> None:
        check_entry(entry, self.board, self.root, [])
        if entry.spec.board_digest != self.board.digest:
            raise InputError(
                f"{entry.directory} was made for another simulator, other rules or scenarios of the board "
                f"{self.board.name} ({entry.spec.board_digest[:12]}) than these ({self.board.digest[:12]}): submit it "
                "again"
            )
        locate_named_files(entry.spec.options, entry.directory, self.external)  # raises if a file is not given
        if level() == PROCESS:
            raise InputError("an entry is verified in a sandbox, for which bubblewrap is needed: install it")

    def _check_season(self, entry: Entry, season: Season) -> None:
        """Raise InputError if an entry cannot be verified in a season."""
        self._check(entry)
        if not season.takes_part(self.board.name, entry.name, entry.digest):
            raise InputError(
                f"{entry.name} takes no part in the season {season.spec.name}: it was not frozen in this form"
            )
        if is_verified(entry, self.board, season):
            raise InUse(f"{entry.name} was verified in the season {season.spec.name} before, which is done once")

    def _verify(
        self, entry: Entry, case_set: CaseSet, runs: Path, by: str, season: str
    ) -> tuple[Verification, dict[str, Episodes]]:
        """Verify an entry, and return the verdict with the ranked cases by scenario.

        Args:
            entry: The entry.
            case_set: The ranked cases.
            runs: The folder of runs.
            by: The maintainer who signs; empty without one.
            season: The name of the season; empty without one.
        """
        episodes: dict[str, Episodes] = {}
        measured: dict[str, Any] = {}
        try:
            public = replay_public(entry, self.board, self.progress)
            episodes, measured = self._run_again(entry, case_set, runs, public)
            found = lower_than_claimed(public, {name: episodes[name] for name in public})
            how = f"in a sandbox without network, which shows it its own files alone, limited in {describe_limits()}"
            verdict, reason = Verdict.RERUN, f"the recorded commands lead to the public results; ran {how}"
            if found:
                verdict, reason = Verdict.LOWER, "; ".join(found)
        except (MachineFault, InUse):
            raise
        except NotReproduced as error:
            verdict, reason = Verdict.NOT_REPRODUCED, str(error)
        except InputError as error:
            verdict, reason = Verdict.REFUSED, str(error)
        verification = Verification(
            verdict=verdict,
            reason=reason,
            by=by,
            on=datetime.datetime.now(datetime.UTC).date().isoformat(),
            board=self.board.name,
            board_digest=self.board.digest,
            entry=entry.name,
            entry_digest=entry.digest,
            season=season,
            seed=case_set.seed or 0,
            level=level(),
            **measured,
        )
        return verification, episodes

    def _run_again(
        self, entry: Entry, case_set: CaseSet, runs: Path, public: Mapping[str, Episodes]
    ) -> tuple[dict[str, Episodes], dict[str, Any]]:
        """Drive the ranked cases, and return them by scenario with the measurements.

        Raises:
            InputError: The planner breaks its contract or a limit, or differs from the submitted planner.
        """
        tasks = self.tasks(entry, case_set, runs)
        drive_all(tasks, self.progress, self.executor)
        ranked = {task.scenario: read_ranked(task) for task in tasks}
        for name in public:
            if ranked[name].failed:
                raise InputError(f"{name}: {ranked[name].failed}")
            about = {
                "facts": entry.spec.facts.get(name),
                "privileged": entry.spec.privileged,
                "raw": entry.spec.raw,
            }
            if ranked[name].planner != about:
                raise InputError(f"{name}: the planner's facts differ from the facts of the entry")
        episodes = {name: run.episodes for name, run in ranked.items() if run.episodes is not None}
        driven = {name: ranked[name] for name in episodes}
        measured: dict[str, Any] = {"decision_time": _decision_time(case_set, driven)}
        if networks := method_networks(entry, self.board):
            cases = CaseSet(self.board, method_cases(case_set.cases), case_set.seed)
            folders = [runs / "networks" / str(number) for number in range(len(networks))]
            for network, folder in zip(networks, folders, strict=True):
                drive(network, cases, folder, self.progress)
            check_networks_differ(self.board, folders, cases.cases)
            measured["method"] = summarize_method(self.board, folders, len(cases.cases))
        return episodes, measured


def _decision_time(case_set: CaseSet, ranked: Mapping[str, RankedRun]) -> DecisionTime:
    """Return the time of all decisions in the ranked cases."""
    steps = {scenario.name: scenario.rules.dt for scenario in case_set.scenarios}
    seconds = [each for run in ranked.values() for each in run.seconds]
    in_time = float(np.mean([each < steps[name] for name, run in ranked.items() for each in run.seconds]))
    p99 = 1e3 * float(np.percentile(seconds, 99))
    return DecisionTime(p99_ms=round(p99, 3), in_time=round(in_time, 5), is_real_time=in_time >= MIN_IN_TIME)


def is_verified(entry: Entry, board: Board, season: Season) -> bool:
    """Check if an entry has a valid verification of a season."""
    try:
        read_verification(entry, board, season)
    except Unverified:
        return False
    return True


def replay_public(entry: Entry, board: Board, progress: Progress | None = None) -> dict[str, Episodes]:
    """Simulate the public cases of an entry from their commands, and return its episodes by scenario.

    Raises NotReproduced if the episodes in the entry differ.
    """
    scenarios = {scenario.name: scenario for scenario in board.load(None)}
    with tempfile.TemporaryDirectory() as temporary:
        try:
            public = read_table(entry.directory / PUBLIC, board, board.public_cases, Path(temporary))
        except InputError as error:
            raise NotReproduced(str(error)) from None
        for name, episodes in public.items():
            try:
                with limit_memory(MAX_MEMORY):
                    run = public_run(entry, board, scenarios[name], episodes, Path(temporary) / name)
                    run.check(rows_only=True)
                    differences = replay_run(run, scenarios[name], board.metrics, progress).differences
            except MachineFault:
                raise
            except (InputError, MemoryError) as error:
                raise NotReproduced(f"{name}: {error or 'it takes too much memory'}") from None
            if differences:
                raise NotReproduced(f"{name}: {differences[0]}")
    return public


def public_run(entry: Entry, board: Board, scenario: Scenario, episodes: Episodes, folder: Path) -> RunResult:
    """Return the run of an entry on the public cases of a scenario.

    Args:
        entry: The entry.
        board: The board.
        scenario: The scenario.
        episodes: Its episodes as the entry has them.
        folder: The folder with its commands.

    Raises:
        InputError: A command is none that a vehicle can execute, or a case has too many.
    """
    run: dict[str, Any] = {"scenario": scenario.digest, "cases": str(board.public_cases)}
    run |= {"code": code(), "simulator": SIMULATOR}
    if others := others_in(scenario.name):
        run["others"] = {"name": others}
        _add_others(scenario, board.public_cases, folder / COMMANDS)
    planner = {"name": entry.name, "options": entry.spec.options}
    result = {
        "run": {**run, "planner": planner, "replanning": {}, "metrics": dict.fromkeys(board.metrics)},
        "scenario": {**scenario.table, "name": scenario.name},
        "stated": {"versions": entry.spec.environment},
        "outcomes": episodes.counts(),
        "recorded": 0,
        "files": {},  # neither tracks nor a recording: the cases are simulated again from the commands
        "metrics": plain(episodes.summary()),
    }
    return RunResult(folder, result, episodes)


def _add_others(scenario: Scenario, cases: Cases, path: Path) -> None:
    """Add the commands of the other vehicles, which a planner that ships drives, to the file of the first."""
    commands, most = read_commands(path), scenario.rules.max_steps
    if (commands.steps > most).any():
        raise InputError(f"a case has more than {most} commands")
    trace = rollout(
        Playback(commands.pad(cases, most)), scenario, cases, others=others_in(scenario.name), undisturbed=False
    )
    write_commands([commands_table(trace)], path)
