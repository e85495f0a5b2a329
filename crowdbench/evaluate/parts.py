"""A run made part by part: what is finished is kept, and several processes share the work.

The parts of a run `runs/a` lie in `runs/a.parts-<digest of what was asked for>`, a directory each, until they are
merged into `runs/a`. Whoever makes a part holds its lock, so that nobody makes it twice at a time. The same command,
given again or somewhere else, makes what is still missing.
"""

from __future__ import annotations

import contextlib
import glob
import hashlib
import itertools
import json
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import Timeout

from crowdbench import files
from crowdbench.errors import InputError, NotWritten
from crowdbench.evaluate.directory import check_free, held, new_directory, parent_of
from crowdbench.evaluate.merge import merge
from crowdbench.evaluate.seal import MANIFEST, checked
from crowdbench.evaluate.shard import WHOLE, Shard
from crowdbench.scenario.cases import Cases

ENDING = ".parts-"

REQUEST = "request.json"
"""What the parts of a folder are parts of, with all that their figures depend on."""

PATIENCE = 0.5
"""Seconds between two looks at parts that other processes are making."""

Drive = Callable[[Cases, Path], None]
"""Makes the run of some cases in a directory, or raises and leaves a directory that is not complete."""


@dataclass(frozen=True)
class Parts:
    """The parts of a run.

    Attributes:
        out: The directory of the run.
        folder: The folder that has a directory for each of them until all are there.
        request: The text of the file that says what they are parts of.
        cases: Their cases, in order.
    """

    out: Path
    folder: Path
    request: str
    cases: tuple[Cases, ...]

    @classmethod
    def of(cls, cases: Cases, out: Path, request: Mapping[str, Any], batch: int) -> Parts:
        """The parts of a run.

        Args:
            cases: The cases of the run.
            out: The directory of the run.
            request: All that its figures depend on.
            batch: Cases of a part.
        """
        wanted = json.dumps({**request, "cases": str(cases), "batch": batch}, indent=2, sort_keys=True) + "\n"
        folder = out.with_name(f"{out.name}{ENDING}{hashlib.sha256(wanted.encode()).hexdigest()[:8]}")
        return cls(out, folder, wanted, tuple(cases.batches(batch)))

    def directory(self, part: Cases) -> Path:
        """Where a part lies."""
        return self.folder / _name(part)

    def made(self) -> list[Cases]:
        """The parts that are there."""
        return [part for part in self.cases if is_made(self.directory(part))]

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
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

    def _close(self) -> None:
        is_empty = self.folder.exists() and not any(each.is_dir() for each in self.folder.iterdir())
        if is_empty and _is_idle(self.folder):
            shutil.rmtree(self.folder, ignore_errors=True)

    @contextlib.contextmanager
    def told(self) -> Iterator[None]:
        """Say in an InputError, and after an interrupt, what is kept."""
        try:
            yield
        except (KeyboardInterrupt, InputError) as error:
            cases = sum(map(len, self.made()))
            if not cases:
                raise
            kept = f"{cases} of {sum(map(len, self.cases))} cases are kept in {self.folder}"
            by_hand = f"`crowdbench merge {self.folder} --out DIR` makes a run of them"
            goes_on = f"the same command goes on with them, and {by_hand}"
            raise type(error)(f"{str(error) or 'interrupted'}: {kept}; {goes_on}") from error

    @contextlib.contextmanager
    def claimed(self, part: Cases) -> Iterator[bool]:
        """Hold the lock of a part.

        Args:
            part: The part.

        Yields:
            Whether it has to be made; not where another process has made it, or has put all parts together.

        Raises:
            Timeout: Another process is making it.
        """
        with held(self.folder / f".{_name(part)}.making", 0):
            yield (self.folder / REQUEST).exists() and not is_made(self.directory(part))


@dataclass(frozen=True)
class Made:
    """What is there of a run.

    Attributes:
        folder: The folder of its parts, which is gone once all are there.
        cases: How many of its cases are there.
        is_whole: Whether all are, and the run is in its directory.
    """

    folder: Path
    cases: int
    is_whole: bool


