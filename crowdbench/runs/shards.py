"""Make a run part by part: finished parts are stored, and several processes can share the work.

The parts of a run `runs/a` are directories in `runs/a.parts-<id of the run>-<extent of the recording>`, until they are
merged into `runs/a`. A process holds the lock of a part while it makes the part, so that no part is made twice. The
same command makes the missing parts when it is repeated, also on another machine.
"""

from __future__ import annotations

import contextlib
import functools
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from filelock import Timeout

from crowdbench.results.result_file import RESULT, check_result, read_result
from crowdbench.runs.merge import merge
from crowdbench.runs.rollout import Progress
from crowdbench.runs.run import Run
from crowdbench.scenario.cases import Cases
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, NotWritten
from crowdbench.utils.files import check_free, new_directory, parent_of

Drive = Callable[[Cases, Path], None]
"""Makes the run of some cases in a directory. If it raises, the directory is not complete."""

T = TypeVar("T")


@dataclass(frozen=True)
class Shard:
    """One of several equal shares of some work for different processes, written as `2/8`.

    Attributes:
        number: Number of this share, from 1.
        count: Number of shares.
    """

    number: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str | None) -> Shard:
        """Parse a text such as `2/8`; None is the whole work. Raises InputError if the text is no valid shard."""
        if text is None:
            return WHOLE
        match = re.fullmatch("([0-9]{1,9})/([0-9]{1,9})", text)
        if match and 1 <= int(match[1]) <= int(match[2]):
            return cls(int(match[1]), int(match[2]))
        raise InputError(f"{text!r} is no shard: write 2/8 for the second of eight")

    def select(self, work: Sequence[T]) -> Sequence[T]:
        """Return the parts of a run, or the runs of a study, that belong to this shard."""
        return work[self.number - 1 :: self.count]


WHOLE = Shard()


@dataclass(frozen=True)
class Parts:
    """The parts of a run.

    Attributes:
        run: The run.
        out: The directory of the run.
        folder: The folder with a directory for each part, until all parts are finished.
        cases: The cases of each part, in order.
    """

    run: Run
    out: Path
    folder: Path
    cases: Sequence[Cases]

    @classmethod
    def of(cls, run: Run, out: Path) -> Parts:
        """Return the parts of a run in the directory `out`."""
        folder = out.with_name(f"{out.name}.parts-{run.id.digest[:8]}-{run.spec.record}")
        return cls(run, out, folder, tuple(run.spec.cases.batches(run.spec.batch)))

    def directory(self, part: Cases) -> Path:
        """Return the directory of a part."""
        return self.folder / _name(part)

    def is_finished(self, part: Cases) -> bool:
        """Return whether a part is finished, or another process has merged all parts and removed their folder.

        Raises:
            InputError: The part is damaged.
        """
        try:
            return is_finished(self.directory(part)) or not self.folder.exists()
        except InputError:
            if self.folder.exists():
                raise
            return True

    def count_finished(self) -> int:
        """Return the number of cases in finished parts."""
        return sum(len(part) for part in self.cases if self.is_finished(part))

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Create the folder, and remove it if it stays empty. Errors get a note on the finished parts in it.

        Raises NotWritten if the folder cannot be written.
        """
        with contextlib.ExitStack() as stack:
            try:
                stack.enter_context(parent_of(self.out))
                self.folder.mkdir(exist_ok=True)
            except OSError as error:
                raise NotWritten(f"{self.out} cannot be written: {error.strerror or error}") from None
            try:
                yield
            except (KeyboardInterrupt, InputError) as error:
                self._add_notes(error)
                raise
            finally:
                with contextlib.suppress(OSError):  # raised if parts are in it, or if it has been merged
                    self.folder.rmdir()

    def _add_notes(self, error: BaseException) -> None:
        if number := self.count_finished():
            is_resumable = self.run.planner.is_resumable
            finished = f"{number} of {len(self.run.spec.cases)} cases are kept in {self.folder}"
            resumes = "the same command goes on with them, and " if is_resumable else ""
            error.add_note(f"{finished}; {resumes}`crowdbench merge {self.folder}/* --out DIR` makes a run of them")
            if not is_resumable:
                error.add_note("a planner object with a key, `run(..., key=...)`, goes on with what is kept")

    def make(self, part: Cases, drive: Drive) -> bool:
        """Make a part, unless it is finished or another process is making it. Return whether this process made it."""
        lock = self.folder.with_name(f".{self.folder.name}-{_name(part)}.lock")
        with contextlib.suppress(Timeout), files.hold_lock(lock, 0):
            try:
                if not self.is_finished(part):
                    drive(part, self.directory(part))
                    return True
            finally:
                lock.unlink(missing_ok=True)
        return False

    def merge(self, overwrite: bool) -> bool:
        """Merge the parts into the run, unless another process has done it, and remove them.

        Return True if the run is complete; False if parts are missing.
        """
        lock = self.folder.with_name(f".{self.folder.name}.lock")
        with files.hold_lock(lock):
            if not all(map(self.is_finished, self.cases)):
                return False
            if self.folder.exists():
                parts = list(map(self.directory, self.cases))
                if len(parts) > 1:
                    merge(parts, self.out, overwrite)
                else:
                    with new_directory(self.out, overwrite) as directory:
                        directory.rmdir()
                        parts[0].rename(directory)
                # Renamed in one step, because other processes could write into the folder while it is being removed.
                removed = self.folder.with_name(f".{self.folder.name}.merged-{secrets.token_hex(4)}")
                self.folder.rename(removed)
                shutil.rmtree(removed, ignore_errors=True)
            lock.unlink(missing_ok=True)
            return True


def make_run(
    run: Run,
    out: Path,
    *,
    shard: Shard = WHOLE,
    overwrite: bool = False,
    drive: Drive | None = None,
    progress: Progress | None = None,
) -> bool:
    """Make a run, or a shard of it, and continue with existing parts. The run is merged once all parts are finished.

    Args:
        run: The run.
        out: Its directory.
        shard: The share of the parts to make.
        overwrite: True if an earlier run in its directory is replaced.
        drive: Function that makes a part; None for `Run.drive`.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.

    Returns:
        True if the run is complete in its directory; False if other processes must make, or are making, parts of it.

    Raises:
        InputError: The directory is not free, or as in `Run.drive`.
        KeyboardInterrupt: The user interrupted the run. Finished parts are stored.
    """
    check_out(run, out, overwrite)
    parts = Parts.of(run, out)
    drive = drive or functools.partial(run.drive, progress=progress)
    with parts.open():
        for part in shard.select(parts.cases):
            if not parts.make(part, drive) and progress is not None:
                progress(len(part))
        return parts.merge(overwrite)


def check_out(run: Run, out: Path, overwrite: bool) -> None:
    """Raise NotWritten if the directory of a run is not free, with a note on planner files that were edited since."""
    try:
        check_free(out, overwrite)
    except NotWritten as error:
        with contextlib.suppress(InputError):
            before = read_result(out)["run"]["planner"]["files"].get("planner", {})
            for name, digest in run.planner.files.get("planner", {}).items():
                if before.get(name, digest) != digest:
                    error.add_note(f"{name} was edited since that run")
        raise


def _name(part: Cases) -> str:
    return f"{part.split}-{part.start}-{part.stop}"


def is_finished(directory: Path) -> bool:
    """Return whether a directory contains a run with all of its cases. Raises InputError if the run is damaged."""
    return (directory / RESULT).exists() and bool(check_result(directory))
