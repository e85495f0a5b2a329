"""A run made part by part: what is finished is kept, and several processes share the work.

The parts of a run `runs/a` lie in `runs/a.parts-<id of the run>-<what is recorded>`, a directory each, until they are
merged into `runs/a`. A process holds the lock of a part while it makes the part, so that no part is made twice. The
same command, given again or on another machine, makes the missing parts.
"""

from __future__ import annotations

import contextlib
import functools
import glob
import itertools
import json
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from filelock import Timeout

from crowdbench.runs.result_file import RESULT, check_result
from crowdbench.runs.rollout import Progress
from crowdbench.runs.run import Run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, NotWritten
from crowdbench.utils.files import check_free, new_directory, parent_of

ENDING = ".parts-"

REQUEST = "request.json"
"""The file with the identity of the run whose parts lie in a folder."""

PATIENCE = 0.5
"""Seconds between two looks at parts that other processes are making."""

Drive = Callable[[Cases, Path], None]
"""Makes the run of some cases in a directory, or raises and leaves a directory that is not complete."""

T = TypeVar("T")


@dataclass(frozen=True)
class Shard:
    """One of several equal shares of some work, of which each is done by another process; written `2/8`.

    Attributes:
        number: Which one, from 1 on.
        count: How many there are.
    """

    number: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str | None) -> Shard:
        """Read `2/8`; None is the whole. Raises InputError where there is no such shard, or the form is another one."""
        if text is None:
            return WHOLE
        match = re.fullmatch("([0-9]{1,9})/([0-9]{1,9})", text)
        if match and 1 <= int(match[1]) <= int(match[2]):
            return cls(int(match[1]), int(match[2]))
        raise InputError(f"{text!r} is no shard: write 2/8 for the second of eight")

    def select(self, work: Sequence[T]) -> Sequence[T]:
        """Its share of the parts of a run, or of the runs of a study."""
        return work[self.number - 1 :: self.count]


WHOLE = Shard()


