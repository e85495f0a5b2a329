"""The folder of the pages, which gets its name only once all pages are written."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from crowdbench.errors import InputError

INDEX = "index.html"

MARK = '<meta name="generator" content="crowdbench leaderboard build">'
"""What the first page of every site holds, so that no other folder is replaced."""


@contextlib.contextmanager
def site_folder(path: Path) -> Iterator[Path]:
    """A folder to write into, which replaces an earlier site at `path` if all goes well, and is removed otherwise.

    Args:
        path: The name that it gets.

    Raises:
        InputError: `path` holds something other than a site, or cannot be written.
    """
    path = path.resolve()
    token = secrets.token_hex(4)
    partial, earlier = (path.with_name(f".{path.name}.{role}-{token}") for role in ("partial", "earlier"))
    try:
        _check_replaceable(path)
        partial.mkdir(parents=True)
        try:
            yield partial
            if path.exists():
                path.rename(earlier)
            partial.rename(path)
        finally:
            _restore(earlier, path)
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}; nothing was kept") from error


def _check_replaceable(path: Path) -> None:
    """Raise InputError where `path` holds something that no build has made."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file: name a folder with --out")
    if not path.exists() or not any(path.iterdir()):
        return
    index = path / INDEX
    if not index.is_file() or MARK not in index.read_text(encoding="utf-8", errors="replace"):
        raise InputError(f"{path} holds something other than the pages of leaderboards: choose another --out")


def _restore(earlier: Path, path: Path) -> None:
    """Remove the earlier site, or give it its name back where the new one did not get it."""
    if not earlier.exists():
        return
    if path.exists():
        shutil.rmtree(earlier, ignore_errors=True)
    else:
        earlier.rename(path)
