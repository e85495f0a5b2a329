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
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from crowdbench import files
from crowdbench.errors import InputError
from crowdbench.evaluate.directory import check_free, parent_of
from crowdbench.evaluate.merge import merge
from crowdbench.evaluate.seal import MANIFEST, checked
from crowdbench.scenario.cases import Cases

ENDING = ".parts-"

REQUEST = "request.json"
"""What the parts of a folder are parts of, with all that their figures depend on."""

PATIENCE = 0.5
"""Seconds between two looks at parts that other processes are making."""

Drive = Callable[[Cases, Path], None]
"""Makes the run of some cases in a directory, or raises and leaves a directory that is not complete."""


@dataclass(frozen=True)
class Shard:
    """One of several equal shares of a run's parts, written `2/8`.

    Attributes:
        number: Which one, counted from 1.
        count: How many there are.
    """

    number: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read `2/8`. Raises InputError where the text has another form, or there is no such shard."""
        match = re.fullmatch("([0-9]{1,9})/([0-9]{1,9})", text)
        if match and 1 <= int(match[1]) <= int(match[2]):
            return cls(int(match[1]), int(match[2]))
        raise InputError(f"{text!r} is no shard: write 2/8 for the second of eight")

    def own(self, parts: Sequence[Cases]) -> list[Cases]:
        """Its share of the parts of a run."""
        return list(parts[self.number - 1 :: self.count])


WHOLE = Shard()


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


class _PutTogether(Exception):
    """Another process has put the parts together and removed them."""


def make(
    drive: Drive,
    cases: Cases,
    out: Path,
    request: Mapping[str, Any],
    *,
    batch: int,
    shard: Shard = WHOLE,
    overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Made:
    """Make a run, or a shard of it, going on from what is there. The run is put together once all parts are there.

    Args:
        drive: Makes a part.
        cases: The cases of the run.
        out: The directory of the run.
        request: All that its figures depend on.
        batch: Cases of a part.
        shard: Which parts to make.
        overwrite: Whether an earlier run in `out` is replaced.
        progress: Called with the number of cases of parts that were there before.

    Returns:
        What is there now.

    Raises:
        InputError: `out` is taken, or as `drive` raises it.
        KeyboardInterrupt: Somebody interrupted it. The parts that are finished are kept.
    """
    check_free(out, overwrite)
    wanted = json.dumps({**request, "cases": str(cases), "batch": batch}, indent=2, sort_keys=True) + "\n"
    folder = out.with_name(f"{out.name}{ENDING}{hashlib.sha256(wanted.encode()).hexdigest()[:8]}")
    parts = list(cases.batches(batch))
    with parent_of(out), _kept(folder, wanted, parts):
        # Another process that has the same command may put the parts together, and remove the folder, at any time.
        with contextlib.suppress(_PutTogether):
            _make_parts(drive, folder, shard.own(parts), progress)
            if len(_made(folder, parts)) == len(parts):
                _put_together(folder, parts, out, overwrite)
        if not (folder / REQUEST).exists():
            shutil.rmtree(folder, ignore_errors=True)  # locks are made with their folder
            return Made(folder, len(cases), is_whole=True)
        return Made(folder, sum(map(len, _made(folder, parts))), is_whole=False)


def _make_parts(drive: Drive, folder: Path, parts: Sequence[Cases], progress: Callable[[float], None] | None) -> None:
    """Make all of these parts that nobody else makes, and wait for the others."""
    waiting = parts
    while waiting:
        left = [part for part in waiting if not _make_part(drive, folder, part, progress)]
        if len(left) == len(waiting):
            time.sleep(PATIENCE)
        waiting = left


def _made(folder: Path, parts: Sequence[Cases]) -> list[Cases]:
    return [part for part in parts if is_made(folder / _name(part))]


def _put_together(folder: Path, parts: Sequence[Cases], out: Path, overwrite: bool) -> None:
    """Merge the parts of a run, unless another process has done it, and remove them, and those of earlier tries."""
    with FileLock(folder.with_name(f".{folder.name}.merging")) as lock:
        if is_made(folder / _name(parts[0])):
            merge([folder / _name(part) for part in parts], out, overwrite)
            for tried in out.parent.glob(f"{glob.escape(out.name)}{ENDING}{'[0-9a-f]' * 8}"):
                if tried == folder or _is_idle(tried):
                    _remove(tried)
            Path(lock.lock_file).unlink(missing_ok=True)


def _remove(folder: Path) -> None:
    """Remove a folder at once for other processes, which could put something into it while it is being removed."""
    removed = folder.with_name(f".{folder.name}.merged-{secrets.token_hex(4)}")
    folder.rename(removed)
    shutil.rmtree(removed, ignore_errors=True)


def _is_idle(folder: Path) -> bool:
    """Whether nobody is making a part in a folder."""
    try:
        for lock in folder.glob(".*.making"):
            with FileLock(lock, timeout=0):
                pass
    except (Timeout, OSError):
        return False
    return True


def _make_part(drive: Drive, folder: Path, part: Cases, progress: Callable[[float], None] | None) -> bool:
    """Make a part, unless it is there; False where another process is making it."""
    directory = folder / _name(part)
    try:
        with FileLock(folder / f".{directory.name}.making", timeout=0):
            if is_made(directory):
                if progress is not None:
                    progress(len(part))
            elif (folder / REQUEST).exists():
                drive(part, directory)
            else:
                raise _PutTogether
            return True
    except Timeout:
        return False


def _name(part: Cases) -> str:
    return f"{part.split}-{part.start}-{part.stop}"


def is_made(directory: Path) -> bool:
    """Whether a part is there, to its last case. Raises InputError where its manifest is damaged."""
    manifest = checked(directory, ()) if (directory / MANIFEST).exists() else None
    return manifest is not None and not manifest.interrupted


@contextlib.contextmanager
def _kept(folder: Path, request: str, parts: Sequence[Cases]) -> Iterator[None]:
    """Make a folder of parts, and say what is in it where the run does not end. An empty one is removed again."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with files.whole(folder / REQUEST) as partial:
            partial.write_text(request, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror or error}") from None
    try:
        yield
    except (KeyboardInterrupt, InputError) as error:
        cases = sum(map(len, _made(folder, parts)))
        if not cases:
            raise
        kept = f"{cases} of {sum(map(len, parts))} cases are kept in {folder}"
        goes_on = f"the same command goes on with them, and `crowdbench merge {folder} --out DIR` makes a run of them"
        raise type(error)(f"{str(error) or 'interrupted'}: {kept}; {goes_on}") from error
    finally:
        if folder.exists() and not any(each.is_dir() for each in folder.iterdir()) and _is_idle(folder):
            shutil.rmtree(folder, ignore_errors=True)


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
