"""The parts of a run on disk, until they are merged: finished work that an interrupt or a kill does not lose.

The parts of a run `runs/a` are directories in `runs/a.parts-<id of the run>-<extent of the recording>`. Each is a run
of some of the cases, such as `val-0-500`. Any process can add parts of any size; a process holds the lock of a part
while it makes the part.
"""

from __future__ import annotations

import contextlib
import re
import secrets
import shlex
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from filelock import Timeout

from crowdbench.results.result_file import RESULT, check_result
from crowdbench.runs.merge import merge
from crowdbench.runs.run import Run
from crowdbench.scenario.cases import Cases
from crowdbench.utils import files
from crowdbench.utils.commands import command
from crowdbench.utils.errors import InputError, NotWritten
from crowdbench.utils.files import new_directory, parent_of

Drive = Callable[[Cases, Path], None]
"""Makes the run of some cases in a directory. If it raises, the directory is not complete."""

_NAME = re.compile("(train|val|test)-([0-9]+)-([0-9]+)")


def folder_of_parts(out: Path, digest: str, record: str) -> Path:
    """Return the folder of the parts of a run.

    Args:
        out: The directory of the run.
        digest: The digest of its identity.
        record: Extent of its recording, one of `defaults.RECORD`.
    """
    return out.with_name(f"{out.name}.parts-{digest[:8]}-{record}")


def name_of_part(part: Cases) -> str:
    """Return the name of the directory with a part."""
    return f"{part.split}-{part.start}-{part.stop}"


GOES_ON = "the same command goes on with them, and "


@dataclass(frozen=True)
class Parts:
    """The parts of a run.

    Attributes:
        run: The run.
        out: The directory of the run.
        folder: The folder with a directory for each part, until all parts are merged.
    """

    run: Run
    out: Path
    folder: Path

    @classmethod
    def of(cls, run: Run, out: Path) -> Parts:
        """Return the parts of a run in the directory `out`."""
        return cls(run, out, folder_of_parts(out, run.id.digest, run.spec.record))

    def directory(self, part: Cases) -> Path:
        """Return the directory of a part."""
        return self.folder / name_of_part(part)

    def finished(self) -> list[Cases]:
        """Return finished parts in the order of their cases, without those that overlap with others.

        Only one part, the whole run, is returned if another process has merged all parts and removed their folder.

        Raises:
            InputError: A part is damaged.
        """
        try:
            made = [part for part in self._listed() if is_finished(self.directory(part))]
        except InputError:
            if self.folder.exists():
                raise
            made = []
        if not self.folder.exists():
            return [self.run.spec.cases]
        chosen, start = [], self.run.spec.cases.start
        for part in sorted(made, key=lambda part: (part.start, -part.stop)):
            if part.start >= start:
                chosen.append(part)
                start = part.stop
        return chosen

    def _listed(self) -> list[Cases]:
        names = [_NAME.fullmatch(path.name) for path in self.folder.glob("*-*-*")]
        return [Cases(name[1], int(name[2]), int(name[3])) for name in names if name]

    def missing(self, within: Cases) -> list[Cases]:
        """Return the ranges of cases within some cases that no finished part has."""
        gaps, start = [], within.start
        for part in [*self.finished(), Cases(within.split, within.stop, within.stop)]:
            if (stop := min(part.start, within.stop)) > start:
                gaps.append(Cases(within.split, start, stop))
            start = max(start, part.stop)
        return gaps

    def count_finished(self) -> int:
        """Return the number of cases in finished parts."""
        return sum(map(len, self.finished()))

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
            resumes = GOES_ON if is_resumable else ""
            merge = f"{command('merge', self.folder)}/* --out {shlex.quote(f'{self.out}-merged')}"
            error.add_note(f"{finished}; {resumes}`{merge}` makes a run of them")
            if not is_resumable:
                error.add_note("a planner object with a key, `run(..., key=...)`, goes on with what is kept")

    def make(self, part: Cases, drive: Drive) -> bool:
        """Make a part, unless it is finished or another process is making it. Return whether this process made it."""
        lock = self.folder.with_name(f".{self.folder.name}-{name_of_part(part)}.lock")
        with contextlib.suppress(Timeout), files.hold_lock(lock, 0):
            try:
                if self.missing(part):
                    drive(part, self.directory(part))
                    return True
            finally:
                lock.unlink(missing_ok=True)
        return False

    def merge(self, overwrite: bool) -> bool:
        """Merge the parts into the run, unless another process has done it, and remove them.

        Return True if the run is complete; False if cases are missing.
        """
        lock = self.folder.with_name(f".{self.folder.name}.lock")
        with files.hold_lock(lock):
            if self.missing(self.run.spec.cases):
                return False
            if self.folder.exists():
                parts = list(map(self.directory, self.finished()))
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


def is_finished(directory: Path) -> bool:
    """Return whether a directory contains a run with all of its cases. Raises InputError if the run is damaged."""
    return (directory / RESULT).exists() and bool(check_result(directory))
