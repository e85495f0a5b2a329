"""Verifies an entry: replays its public runs, runs its planner on held-out cases, and compares.

The public cases are simulated from their recorded commands in this process, which never loads the planner. The planner
drives the held-out cases in a separate process. docs/trust.md lists the attacks that a verification cannot detect.
"""

from __future__ import annotations

import datetime
import secrets
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from crowdbench import Cases, Episodes, InputError, Scenario
from crowdbench.isolation import PROCESS, describe_limits, level
from crowdbench.results import COMMANDS, EPISODES, RunResult, read_result
from crowdbench.runs import Progress, code, replay_run
from crowdbench.sim import SIMULATOR
from crowdbench.utils import MachineFault, plain
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.board_runs import (
    CaseSet,
    EntryPlanner,
    InUse,
    drive,
    driven_scenarios,
    lock_runs,
    read_episodes,
)
from crowdbench_leaderboards.calibrated_time import NotTimed, time_decisions
from crowdbench_leaderboards.consistency_test import lower_than_claimed
from crowdbench_leaderboards.entry import Entry, check_board_name, check_names, check_unchanged, read_entry
from crowdbench_leaderboards.means import check_networks_differ, method_cases, other_networks, summarize_method
from crowdbench_leaderboards.memory_limit import limit_memory
from crowdbench_leaderboards.season import Season
from crowdbench_leaderboards.signature import find_signer
from crowdbench_leaderboards.verdict import (
    Unverified,
    Verdict,
    Verification,
    read_verification,
    verification_folder,
    write_verification,
)

MAX_MEMORY = 4e9
"""Bytes that the replay of an entry's public runs may take."""


class NotReproduced(InputError):
    """Raised if commands do not reproduce the public runs of an entry. The message states the difference."""


def count_cases(entry: Entry, board: Board, cases: Cases) -> int:
    """Return how many cases a verification replays and drives; `cases` are the cases of each scenario."""
    count = (len(cases) + board.spec.public_cases) * len(board.scenarios)
    return count + len(other_networks(entry, board)) * len(method_cases(cases))


def verify(
    entry: Entry, board: Board, work: Path, cases: Cases | None = None, progress: Progress | None = None
) -> Verification:
    """Verify an entry on cases of a seed that is drawn now, and record nothing.

    Args:
        entry: The entry.
        board: Its board.
        work: The folder of temporary files.
        cases: The cases of each scenario; as many as in a season if None.
        progress: Called after each step with the progress of the step, as a fractional number of episodes.

    Raises:
        MachineFault: `work` cannot be written, or crowdbench has changed meanwhile.
        InputError: The entry belongs to another board or to another digest of the board, its name is taken, or no
            sandbox is available.
    """
    _check_board(entry, board)
    work.mkdir(parents=True, exist_ok=True)
    case_set = CaseSet(board, cases or board.cases, secrets.randbits(63))
    with tempfile.TemporaryDirectory(prefix=f"verify-{board.name}-{entry.name}-", dir=work) as folder:
        return _verify(entry, case_set, Path(folder) / "runs", progress)


def verify_in_season(
    entry: Entry, board: Board, work: Path, season: Season, key: Path, progress: Progress | None = None
) -> Verification:
    """Verify an entry on the cases of a season, and record and sign the verdict.

    Args:
        entry: The entry.
        board: Its board.
        work: The folder that keeps finished runs until the verdict.
        season: The season.
        key: The key of the maintainer who verifies the entry, see `signature.sign`.
        progress: As for `verify`.

    Raises:
        MachineFault: `work` or the verdict cannot be written, or crowdbench has changed meanwhile.
        InputError: The entry belongs to another board, takes no part in the season or was verified in it before, the
            key belongs to no maintainer, or no sandbox is available.
        KeyboardInterrupt: The user interrupted it. The same call goes on with finished batches.
    """
    by = find_signer(key, season.root)
    _check_season(entry, board, season)
    case_set = CaseSet(board, board.cases, season.seed(board.name))
    runs = work / f"verify-{board.name}-{entry.name}"
    with lock_runs(runs):
        entry = read_entry(entry.directory)
        _check_season(entry, board, season)  # another process may have verified it
        verification = _verify(entry, case_set, runs, progress, by, season.spec.name)
        write_verification(verification_folder(entry, season), verification, board, runs, key)
        shutil.rmtree(runs, ignore_errors=True)
    return verification


