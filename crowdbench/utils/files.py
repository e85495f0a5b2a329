"""Files that appear under their name only once they are complete, files that can be read to their end, and locks."""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import json
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from filelock import FileLock


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path to write to: the file is renamed to `path` if all goes well, and removed otherwise."""
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def hold_lock(path: Path, patience: float = -1) -> Iterator[None]:
    """Hold a lock. On a file system without locks there is none.

    Args:
        path: The lock's file.
        patience: Seconds to wait for a process that holds it; below 0, as long as it takes.

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


def half_written(path: Path) -> list[Path]:
    """What killed processes have left of files that were to become `path` by `whole`."""
    return sorted(path.parent.glob(f".{glob.escape(path.name)}.{'[0-9a-f]' * 8}"))


def check_regular(path: Path) -> None:
    """Raise OSError, which says why, unless a path is a file: reading a pipe or a device might never end."""
    try:
        mode = path.stat().st_mode
    except ValueError:
        raise OSError(errno.EINVAL, "its name holds a null character") from None
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))


def read_regular(path: Path) -> bytes:
    """The content of a file. Raises OSError where it cannot be read, or may never end, like a pipe or a device."""
    check_regular(path)
    return path.read_bytes()


def read_text(path: Path) -> str:
    """The text of a file. Raises OSError as `read_regular` does, and UnicodeDecodeError where it is not UTF-8."""
    check_regular(path)
    return path.read_text(encoding="utf-8")


def read_json(path: Path) -> Any:
    """What a JSON file holds. Raises OSError where it cannot be read, and ValueError where it is no JSON."""
    try:
        return json.loads(read_text(path))
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def sha256(path: Path) -> str:
    """The sha256 of a file of any size. Raises OSError where it cannot be read."""
    check_regular(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
