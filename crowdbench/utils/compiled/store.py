"""Where compiled kernels are kept: in files with a checksum, in the first folder that can be written."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from numba.core import config
from numba.misc.appdirs import AppDirs

from crowdbench.utils.files import whole

PACKAGE = Path(__file__).parent.parent.parent


class Entry(NamedTuple):
    """What a file is named after."""

    kernel: str
    code: str
    """The digest of the kernel's code. A file of the same kernel with another digest is out of date."""
    variant: str
    """The digest of the signature and the processor."""

    @property
    def file_name(self) -> str:
        """The file's name. Versions of Python do not remove each other's files."""
        return f"{self.kernel}-{self.code}-{self.variant}.{sys.implementation.cache_tag}"


class _Place(NamedTuple):
    folder: Path
    private: bool
    """Whether others could have prepared the folder: one that does not belong to this user alone is not used."""


def read(entry: Entry) -> bytes | None:
    """What was written, or None if it is not there or damaged."""
    for place in _places():
        with contextlib.suppress(OSError), (place.folder / entry.file_name).open("rb") as file:
            if place.private and os.fstat(file.fileno()).st_uid != _user():
                continue
            checksum, payload = file.read(hashlib.sha256().digest_size), file.read()
            if hashlib.sha256(payload).digest() == checksum:
                return payload
    return None


def write(entry: Entry, payload: bytes) -> None:
    """Write to the last place, unless that fails: a full disk must not stop a run. Out-of-date files are removed.

    Args:
        entry: What the file is named after.
        payload: What is written after the checksum.
    """
    folder = _places()[-1].folder
    with contextlib.suppress(OSError):
        with whole(folder / entry.file_name) as partial:
            partial.write_bytes(hashlib.sha256(payload).digest() + payload)
        for path in folder.glob(f"*{entry.kernel}-*.{sys.implementation.cache_tag}*"):
            # A process that was killed leaves a partial file, whose name begins with a dot.
            name = path.name.removeprefix(".")
            if name.startswith(f"{entry.kernel}-") and not name.startswith(f"{entry.kernel}-{entry.code}-"):
                path.unlink(missing_ok=True)


def folders() -> list[Path]:
    """The folders that compiled kernels are read from."""
    return [place.folder for place in _places()]


@functools.cache
def _places() -> tuple[_Place, ...]:
    """The places to read from, of which the last one can be written if any can."""
    places = []
    for place in _candidates():
        if not place.private or _make_private(place.folder):
            places.append(place)
            if _is_writable(place.folder):
                break
    return tuple(places)


def _candidates() -> Iterator[_Place]:
    installation = hashlib.sha256(os.fsencode(PACKAGE)).hexdigest()[:16]
    if config.CACHE_DIR:
        yield _Place(Path(config.CACHE_DIR).absolute() / f"crowdbench-{installation}", private=False)
    yield _Place(PACKAGE / "__pycache__" / "kernels", private=False)
    user_cache = Path(AppDirs("crowdbench", appauthor=False).user_cache_dir)
    if user_cache.is_absolute():  # it is not, for a user without a home
        yield _Place(user_cache / installation, private=True)
    with contextlib.suppress(OSError):
        yield _Place(Path(tempfile.gettempdir()) / f"crowdbench-{_user()}-{installation}", private=True)


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Permissions alone do not tell: the file system may be read-only.
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _make_private(folder: Path) -> bool:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    only_mine = os.name == "nt" or not stat.S_IMODE(found.st_mode) & 0o077
    return stat.S_ISDIR(found.st_mode) and found.st_uid == _user() and only_mine


def _user() -> int:
    """The number of the user, 0 on Windows, where it is also the owner of every file."""
    return os.geteuid() if hasattr(os, "geteuid") else 0