def _check_board(entry: Entry, board: Board) -> None:
    check_board_name(entry, board)
    if entry.spec.board_digest != board.digest:
        raise InputError(
            f"{entry.directory} was made for another simulator, other rules or scenarios of the board {board.name} "
            f"({entry.spec.board_digest[:12]}) than these ({board.digest[:12]}): submit it again"
        )
    spec = entry.spec
    check_names(entry.name, spec.planner, entry.card, spec.submitted_by, entry.directory.parent.parent)
    if level() == PROCESS:
        raise InputError("an entry is verified in a sandbox, for which bubblewrap is needed: install it")


def _check_season(entry: Entry, board: Board, season: Season) -> None:
    _check_board(entry, board)
    if not season.takes_part(board.name, entry.name, entry.digest):
        raise InputError(
            f"{entry.directory} takes no part in the season {season.spec.name}: it was not among the entries that were "
            "frozen, or was changed since"
        )
    if is_verified(entry, board, season):
        raise InUse(f"{entry.directory} was verified in the season {season.spec.name} before, which is done once")


def is_verified(entry: Entry, board: Board, season: Season) -> bool:
    """Check if an entry has a valid verification in a season.

    Args:
        entry: The entry.
        board: Its board.
        season: The season.
    """
    try:
        return bool(read_verification(entry, board, season))
    except Unverified:
        return False


def _verify(
    entry: Entry, case_set: CaseSet, runs: Path, progress: Progress | None, by: str = "", season: str = ""
) -> Verification:
    measured: dict[str, Any]
    try:
        with limit_memory(MAX_MEMORY):
            _replay_public_runs(entry, case_set.board, progress)
        measured = _run_again(entry, case_set, runs, progress)
    except MachineFault:
        raise
    except MemoryError:
        reason = f"to replay its public runs takes more than {MAX_MEMORY / 1e9:g} GB of memory"
        measured = {"verdict": Verdict.NOT_REPRODUCED, "reason": reason}
    except NotReproduced as error:
        measured = {"verdict": Verdict.NOT_REPRODUCED, "reason": str(error)}
    except InputError as error:
        measured = {"verdict": Verdict.REFUSED, "reason": str(error)}
    assert case_set.seed is not None  # it is None only for public cases
    return Verification(
        by=by,
        on=datetime.datetime.now(datetime.UTC).date().isoformat(),
        board=case_set.board.name,
        board_digest=case_set.board.digest,
        entry=entry.name,
        entry_digest=entry.digest,
        season=season,
        seed=case_set.seed,
        level=level(),
        **measured,
    )


def _replay_public_runs(entry: Entry, board: Board, progress: Progress | None) -> None:
    """Simulate the public cases from their commands. Raises NotReproduced if the runs of the entry differ."""
    scenarios = {scenario.name: scenario for scenario in board.load(None)}
    reported, folders = set(entry.spec.reported), {path.name for path in entry.public.glob("*")}
    if not reported or reported != folders or not reported <= scenarios.keys():
        raise NotReproduced("the scenarios of its reported figures differ from its public runs or from this board")
    for name in driven_scenarios(board, entry.public):
        try:
            _replay(entry, board, scenarios[name], progress)
        except MachineFault:
            raise
        except InputError as error:
            raise NotReproduced(f"{name}: {error}") from None


def _replay(entry: Entry, board: Board, scenario: Scenario, progress: Progress | None) -> None:
    _check_size(entry.public / scenario.name / COMMANDS, len(board.public_cases), scenario.rules.max_steps)
    run = read_public_run(entry, board, scenario)
    run.check(rows_only=True)
    reported, metrics = entry.spec.reported[scenario.name], run.result["metrics"]
    if reported.keys() != metrics.keys():
        raise InputError(f"the reported figures differ from {EPISODES}")
    means = [metrics[name]["mean"] for name in reported]
    # The last digits of a mean depend on the version of NumPy.
    if not np.allclose(
        np.array([*reported.values()], float), np.array(means, float), rtol=1e-9, atol=0.0, equal_nan=True
    ):
        raise InputError(f"the reported figures differ from {EPISODES}")
    if differences := replay_run(run, scenario, board.metrics, progress).differences:
        raise InputError(differences[0])


