"""The command `view`, and functions that choose a case of a run and find, or make, its recording."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.console import announce_compilation
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from crowdbench.results.run_result import RunResult
    from crowdbench.scenario.scenario import Scenario

NAMED = 10
"""How many cases of an outcome are named."""


def view(
    run: Path, case: str | None = None, worst: str | None = None, web: bool = False, data: Path | None = None
) -> None:
    """Play a case of a run in the Rerun viewer: its first failure, or else its first case.

    A case that was not recorded is simulated again from its commands.

    Args:
        run: Directory of a run, or an .rrd file. Without --case, all cases of an .rrd file are shown.
        case: Show this case: val/37, or its number.
        worst: Show the case in which this metric, such as jerk, is worst.
        web: Open it in a browser.
    """
    from crowdbench.record import viewer

    with open_case([run], case, worst, data) as ([path], number):
        viewer.view(path, number, web=web)


@contextlib.contextmanager
def open_case(
    runs: Sequence[Path], case: str | None, worst: str | None, data: Path | None
) -> Iterator[tuple[list[Path], int | None]]:
    """Choose a case of runs, and yield a recording of the case for each run, and the number of the case.

    Args:
        runs: Directories of runs, or .rrd files.
        case: The name or the number of the case; None for the first failure of the first run, or else its first case.
        worst: A metric, to choose the case of the first run in which it is worst.
        data: Folder with recorded tracks, if the case must be simulated again with them.

    Yields:
        The recordings, and the number: None for all cases of .rrd files.

    Raises:
        InputError: There is no such case or metric, or the case can be neither read nor simulated again.
    """
    from crowdbench.record.recorded_cases import find_case
    from crowdbench.results.episodes import EPISODES
    from crowdbench.results.run_result import RunResult

    if worst is not None and case is not None:
        raise InputError("--worst chooses the case: leave out --case or --worst")
    if not runs[0].is_dir():
        if worst is not None:
            raise InputError(f"--worst needs the directory of a run, whose {EPISODES} has the metrics, not {runs[0]}")
        yield [recording_of(run) for run in runs], None if case is None else find_case(recording_of(runs[0]), case)
        return
    results = [RunResult.read(run, tables_only=True) for run in runs if run.is_dir()]
    number = _choose(results, case, worst)
    with tempfile.TemporaryDirectory() as folder:
        yield [_record(run, number, Path(folder) / f"{index}.rrd", data) for index, run in enumerate(runs)], number


def _choose(runs: Sequence[RunResult], case: str | None, worst: str | None) -> int:
    """Return the number of the case, see `open_case`. Unless the user gave it, print it and the outcomes."""
    import numpy as np

    from crowdbench.core.types import Outcome
    from crowdbench.metrics.registry import info_of, no_metric
    from crowdbench.scenario.cases import parse_case

    cases, episodes = runs[0].cases, runs[0].episodes
    if case is not None:
        split, number = parse_case(case, cases.split)
        if split != cases.split or number not in cases.indices:
            raise InputError(f"case {case} is none of the cases {cases} of {runs[0].directory}")
        return number
    if worst is None:
        solved = episodes.case[episodes.outcome == Outcome.SUCCESS].tolist()
        outcomes = episodes.failures | ({Outcome.SUCCESS.label: solved} if solved else {})
        for outcome, found in outcomes.items():
            print(describe_cases(outcome, found))
        number = next(iter(outcomes.values()))[0]
    else:
        if worst not in episodes.columns:
            raise InputError(f"{runs[0].directory} {no_metric(worst, episodes.columns)}")
        values = -info_of(worst).sign * episodes.columns[worst].astype(float)
        values[~np.all([np.isin(episodes.case, run.episodes.case) for run in runs], axis=0)] = np.nan
        if np.isnan(values).all():
            raise InputError(f"{worst} is not defined in any case of {runs[0].directory}")
        number = int(episodes.case[np.nanargmax(values)])
    print(f"case {cases.split}/{number}")
    return number


def _record(run: Path, case: int, path: Path, data: Path | None) -> Path:
    """Return a recording with a case of a run: the run's recording, or else a replay that is written to `path`."""
    from crowdbench.record.recorded_cases import recorded_cases
    from crowdbench.results.run_result import RunResult
    from crowdbench.runs.replay import record_case

    recording = recording_of(run)
    if not run.is_dir() or (recording.exists() and case in recorded_cases(recording)):
        return recording
    announce_compilation()
    result = RunResult.read(run)
    record_case(result, load_scenario(result, [], None, data), case, path)
    return path


def describe_cases(outcome: str, cases: Sequence[int]) -> str:
    """Return how many cases had an outcome, and the first of them, such as `2 collisions (cases 3, 8)`."""
    many = ("es" if outcome.endswith("s") else "s") * (len(cases) != 1)
    which = f"case{'s'[: len(cases) != 1]} {', '.join(map(str, cases[:NAMED]))}{', ...' * (len(cases) > NAMED)}"
    return f"{len(cases)} {outcome.replace('_', ' ')}{many} ({which})"


def load_scenario(run: RunResult, pedestrians: Sequence[str] | None, layout: str | None, data: Path | None) -> Scenario:
    """Load the scenario of a run, with the files that the run had."""
    from crowdbench.runs.loading import load_stored_scenario

    return load_stored_scenario(run, pedestrians or (), layout, data)


def recording_of(path: Path) -> Path:
    """Return the recording of a run, given by its directory or by the file itself."""
    from crowdbench.results.episodes import RECORDING

    return path / RECORDING if path.is_dir() else path