@dataclass(frozen=True)
class Parts:
    """The parts of a run.

    Attributes:
        spec: The run, as another process loads it.
        out: The directory of the run.
        folder: The folder that has a directory for each of them until all are there.
        request: The text of the file with the identity of the run.
        is_resumable: Whether another call can go on with them.
        cases: Their cases, in order.
        selected: The cases of those that this process makes.
    """

    spec: RunSpec
    out: Path
    folder: Path
    request: str
    is_resumable: bool
    cases: Sequence[Cases]
    selected: Sequence[Cases]

    @classmethod
    def of(cls, run: Run, out: Path, shard: Shard = WHOLE) -> Parts:
        """The parts of a run that is made in the directory `out`, of which this process makes a shard."""
        spec, id_ = run.spec, run.id
        request = {"id": id_.digest, "run": id_.parts, "record": spec.record, "batch": spec.batch}
        folder = out.with_name(f"{out.name}{ENDING}{id_.digest[:8]}-{spec.record}")
        cases = tuple(spec.cases.batches(spec.batch))
        text = json.dumps(request, indent=2, sort_keys=True) + "\n"
        return cls(spec, out, folder, text, id_.planner.is_resumable, cases, shard.select(cases))

    def directory(self, part: Cases) -> Path:
        """Where a part lies."""
        return self.folder / _name(part)

    def list_finished(self) -> list[Cases]:
        """The parts that are there."""
        return [part for part in self.cases if self._is_finished(part)]

    def count_finished(self) -> int:
        """The number of cases whose parts are there."""
        return sum(map(len, self.list_finished()))

    def _is_finished(self, part: Cases) -> bool:
        try:
            return is_finished(self.directory(part))
        except InputError:
            if (self.folder / REQUEST).exists():
                raise
            return True  # another process has put all parts together, and removed them while this one looked

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Make the folder, and remove it again if it stays empty. Raises NotWritten where it cannot be written."""
        with contextlib.ExitStack() as stack:
            try:
                stack.enter_context(parent_of(self.out))
                self.folder.mkdir(exist_ok=True)
                with files.whole(self.folder / REQUEST) as partial:
                    partial.write_text(self.request, encoding="utf-8")
            except OSError as error:
                raise NotWritten(f"{self.out} cannot be written: {error.strerror or error}") from None
            stack.callback(self._close)
            yield

    @contextlib.contextmanager
    def report_finished(self) -> Iterator[None]:
        """Say in an InputError, and after an interrupt, which part of the run is kept."""
        try:
            yield
        except (KeyboardInterrupt, InputError) as error:
            number = self.count_finished()
            if not number:
                raise
            finished = f"{number} of {len(self.spec.cases)} cases are kept in {self.folder}"
            goes_on = "the same command goes on with them, and " if self.is_resumable else ""
            error.add_note(f"{finished}; {goes_on}`crowdbench merge {self.folder} --out DIR` makes a run of them")
            if not self.is_resumable:
                error.add_note("a planner object with a key, `run(..., key=...)`, goes on with what is kept")
            raise

    def _close(self) -> None:
        if self.folder.exists() and _is_abandoned(self.folder):
            shutil.rmtree(self.folder, ignore_errors=True)

    @contextlib.contextmanager
    def claim(self, part: Cases) -> Iterator[bool]:
        """Hold the lock of a part.

        Yields:
            Whether it has to be made; not where another process has made it, or has put all parts together.

        Raises:
            Timeout: Another process is making it.
        """
        with files.hold_lock(self.folder / f".{_name(part)}.making", 0):
            yield (self.folder / REQUEST).exists() and not self._is_finished(part)

    def put_together(self, overwrite: bool) -> None:
        """Merge them, unless another process has done it, and remove them. Parts that other runs have kept stay."""
        directories = [self.directory(part) for part in self.cases]
        lock = self.folder.with_name(f".{self.folder.name}.merging")
        with files.hold_lock(lock):
            if is_finished(directories[0]):
                if len(directories) == 1:
                    with new_directory(self.out, overwrite) as directory:
                        shutil.copytree(directories[0], directory, dirs_exist_ok=True)
                else:
                    from crowdbench.runs.merge import merge

                    merge(directories, self.out, overwrite)
                _remove(self.folder)
                for other in self.out.parent.glob(f"{glob.escape(self.out.name)}{ENDING}*"):
                    if _is_abandoned(other):
                        _remove(other)
            lock.unlink(missing_ok=True)


def make_run(
    run: Run,
    out: Path,
    *,
    shard: Shard = WHOLE,
    overwrite: bool = False,
    wait: bool = True,
    drive: Drive | None = None,
    progress: Progress | None = None,
) -> bool:
    """Make a run, or a shard of it, going on from what is there. The run is put together once all parts are there.

    Args:
        run: The run.
        out: Its directory.
        shard: Which parts to make.
        overwrite: Whether an earlier run in its directory is replaced.
        wait: Whether to wait for parts that other processes are making.
        drive: Makes a part, if not `Run.drive`.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        Whether all parts are there, and the run is in its directory.

    Raises:
        InputError: The directory is taken, or as `Run.drive` raises it.
        KeyboardInterrupt: Somebody interrupted it. The parts that are finished are kept.
    """
    check_free(out, overwrite)
    parts = Parts.of(run, out, shard)
    drive = drive or functools.partial(run.drive, progress=progress)
    with parts.open(), parts.report_finished():
        waiting = parts.selected
        while waiting:
            left = [part for part in waiting if not _make_part(parts, part, drive, progress)]
            if not wait:
                break
            if len(left) == len(waiting):
                time.sleep(PATIENCE)
            waiting = left
        if len(parts.list_finished()) == len(parts.cases):
            parts.put_together(overwrite)
        # Another process that has the same command may put the parts together, and remove the folder, at any time.
        is_whole = not (parts.folder / REQUEST).exists()
        if is_whole:
            shutil.rmtree(parts.folder, ignore_errors=True)  # locks are made with their folder
        return is_whole


def _make_part(parts: Parts, part: Cases, drive: Drive, progress: Progress | None) -> bool:
    """Make a part, unless it is there; False where another process is making it."""
    try:
        with parts.claim(part) as is_missing:
            if is_missing:
                drive(part, parts.directory(part))
            elif progress is not None:
                progress(len(part))
            return True
    except Timeout:
        return False


def _remove(folder: Path) -> None:
    """Remove a folder at once for other processes, which could put something into it while it is being removed."""
    removed = folder.with_name(f".{folder.name}.merged-{secrets.token_hex(4)}")
    folder.rename(removed)
    shutil.rmtree(removed, ignore_errors=True)


def _is_abandoned(folder: Path) -> bool:
    """Return whether a folder has no finished part, and no process is making one."""
    if any(folder.glob(f"[!.]*/{RESULT}")):
        return False
    try:
        for lock in folder.glob(".*.making"):
            with files.hold_lock(lock, 0):
                pass
    except (Timeout, OSError):
        return False
    return True


def _name(part: Cases) -> str:
    return f"{part.split}-{part.start}-{part.stop}"


def is_finished(directory: Path) -> bool:
    """Return whether a run is there, to its last case. Raises InputError where it is damaged."""
    return (directory / RESULT).exists() and not check_result(directory)["interrupted"]


def find_finished(folders: Sequence[Path]) -> tuple[list[Path], bool]:
    """The parts of a run that are there to their last case, up to the first one that is missing.

    Args:
        folders: Folders with parts of the same run, perhaps from several machines.

    Returns:
        Their directories in order, and whether they are all.

    Raises:
        InputError: A folder holds no parts, or they are of different runs.
    """
    requests = [_read_request(folder) for folder in folders]
    for folder, request in zip(folders, requests, strict=True):
        if request != requests[0]:
            raise InputError(f"{folders[0]} and {folder} hold parts of different runs: their {REQUEST} differ")
    parts = list(_parts_of(requests[0]))
    directories = [next(filter(is_finished, (folder / _name(part) for folder in folders)), None) for part in parts]
    finished = [directory for directory in itertools.takewhile(bool, directories) if directory]
    return finished, len(finished) == len(parts)


def _read_request(folder: Path) -> dict[str, Any]:
    try:
        request = files.read_json(folder / REQUEST)
        list(_parts_of(request))
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{folder} is no folder with the parts of a run") from None
    return dict(request)


def _parts_of(request: Mapping[str, Any]) -> Iterator[Cases]:
    """Return the cases of the parts of a run, in order."""
    return Cases.parse(request["run"]["cases"]).batches(request["batch"])
