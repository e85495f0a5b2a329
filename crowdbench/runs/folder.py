"""A folder of runs, each in a directory whose name contains the run's id (`crowdbench.runs.identity`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from crowdbench.results.result_file import RESULT
from crowdbench.results.run_result import RunResult
from crowdbench.runs.make import WorkersRun, make_run, make_with
from crowdbench.runs.run import Run
from crowdbench.runs.spec import directory_name
from crowdbench.utils.executors import Executor


def run_directory(run: Run, out: Path) -> Path:
    """Return the directory of a run in the folder `out`; its name has a readable part, and the run's id."""
    name = directory_name(run.driver.name, run.scenario.name, run.spec)
    return out / f"{name[:180]}-{run.id.digest[:12]}"


def is_complete(run: Run, out: Path) -> bool:
    """Return whether the folder contains a run with all of its cases.

    Raises InputError if its directory contains something else, or files that differ from those that the run wrote.
    """
    directory = run_directory(run, out)
    return (directory / RESULT).exists() and RunResult.read(directory).result["id"] == run.id.digest


def make_in_folder(run: Run, out: Path, progress: Callable[[float], None] | None = None) -> bool:
    """Make a run unless it is in the folder. After an interrupt, the next call continues with the finished parts.

    Args:
        run: The run.
        out: The folder.
        progress: See `make_run`.

    Returns:
        True if the run is complete; False if another process is still making it.

    Raises:
        InputError: As `make_run` does.
        KeyboardInterrupt: The user interrupted it.
    """
    # Another process may have made it meanwhile.
    return is_complete(run, out) or make_run(run, run_directory(run, out), overwrite=True, progress=progress)


def make_in_folder_with(
    executor: Executor, runs: Sequence[Run], out: Path, progress: Callable[[float], None] | None = None
) -> list[WorkersRun]:
    """Make the runs that the folder lacks with workers, see `make_with`.

    Args:
        executor: The workers.
        runs: The runs, loaded by `load_run` from their specification alone.
        out: The folder.
        progress: See `make_run`.

    Returns:
        The runs that were missing, with their errors.
    """
    missing = [run for run in runs if not is_complete(run, out)]
    if progress is not None:
        progress(sum(len(run.spec.cases) for run in runs) - sum(len(run.spec.cases) for run in missing))
    return make_with(executor, [(run, run_directory(run, out)) for run in missing], overwrite=True, progress=progress)
