"""A folder that keeps runs, each in a directory that is named after all that its figures depend on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from crowdbench.runs.result_file import RESULT
from crowdbench.runs.run import Run
from crowdbench.runs.shards import make_run
from crowdbench.runs.spec import directory_name
from crowdbench.runs.store import RunResult


def run_directory(run: Run, out: Path) -> Path:
    """Return the directory of a run in the folder `out`; its name has a part for people, and the run's id."""
    name = directory_name(run.driver.name, run.scenario.name, run.spec)
    return out / f"{name[:180]}-{run.id.digest[:12]}"


def is_complete(run: Run, out: Path) -> bool:
    """Return whether a run is in the folder, to the last case, and can be checked.

    Raises InputError where its directory holds something else, or other files than it wrote.
    """
    directory = run_directory(run, out)
    return (directory / RESULT).exists() and RunResult.read(directory).result["id"] == run.id.digest


def make_in_folder(run: Run, out: Path, progress: Callable[[float], None] | None = None) -> bool:
    """Make a run that is not in the folder. After an interrupt its finished parts are kept, and it goes on with them.

    Args:
        run: The run.
        out: The folder.
        progress: As `make_run` calls it.

    Returns:
        True if it is there; not where another process is making it.

    Raises:
        InputError: As `make_run` does.
        KeyboardInterrupt: Somebody interrupted it.
    """
    # Another process may have made it meanwhile.
    return is_complete(run, out) or make_run(run, run_directory(run, out), overwrite=True, progress=progress)