def make(
    drive: Drive,
    parts: Parts,
    shard: Shard = WHOLE,
    *,
    overwrite: bool = False,
    wait: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Made:
    """Make a run, or a shard of it, going on from what is there. The run is put together once all parts are there.

    Args:
        drive: Makes a part.
        parts: The parts of the run.
        shard: Which parts to make.
        overwrite: Whether an earlier run in its directory is replaced.
        wait: Whether to wait for parts that other processes are making.
        progress: Called with the number of cases of parts that were there before.

    Returns:
        What is there now.

    Raises:
        InputError: The run's directory is taken, or as `drive` raises it.
        KeyboardInterrupt: Somebody interrupted it. The parts that are finished are kept.
    """
    check_free(parts.out, overwrite)
    folder = parts.folder
    with parts.opened(), parts.told():
        _make_parts(drive, parts, shard.own(parts.cases), wait, progress)
        if len(parts.made()) == len(parts.cases):
            _put_together(parts, overwrite)
        # Another process that has the same command may put the parts together, and remove the folder, at any time.
        if not (folder / REQUEST).exists():
            shutil.rmtree(folder, ignore_errors=True)  # locks are made with their folder
            return Made(folder, sum(map(len, parts.cases)), is_whole=True)
        return Made(folder, sum(map(len, parts.made())), is_whole=False)


def _make_parts(
    drive: Drive, parts: Parts, own: Sequence[Cases], wait: bool, progress: Callable[[float], None] | None
) -> None:
    """Make all of these parts that nobody else makes, and perhaps wait for the others."""
    waiting = own
    while waiting:
        left = [part for part in waiting if not _make_part(drive, parts, part, progress)]
        if not wait:
            return
        if len(left) == len(waiting):
            time.sleep(PATIENCE)
        waiting = left


def _make_part(drive: Drive, parts: Parts, part: Cases, progress: Callable[[float], None] | None) -> bool:
    """Make a part, unless it is there; False where another process is making it."""
    try:
        with parts.claimed(part) as is_missing:
            if is_missing:
                drive(part, parts.directory(part))
            elif progress is not None:
                progress(len(part))
            return True
    except Timeout:
        return False


def _put_together(parts: Parts, overwrite: bool) -> None:
    """Merge the parts of a run, unless another process has done it, and remove them, and those of earlier tries."""
    out, folder = parts.out, parts.folder
    directories = [parts.directory(part) for part in parts.cases]
    lock = folder.with_name(f".{folder.name}.merging")
    with held(lock):
        if is_made(directories[0]):
            if len(directories) == 1:
                with new_directory(out, overwrite) as directory:
                    shutil.copytree(directories[0], directory, dirs_exist_ok=True)
            else:
                merge(directories, out, overwrite)
            for tried in out.parent.glob(f"{glob.escape(out.name)}{ENDING}{'[0-9a-f]' * 8}"):
                # What a longer run has kept outlives a shorter one of its name.
                is_worthless = len(directories) > 1 or not any(tried.glob(f"*/{MANIFEST}"))
                if tried == folder or (is_worthless and _is_idle(tried)):
                    _remove(tried)
        lock.unlink(missing_ok=True)


def _remove(folder: Path) -> None:
    """Remove a folder at once for other processes, which could put something into it while it is being removed."""
    removed = folder.with_name(f".{folder.name}.merged-{secrets.token_hex(4)}")
    folder.rename(removed)
    shutil.rmtree(removed, ignore_errors=True)


def _is_idle(folder: Path) -> bool:
    """Whether nobody is making a part in a folder."""
    try:
        for lock in folder.glob(".*.making"):
            with held(lock, 0):
                pass
    except (Timeout, OSError):
        return False
    return True


def _name(part: Cases) -> str:
    return f"{part.split}-{part.start}-{part.stop}"


def is_made(directory: Path) -> bool:
    """Whether a part is there, to its last case. Raises InputError where its manifest is damaged."""
    manifest = checked(directory, ()) if (directory / MANIFEST).exists() else None
    return manifest is not None and not manifest.interrupted


def finished(folders: Sequence[Path]) -> tuple[list[Path], bool]:
    """The parts of a run that are there to their last case, up to the first one that is missing.

    Args:
        folders: The folders of its parts, such as those of shards on several machines.

    Returns:
        Their directories, and whether these are all parts.

    Raises:
        InputError: One of them is no such folder, or one of another run.
    """
    requests = [_request(folder) for folder in folders]
    for folder, request in zip(folders, requests, strict=True):
        if request != requests[0]:
            raise InputError(f"{folders[0]} and {folder} hold parts of different runs: their {REQUEST} differ")
    parts = list(Cases.parse(requests[0]["cases"]).batches(requests[0]["batch"]))
    there = [next(filter(is_made, (folder / _name(part) for folder in folders)), None) for part in parts]
    made = [directory for directory in itertools.takewhile(bool, there) if directory]
    return made, len(made) == len(parts)


def _request(folder: Path) -> dict[str, Any]:
    try:
        request = files.read_json(folder / REQUEST)
        list(Cases.parse(request["cases"]).batches(request["batch"]))
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{folder} is no folder with the parts of a run") from None
    return dict(request)
