"""The planners that ship are entered by the maintainers: their entries and verifications lie in one file of each board.

leaderboards/<board>/baselines.zip    entries/<name>/... and verifications/<name>/...
"""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
import zipfile
from collections.abc import Iterable
from pathlib import Path

from crowdbench.boards.entry import ENTRY
from crowdbench.boards.submission import ENTRIES
from crowdbench.boards.verdict import VERIFICATIONS
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

PACK = "baselines.zip"

_DATE = (1980, 1, 1, 0, 0, 0)
"""Of all files, so that the same entries make the same file."""


def entry_folders(board: Path) -> list[Path]:
    """The folders of the entries of a board by name, whether they are packed or not.

    Raises InputError where its file of packed entries is damaged.
    """
    places = [_unpack(board), board]
    found = {path.parent.name: path.parent for place in places for path in place.glob(f"{ENTRIES}/*/{ENTRY}")}
    return [found[name] for name in sorted(found)]


def find_entry(directory: Path) -> Path:
    """The folder of an entry, where its own one is packed."""
    packed = _unpack(directory.parent.parent) / ENTRIES / directory.name
    return packed if packed.is_dir() and not directory.exists() else directory


def pack(board: Path, names: Iterable[str]) -> None:
    """Move entries and their verifications into the file of packed ones.

    Args:
        board: The folder of the board.
        names: The names of the entries.

    Raises:
        InputError: The file of packed entries is damaged.
    """
    own = [board / kind / name for kind in (ENTRIES, VERIFICATIONS) for name in names if (board / kind / name).is_dir()]
    if not own:
        return
    packed = _unpack(board)
    found = {} if packed == board else _files(packed, packed)
    for folder in own:
        found |= _files(folder, board)
    with files.whole(board / PACK) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name in sorted(found):
            archive.writestr(zipfile.ZipInfo(name, _DATE), found[name].read_bytes(), zipfile.ZIP_DEFLATED)
    for folder in own:
        shutil.rmtree(folder)


def _files(folder: Path, relative_to: Path) -> dict[str, Path]:
    return {path.relative_to(relative_to).as_posix(): path for path in folder.rglob("*") if path.is_file()}


def _unpack(board: Path) -> Path:
    """A folder with the packed entries of a board; the board's own where none is packed."""
    path = board / PACK
    return _extract(path, path.stat().st_mtime_ns) if path.is_file() else board


@functools.cache
def _extract(path: Path, _modified: int) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="crowdbench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    try:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
    except (zipfile.BadZipFile, OSError) as error:
        raise InputError(f"{path} is damaged: {error}") from None
    return folder
