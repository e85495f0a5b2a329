"""The folder that keeps the runs of a study: each has a directory there, named after all that its figures depend on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from crowdbench.runs.result_file import RESULT
from crowdbench.runs.results import EPISODES, Episodes
from crowdbench.runs.run import Run
from crowdbench.runs.shards import WHOLE, Shard, make_run
from crowdbench.runs.spec import directory_name
from crowdbench.runs.store import RunResult


def run_directory(run: Run, out: Path) -> Path:
    """Return the directory of a run in the folder `out`; its name has a part for people, and the run's id."""
    name = directory_name(run.driver.name, run.scenario.name, run.spec)
    return out / f"{name[:180]}-{run.id.digest[:12]}"


def describe_run(run: Run) -> str:
    """Return what a run is, for people."""
    changes = "".join(f", {key}={value}" for key, value in run.spec.overrides.items())
    return f"{run.label} on {run.scenario.name}{changes}, cases {run.spec.cases}"


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


def read_episodes(run: Run, out: Path) -> Episodes:
    """Read the episodes of a run in the folder. Raises InputError where it is not there."""
    return Episodes.read(run_directory(run, out) / EPISODES)


def missing_runs(runs: Iterable[Run], out: Path, shard: Shard = WHOLE) -> list[Run]:
    """Return the runs that are not in the folder, each once.

    Args:
        runs: The runs that are needed, some perhaps twice.
        out: The folder.
        shard: Which share of the runs is looked at. It is the same whichever of them are there.
    """
    distinct = list({run_directory(run, out): run for run in runs}.values())
    return [run for run in shard.select(distinct) if not is_complete(run, out)]
