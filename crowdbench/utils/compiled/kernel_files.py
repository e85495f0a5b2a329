"""Stores compiled kernels in files with a checksum, in the first folder that can be written.

The folder is `crowdbench/kernels` in the cache of the user (`XDG_CACHE_HOME`, or else `~/.cache`), or in
`NUMBA_CACHE_DIR` if that is set, or else in the folder for temporary files. All installations of a user share it,
because files are named by their content. Files that have not been used for long are removed.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from numba.core import config
from numba.misc.appdirs import AppDirs

from crowdbench.utils.files import write_whole

DAY = 86400.0
LONGEST_UNUSED = 90 * DAY
LARGEST_FOLDER = 256e6
"""Bytes. All kernels take about 15 MB."""


class _Place(NamedTuple):
    folder: Path
    private: bool
    """True if other users could have made the folder: it is used only if no other user has access to it."""


def read(name: str) -> bytes | None:
    """Return the content that was written under a name, or None if it is missing or damaged."""
    for place in _places():
        path = place.folder / name
        with contextlib.suppress(OSError), path.open("rb") as file:
            status = os.fstat(file.fileno())
            if place.private and status.st_uid != _user():
                continue
            checksum, payload = file.read(hashlib.sha256().digest_size), file.read()
            if hashlib.sha256(payload).digest() == checksum:
                if time.time() - status.st_mtime > DAY:
                    with contextlib.suppress(OSError):  # the time of its last use, for `_remove_unused`
                        os.utime(path)
                return payload
    return None


def write(name: str, payload: bytes) -> None:
    """Write to the last folder. Do nothing if there is none or writing fails: a full disk must not stop a run.

    Args:
        name: The file's name.
        payload: Content after the checksum.
    """
    if not _places():
        return
    folder = _places()[-1].folder
    with contextlib.suppress(OSError):
        with write_whole(folder / name) as partial:
            partial.write_bytes(hashlib.sha256(payload).digest() + payload)
        _remove_unused(folder)


@functools.cache
def _remove_unused(folder: Path) -> None:
    """Remove kernels not used for long, and the least recently used ones above `LARGEST_FOLDER`; once per process."""
    files: list[tuple[float, int, Path]] = []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # another process has removed it
            status = path.stat()
            files.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in files)
    for used, size, path in sorted(files):
        if time.time() - used > LONGEST_UNUSED or total > LARGEST_FOLDER:
            path.unlink(missing_ok=True)
            total -= size


def folders() -> list[Path]:
    """Return the folders that compiled kernels are read from."""
    return [place.folder for place in _places()]


@functools.cache
def _places() -> tuple[_Place, ...]:
    """Return the places to read from, of which the last one can be written if any can."""
    places = []
    for place in _candidates():
        if not place.private or _make_private(place.folder):
            places.append(place)
            if _is_writable(place.folder):
                break
    return tuple(places)


def _candidates() -> Iterator[_Place]:
    if config.CACHE_DIR:
        yield _Place(Path(config.CACHE_DIR).absolute() / "crowdbench" / "kernels", private=False)
    user_cache = Path(AppDirs("crowdbench", appauthor=False).user_cache_dir)
    if user_cache.is_absolute():  # it is not, for a user without a home
        yield _Place(user_cache / "kernels", private=True)
    with contextlib.suppress(OSError):
        yield _Place(Path(tempfile.gettempdir()) / f"crowdbench-{_user()}", private=True)


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Permissions are not sufficient: the file system may be read-only.
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _make_private(folder: Path) -> bool:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return False
    only_mine = os.name == "nt" or not stat.S_IMODE(status.st_mode) & 0o077
    return stat.S_ISDIR(status.st_mode) and status.st_uid == _user() and only_mine


def _user() -> int:
    """Return the number of the user, 0 on Windows, where it is also the owner of every file."""
    return os.geteuid() if hasattr(os, "geteuid") else 0