def _check_size(path: Path, cases: int, steps: int) -> None:
    """Check that a file of commands is not larger than a run allows, before it is decompressed.

    Args:
        path: The file. `read_commands` reports a file that is missing or not in Parquet format.
        cases: Number of cases of the run.
        steps: Largest number of steps of a case.

    Raises:
        InputError: It is larger.
    """
    try:
        with path.open("rb") as file, pq.ParquetFile(file) as parquet:
            groups = [parquet.metadata.row_group(index) for index in range(parquet.metadata.num_row_groups)]
            rows = parquet.metadata.num_rows
    except (pa.ArrowException, OSError, ValueError):
        return
    size = sum(group.column(index).total_uncompressed_size for group in groups for index in range(group.num_columns))
    most = 1_000_000 + 2 * 16 * cases * (steps + 1)  # twice the size of two float64 numbers per step
    if rows > cases or size > most:
        raise InputError(
            f"{path} holds {rows} cases in {size / 1e6:.0f} MB, but a run of {cases} cases has as many in "
            f"{most / 1e6:.0f} MB at most"
        )


def read_public_run(entry: Entry, board: Board, scenario: Scenario) -> RunResult:
    """Read the run of an entry on the public cases of a scenario. Its figures are not checked.

    Raises:
        InputError: A file is missing or damaged, or has other metrics than the board.
    """
    folder = entry.public / scenario.name
    episodes = Episodes.read(folder / EPISODES)
    if episodes.columns.keys() != board.metrics.keys():
        raise InputError(f"{folder / EPISODES} must have the metrics {', '.join(board.metrics)}")
    run = {"scenario": scenario.digest, "cases": str(board.public_cases), "code": code(), "simulator": SIMULATOR}
    result = {
        "run": {**run, "metrics": dict.fromkeys(board.metrics)},
        "scenario": scenario.table,
        "stated": {"versions": entry.spec.environment},
        "outcomes": episodes.counts(),
        "recorded": 0,
        "files": {},  # neither tracks nor a recording: the cases are simulated again from the commands
        "metrics": plain(episodes.summary()),
    }
    return RunResult(folder, result, episodes)


def _run_again(entry: Entry, case_set: CaseSet, runs: Path, progress: Progress | None) -> dict[str, Any]:
    """Run the planner on held-out cases, and compare with the public ones.

    Returns:
        The verdict, its reason and the measurements, see `Verification`.

    Raises:
        InputError: The planner breaks its contract or a limit, or differs from the submitted planner.
    """
    board, spec = case_set.board, entry.spec
    check_unchanged(entry)
    planner = EntryPlanner(entry.directory, spec.planner, spec.options)
    failures = drive(planner, case_set, runs, progress)
    for name in [name for name in failures if name in spec.reported]:
        raise InputError(f"{name}: {failures[name]}")
    results = {name: read_result(runs / name) for name in driven_scenarios(board, runs)}
    for name, result in results.items():
        is_same = result["run"]["planner"]["facts"] == spec.facts.get(name) or name not in spec.reported
        stated = result["stated"]
        if not is_same or (stated["privileged"], stated["raw"]) != (spec.privileged, spec.raw):
            raise InputError(f"{name}: the planner's facts differ from the facts of the entry")
    measured: dict[str, Any] = {"figures": {name: result["metrics"] for name, result in results.items()}}
    if networks := other_networks(entry, board):
        cases = CaseSet(board, method_cases(case_set.cases), case_set.seed)
        folders = [runs / "networks" / str(number) for number in range(len(networks))]
        for network, folder in zip(networks, folders, strict=True):
            drive(network, cases, folder, progress)
        check_networks_differ(board, [runs, *folders], cases.cases)
        measured["method"] = summarize_method(board, [runs, *folders], len(cases.cases))
    try:
        measured["decision_time"] = time_decisions(planner, case_set, runs)
    except NotTimed as error:
        measured["untimed"] = str(error)
    public, held_out = read_episodes(board, entry.public), read_episodes(board, runs)
    if differences := lower_than_claimed(public, {name: held_out[name] for name in public}):
        return {"verdict": Verdict.LOWER, "reason": "; ".join(differences), **measured}
    how = f"in a sandbox without network, which shows it its own files alone, limited in {describe_limits()}"
    reason = f"the recorded commands lead to the reported figures; ran {how}"
    return {"verdict": Verdict.RERUN, "reason": reason, **measured}
