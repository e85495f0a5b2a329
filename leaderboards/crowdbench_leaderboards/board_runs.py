"""Runs of an entry's planner on a board: a folder with a directory for each scenario."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from filelock import Timeout

from crowdbench import Cases, Driver, Episodes, InputError, Scenario, load_planner
from crowdbench.isolation import IsolatedPlanner, ResourceLimits
from crowdbench.results import EPISODES, check_result
from crowdbench.runs import Progress, Run, RunSpec, identify, make_each, make_run
from crowdbench.utils import hold_lock
from crowdbench_leaderboards.board import Board, others_in
from crowdbench_leaderboards.planner_files import PLANNER, Files, locate_named_files, named_externals
from crowdbench_leaderboards.season import SEASON

LIMITS = ResourceLimits(total=7200.0)
"""The limits of a planner for the cases of one scenario."""

DECIMALS = 4
"""Decimal places of the commands of entries, in m/s and in the units of native commands."""


class InUse(InputError):
    """Another process is making, or has made, the same runs."""


@dataclass(frozen=True)
class EntryPlanner:
    """The planner of an entry.

    Attributes:
        folder: The folder of the entry.
        planner: Name or file of the planner, as for `crowdbench run --planner`; a file is relative to the folder.
        options: The planner's options; files are relative to the folder.
        external: The files outside of the entry that options name.
    """

    folder: Path
    planner: str
    options: Mapping[str, Any]
    external: Files = field(default_factory=dict)

    @property
    def located(self) -> tuple[str, dict[str, Any]]:
        """The planner and its options with the full paths of files."""
        return tuple(locate_named_files(each, self.folder, self.external) for each in (self.planner, self.options))

    @contextlib.contextmanager
    def start(self, scenario: Scenario, cores: Sequence[int] | None = None) -> Iterator[IsolatedPlanner]:
        """Start the planner in a separate process that can read only the frozen files of the entry.

        Args:
            scenario: The scenario that it drives.
            cores: The processors that it may use; by default all of this process.
        """
        named = [self.external[name] for name in named_externals(self.options) if name in self.external]
        cards = [path.with_suffix(".json") for path in named]
        isolated = IsolatedPlanner(
            *self.located,
            LIMITS,
            readable=filter(Path.exists, [self.folder / PLANNER, *named, *cards]),
            folder=Path("/"),  # files that the entry lacks must be missing
            hidden=[path for path in self.folder.resolve().parents if (path / SEASON).exists()],
            scene=scenario.tracks.scene if scenario.tracks else None,
            decimals=DECIMALS,
            cores=cores,
        )
        with contextlib.closing(isolated):
            yield isolated


@dataclass(frozen=True)
class CaseSet:
    """Cases of all scenarios of a board.

    Attributes:
        board: The board.
        cases: The cases of each scenario.
        seed: The seed of the cases; None for the public ones.
    """

    board: Board
    cases: Cases
    seed: int | None = None

    @property
    def scenarios(self) -> Sequence[Scenario]:
        """The scenarios, see `Board.load`."""
        return self.board.load(self.seed)


def drive(planner: EntryPlanner, case_set: CaseSet, out: Path, progress: Progress | None = None) -> dict[str, str]:
    """Make the runs of a planner on a board. Runs that are finished, and finished batches, are not made again.

    Args:
        planner: The planner.
        case_set: The cases.
        out: The folder of the runs.
        progress: Called after each step with the progress of the step, as a fractional number of episodes.

    Returns:
        The error of each scenario in which the planner breaks its contract or a limit. Such scenarios have no run.

    Raises:
        InputError: The planner fails in all scenarios.
        MachineFault: `out` cannot be written, or crowdbench has changed meanwhile.
        KeyboardInterrupt: The user interrupted it. Finished batches are kept.
    """
    scenarios = {scenario.name: scenario for scenario in case_set.scenarios}
    failures = make_each(scenarios, lambda name: _drive(planner, case_set, scenarios[name], out / name, progress))
    for name in failures:
        shutil.rmtree(out / name, ignore_errors=True)  # a run of an earlier version of the planner
    return failures


def _drive(
    planner: EntryPlanner, case_set: CaseSet, scenario: Scenario, directory: Path, progress: Progress | None
) -> None:
    board, options = case_set.board, dict(planner.options)
    spec = RunSpec(
        planner.planner,
        scenario.name,
        case_set.cases,
        options=options,
        overrides=board.overrides(case_set.seed),
        replanning=board.replanning,
        record="commands",
        others=others_in(scenario.name) or None,
    )
    located, located_options = planner.located
    with planner.start(scenario) as isolated:
        driver = Driver(isolated, isolated.name)
        identity, others = identify(located, located_options, driver, options), None
        if spec.others:
            team = Driver(load_planner(spec.others, {}), spec.others)
            others = team, identify(spec.others, {}, team)
        run = Run(spec, driver, scenario, board.metrics, identity, others)
        if not _is_finished(directory, run):
            make_run(run, directory, overwrite=True, progress=progress)
        elif progress is not None:
            progress(len(case_set.cases))


def _is_finished(directory: Path, run: Run) -> bool:
    try:
        return bool(check_result(directory)["id"] == run.id.digest)
    except InputError:
        return False


def driven_scenarios(board: Board, folder: Path) -> list[str]:
    """Return the names of the scenarios of a board that have a run in a folder."""
    return [name for name in board.scenarios if (folder / name).is_dir()]


def read_episodes(board: Board, folder: Path) -> dict[str, Episodes]:
    """Read the episodes in a folder by scenario. Raises InputError if a file is damaged."""
    return {name: Episodes.read(folder / name / EPISODES) for name in driven_scenarios(board, folder)}


@contextlib.contextmanager
def lock_runs(out: Path) -> Iterator[None]:
    """Keep other processes from making the same runs. Raises InUse if another process is making them."""
    out.parent.mkdir(parents=True, exist_ok=True)
    try:
        with hold_lock(out.with_name(f".{out.name}.lock"), 0):
            yield
    except Timeout:
        raise InUse(f"another process is making the runs of {out}") from None
