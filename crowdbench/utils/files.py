"""Writes files and directories that get their name only when they are complete; holds locks; reads regular files."""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import json
import math
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from filelock import FileLock

from crowdbench.utils.errors import InputError, NotWritten

# Beside the directory `runs/a`, while a run is under way:
#   runs/.a.partial-<token>  what it has written so far
#   runs/.a.lock-<token>     locked by its process, and unlocked once that process has been killed
#   runs/.a.earlier-<token>  the earlier run, only while it is replaced
_LOCK = re.compile(r"(\..*\.)lock-([0-9a-f]{8})", re.DOTALL)

RUN = "result.json"
"""A directory that holds this file is a run, and may be replaced by another one."""

PATIENCE = 1.0
"""Seconds to wait for a lock while another process tests whether it is held."""


@contextlib.contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """Yield a path to write to: the file is renamed to `path` if all goes well, and removed otherwise."""
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def hold_lock(path: Path, patience: float = -1) -> Iterator[None]:
    """Hold a lock. Do nothing on a file system without locks.

    Args:
        path: The lock's file.
        patience: Seconds to wait for a process that holds it; below 0, wait without limit.

    Raises:
        Timeout: Another process still holds it.
    """
    lock = FileLock(path, timeout=patience)
    with contextlib.suppress(NotImplementedError):
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def half_written(directory: Path) -> list[Path]:
    """Return the files that killed processes have left half-written by `whole` in a directory."""
    return sorted(directory.glob(f".*.{'[0-9a-f]' * 8}"))


@contextlib.contextmanager
def new_directory(path: Path, overwrite: bool, mark: str = RUN) -> Iterator[Path]:
    """Yield a directory to write into, which is renamed to `path` if all goes well, and removed otherwise.

    Args:
        path: The final path of the directory.
        overwrite: True to replace an earlier directory of that path.
        mark: A file that the earlier directory must contain, so that no other directory is replaced.

    Raises:
        NotWritten: `path` exists and may not be overwritten, or cannot be written.
    """
    path = check_free(path, overwrite, mark)
    try:
        with parent_of(path), _partial(path) as partial:
            yield partial
            _move(partial, path, overwrite)
    except OSError as error:
        raise NotWritten(f"{path} cannot be written: {error.strerror or error}; nothing was kept") from error


def check_free(path: Path, overwrite: bool, mark: str = RUN) -> Path:
    """Check in advance whether `new_directory` can write; its arguments and errors are the same."""
    try:
        path = path.resolve()
        # Before all checks: an interrupted replacement may have renamed an earlier run.
        _restore_earlier(path)
        is_there, is_directory = path.exists(), path.is_dir()
        holds_other = overwrite and is_directory and any(path.iterdir()) and not (path / mark).is_file()
    except (OSError, RuntimeError, ValueError) as error:
        raise NotWritten(f"{path} cannot be written: {getattr(error, 'strerror', None) or error}") from error
    if is_there and not is_directory:
        raise NotWritten(f"{path} is a file: name a directory with --out")
    if is_there and not overwrite:
        another = "name another place with --out, or allow --overwrite (in Python overwrite=True)"
        raise NotWritten(f"{path} exists already: {another}")
    if holds_other:
        raise NotWritten(f"{path} holds something other than a run and is not overwritten: choose another --out")
    return path


@contextlib.contextmanager
def parent_of(path: Path) -> Iterator[None]:
    """Make the parent folder of `path`, and remove it again if it is new and stays empty."""
    is_new = not path.parent.exists()
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        if is_new:
            with contextlib.suppress(OSError):  # raised if it contains a run
                path.parent.rmdir()


@contextlib.contextmanager
def _partial(path: Path) -> Iterator[Path]:
    """Yield a directory beside `path`. It is locked while it is written, and removed unless it is renamed.

    Files that killed processes left in the same folder are removed first.
    """
    _clear_abandoned(path.parent)
    token = secrets.token_hex(4)
    partial = path.with_name(f".{path.name}.partial-{token}")
    lock = path.with_name(f".{path.name}.lock-{token}")
    try:
        # First, because FileLock would wait if the file cannot be made.
        lock.touch()
        with hold_lock(lock, PATIENCE):
            try:
                partial.mkdir()
                yield partial
            finally:
                shutil.rmtree(partial, ignore_errors=True)
    finally:
        _release(lock, partial)


def _clear_abandoned(folder: Path) -> None:
    """Remove partial directories of killed processes from a folder: directories with a lock that no process holds."""
    with contextlib.suppress(OSError):  # raised if the folder does not exist yet, or cannot be read
        for name in os.listdir(folder):
            match = _LOCK.fullmatch(name)
            if match is None:
                continue
            lock, partial = folder / name, folder / f"{match[1]}partial-{match[2]}"
            # Raised if the lock is held, because its process is alive, if the file belongs to another user, and on a
            # file system without locks, on which `hold_lock` would continue.
            with contextlib.suppress(OSError, NotImplementedError), FileLock(lock, timeout=0):
                shutil.rmtree(partial, ignore_errors=True)
                _release(lock, partial)


def _release(lock: Path, partial: Path) -> None:
    """Remove a lock, unless its partial directory still exists."""
    if not partial.exists():
        lock.unlink(missing_ok=True)


def _move(partial: Path, path: Path, overwrite: bool) -> None:
    """Rename the finished directory to `path`. An earlier run is removed only after that."""
    earlier = path.with_name(f".{path.name}.earlier-{secrets.token_hex(4)}")
    if overwrite and path.exists():
        path.rename(earlier)
    try:
        partial.rename(path)
    except OSError as error:
        if earlier.exists():
            earlier.rename(path)
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            raise NotWritten(f"{path} was written by another run meanwhile, which is kept; this one is not") from None
        raise
    shutil.rmtree(earlier, ignore_errors=True)


def _restore_earlier(path: Path) -> None:
    """Rename an earlier run back if its replacement was killed before the end; remove it if it was replaced."""
    for earlier in list(path.parent.glob(f".{glob.escape(path.name)}.earlier-*")):
        if path.exists():
            shutil.rmtree(earlier, ignore_errors=True)
        else:
            earlier.rename(path)


LARGEST = 500e6
"""Bytes of the largest file that is read as a whole."""


def check_regular(path: Path, largest: float = LARGEST) -> None:
    """Raise OSError with the reason unless a path is a regular file of at most `largest` bytes.

    Reading a pipe or a device might never end, and a large file takes memory.
    """
    try:
        status = path.stat()
    except ValueError:
        raise OSError(errno.EINVAL, "its name holds a null character") from None
    if stat.S_ISDIR(status.st_mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    if status.st_size > largest:
        raise OSError(errno.EFBIG, f"it has {status.st_size / 1e9:.1f} GB, more than {largest / 1e9:g} GB", str(path))


def read_regular(path: Path) -> bytes:
    """Return the content of a file. Raises OSError if it cannot be read, or is no regular file."""
    check_regular(path)
    return path.read_bytes()


def read_text(path: Path) -> str:
    """Return the text of a file without a byte-order mark.

    Raises:
        OSError: As `read_regular` raises it.
        UnicodeDecodeError: The file is not UTF-8.
    """
    check_regular(path)
    return path.read_text(encoding="utf-8-sig")


def read_json(path: Path) -> Any:
    """Return the content of a JSON file. Raises OSError if it cannot be read, and InputError if it is not JSON."""
    try:
        return json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise InputError(f"{path} is not valid JSON: {reason}") from None


def sha256(path: Path) -> str:
    """Return the sha256 of a file of any size. Raises OSError if it cannot be read."""
    check_regular(path, math.inf)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
