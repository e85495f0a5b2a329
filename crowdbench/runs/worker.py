"""A part of a run on a worker: loads the run once in the worker's process, and drives one part after the other."""

from __future__ import annotations

import atexit
import contextlib
import functools
import os
import platform
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from crowdbench.results.result_file import RESULT
from crowdbench.runs.loading import open_run
from crowdbench.runs.parts import Parts, folder_of_parts, name_of_part
from crowdbench.runs.run import Run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError, MachineFault

INTERVAL = 0.5
"""Seconds between two reports of a worker's progress."""


@dataclass(frozen=True)
class PartTask:
    """A part of a run for a worker.

    Attributes:
        spec: The run.
        id: The digest of its identity, which the worker's run must have, too.
        working_directory: The folder that relative paths in the spec start from.
        out: The directory of the run, an absolute path.
        cases: The cases of the part.
    """

    spec: RunSpec
    id: str
    working_directory: str
    out: Path
    cases: Cases

    @property
    def folder(self) -> Path:
        """The folder of the run's parts."""
        return folder_of_parts(self.out, self.id, self.spec.record)

    @property
    def progress_file(self) -> Path:
        """The file with the number of cases that are driven so far, as a fraction."""
        return self.folder / f".progress-{name_of_part(self.cases)}"

    def read_progress(self) -> float:
        """Return the number of cases that are driven so far; 0 if the worker has not started."""
        try:
            return min(float(self.progress_file.read_text()), len(self.cases))
        except (OSError, ValueError):  # while it is being written, it may be empty
            return 0.0

    def is_lost(self) -> bool:
        """Return whether a part that a worker has made is not on this machine, though others have not merged it."""
        return self.folder.exists() and not (self.folder / name_of_part(self.cases) / RESULT).exists()


@dataclass(frozen=True)
class PartReport:
    """Report of a worker on a part.

    Attributes:
        machine: The name of the worker's machine.
        is_made: True if the worker has made the part; False if it was finished, or another process is making it.
        failed: The errors of the user's metrics that failed, by name.
        lost: The errors of recordings that could not be written.
        error: The error that stopped the part.
    """

    machine: str
    is_made: bool = False
    failed: Mapping[str, str] = field(default_factory=dict)
    lost: Sequence[str] = ()
    error: InputError | None = None


_lock = threading.Lock()
"""Held while a part is driven: Dask may give several tasks to the threads of a process, which has one working
directory."""

_loaded: list[tuple[str, contextlib.ExitStack, Run]] = []
"""The run that the process has loaded, with its digest and the context that closes it; at most one."""


_files: dict[tuple[str, str], str] = {}
"""The digest of each file and metric that the process has loaded, by the working directory and its name."""


def make_part(task: PartTask) -> PartReport:
    """Make a part of a run, unless it is finished or another process is making it."""
    machine = platform.node()
    try:
        with _lock, _enter(task.working_directory):
            run = _load(task)
            is_made = Parts.of(run, task.out).make(task.cases, functools.partial(_drive, run, task))
            return PartReport(machine, is_made, dict(run.failed), tuple(run.lost))
    except InputError as error:
        return PartReport(machine, error=error)


@contextlib.contextmanager
def _enter(folder: str) -> Iterator[None]:
    """Change to the working directory of the command."""
    before = os.getcwd()
    try:
        os.chdir(folder)
    except OSError as error:
        raise MachineFault(
            f"the worker on {platform.node()} cannot enter {folder} ({error.strerror}): start the command in a folder "
            "that all workers share"
        ) from None
    try:
        yield
    finally:
        os.chdir(before)


def _load(task: PartTask) -> Run:
    """Return the run of a task, loaded if it is not that of the last task."""
    if _loaded and _loaded[0][0] == task.id:
        return _loaded[0][2]
    _close()
    stack = contextlib.ExitStack()
    run = stack.enter_context(open_run(task.spec))
    _loaded.append((task.id, stack, run))
    if run.id.digest != task.id:
        _close()
        raise MachineFault(
            f"the worker on {platform.node()} has another version of crowdbench, or of a file of the run, than this "
            "machine: install the same one"
        )
    _check_unedited(task, run)
    return run


def _check_unedited(task: PartTask, run: Run) -> None:
    """Raise MachineFault if a file was edited after this process loaded it.

    Python keeps imported modules, and a worker of a Dask cluster outlives commands: the edit would have no effect.
    """
    digests = {name: digest for files in run.planner.files.values() for name, digest in files.items()}
    for name, digest in {**digests, **run.id.metrics}.items():
        if _files.setdefault((task.working_directory, name), digest) != digest:
            _close()
            raise MachineFault(
                f"{name} was edited after the worker on {platform.node()} had loaded it: start the workers again"
            )


@atexit.register
def _close() -> None:
    while _loaded:
        _loaded.pop()[1].close()


def _drive(run: Run, task: PartTask, part: Cases, directory: Path) -> None:
    """Drive a part, and write its progress to a file from time to time."""
    done, written = 0.0, time.monotonic()

    def report(share: float) -> None:
        nonlocal done, written
        done += share
        if time.monotonic() - written > INTERVAL:
            written = time.monotonic()
            with contextlib.suppress(OSError):
                task.progress_file.write_text(f"{done}")

    run.drive(part, directory, report)
    task.progress_file.unlink(missing_ok=True)
