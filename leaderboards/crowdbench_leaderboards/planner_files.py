"""The files of an entry's planner: copied into the entry and located there, or the files of a package."""

from __future__ import annotations

import contextlib
import filecmp
import hashlib
import importlib.metadata
import itertools
import json
import shutil
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from crowdbench import PLANNERS, InputError
from crowdbench.plugins import file_and_function, read_files

PLANNER = "planner"
"""The folder of the planner's files in an entry."""

LARGEST, LARGEST_FILE = 25e6, 10e6
"""Bytes of all files of an entry, and of one file, at most: entries are kept in git."""

_COMPILED = {".pyc", ".pyo", ".so", ".pyd", ".dll", ".dylib", ".o", ".a"}
_ARCHIVES = b"\x1f\x8b", b"\x1f\x9d", b"BZh", b"\xfd7zXZ\0", b"7z\xbc\xaf\x27\x1c", b"Rar!", b"\x28\xb5\x2f\xfd"
"""The first bytes of archives other than zip and tar."""

_ARRAYS = {".npz": {".npy"}, ".pt": {"", ".pkl"}, ".pth": {"", ".pkl"}}
"""Suffixes of the archives that an entry may contain, which hold arrays, and suffixes of the files in them."""


def copy_named_files(value: Any, folder: Path) -> Any:
    """Copy the files that a planner or the value of an option names into an entry.

    Args:
        value: The planner, or the value of an option: a text, or a table or list in which there may be texts.
        folder: The folder of the entry.

    Returns:
        The same value with the paths of the copies, relative to the folder.

    Raises:
        InputError: A file cannot be read, or a folder is named.
    """
    return _map_texts(lambda text: _copy(text, folder / PLANNER), value)


def locate_named_files(value: Any, folder: Path) -> Any:
    """Return the planner of an entry, or the value of an option, with the full paths of the files of the entry."""

    def locate(text: str) -> str:
        file, function = file_and_function(text)
        path = folder.resolve() / (file or text)
        if "/" not in text or not path.is_file():
            return text
        return f"{path}:{function}" if function else str(path)

    return _map_texts(locate, value)


def check_named_files(value: Any, folder: Path) -> None:
    """Raise InputError if the planner of an entry or an option names a file outside of `planner/`."""

    def check(text: str) -> str:
        if "/" in text and "\0" not in text:
            path = folder / (file_and_function(text)[0] or text)
            inside = (folder / PLANNER).resolve()
            if path.is_file() and (".." in path.parts or not path.resolve().is_relative_to(inside)):
                raise InputError(f"the entry {folder} names the file {text}, which does not lie in {PLANNER}/")
        return text

    _map_texts(check, value)


def _map_texts(change: Callable[[str], str], value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _map_texts(change, item) for name, item in value.items()}
    if isinstance(value, list):
        return [_map_texts(change, item) for item in value]
    return change(value) if isinstance(value, str) else value


def _copy(text: str, copies: Path) -> str:
    """Copy the files that a text names, and return their path in the entry; the text itself if it names none."""
    file, function = file_and_function(text)
    path = file or Path(text)
    try:
        if path.is_dir() and "/" in text:
            raise InputError(f"{text} is a folder: an entry takes files that are named one by one")
        if not path.is_file():
            return text
        path = path.resolve()  # the files beside a linked one are those beside its target
        names = list(read_files(path))
        if links := [name for name in names if (path.parent / name).is_symlink()]:
            raise InputError(f"{path.parent / links[0]} is a link: an entry takes plain files")
        folders = itertools.chain([copies], (copies / f"other_{number}" for number in itertools.count(2)))
        target = next(folder for folder in folders if _is_free(folder, path.parent, names))
        for name in names:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path.parent / name, target / name)  # with its permissions: it may be a program
    except (OSError, ValueError) as error:
        raise InputError(f"{text} cannot be copied: {getattr(error, 'strerror', None) or error}") from None
    copy = (target / path.name).relative_to(copies.parent).as_posix()
    return f"{copy}:{function}" if function else copy


def _is_free(folder: Path, source: Path, names: list[str]) -> bool:
    """Check if files are missing from a folder, or have the same contents there."""
    return all(
        not (folder / name).exists() or filecmp.cmp(folder / name, source / name, shallow=False) for name in names
    )


def check_files(folder: Path) -> None:
    """Raise InputError if a file of an entry is no plain file, too large, compiled, or an archive.

    A reader must be able to inspect the planner. The only allowed archives are archives of arrays.
    """
    paths = [path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir()]
    for path in paths:
        if path.is_symlink() or not path.is_file():
            raise InputError(f"{path} is not a plain file: an entry holds nothing else")
        if why := _why_refused(path):
            raise InputError(f"{path} {why}: remove it")
    size = sum(path.stat().st_size for path in paths)
    if size > LARGEST:
        raise InputError(f"the planner's files have {size / 1e6:.0f} MB, but an entry may have {LARGEST / 1e6:g} MB")


def _why_refused(path: Path) -> str:
    """Return why an entry may not have a plain file; empty if it may."""
    if path.stat().st_size > LARGEST_FILE:
        return f"has more than {LARGEST_FILE / 1e6:g} MB, which a file of an entry may have"
    with path.open("rb") as file:
        head = file.read(512)
    # All versions of Python begin a compiled file with a number of this range, a return and a line feed.
    is_bytecode = head[2:4] == b"\r\n" and 2900 < int.from_bytes(head[:2], "little") < 4900
    is_compiled = path.suffix.lower() in _COMPILED or head.startswith(b"\x7fELF") or "__pycache__" in path.parts
    if is_bytecode or is_compiled:
        return "is compiled: an entry holds what people can read"
    if head.startswith(_ARCHIVES) or head[257:262] == b"ustar":
        return "is an archive: an entry holds files"
    if zipfile.is_zipfile(path):
        return _why_archive_refused(path)
    return ""


def _why_archive_refused(path: Path) -> str:
    """Return why an entry may not have a zip archive; empty if it may."""
    allowed = _ARRAYS.get(path.suffix.lower(), set())
    with contextlib.suppress(zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        members = zipfile.ZipFile(path).infolist()
        if {Path(member.filename).suffix for member in members} <= allowed:
            is_large = sum(member.file_size for member in members) > LARGEST
            return f"unpacks to more than {LARGEST / 1e6:g} MB" if is_large else ""
    return "is an archive of something else than arrays: an entry holds files"


def contents(value: Any, folder: Path) -> Any:
    """Return the value of an option of an entry, with the names of files replaced by their digests.

    Two files of weights with the same tensors have the same digest, even if their other contents differ.
    """

    def digest(text: str) -> str:
        path = folder / text
        if "/" not in text or not path.is_file():
            return text
        content = path.read_bytes()
        with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
            start = 8 + int.from_bytes(content[:8], "little")
            tensors = sorted(json.loads(content[8:start]).items())
            spans = [tensor["data_offsets"] for name, tensor in tensors if name != "__metadata__"]
            if sum(last - first for first, last in spans) <= len(content):
                content = b"".join(content[start + first : start + last] for first, last in spans)
        return hashlib.sha256(content).hexdigest()

    return _map_texts(digest, value)


def package(planner: str) -> str:
    """Return the distribution with its version that a planner comes from; empty if its files are in the entry."""
    if planner.startswith(f"{PLANNER}/"):
        return ""
    source = PLANNERS.sources().get(planner)
    if isinstance(source, importlib.metadata.EntryPoint) and source.dist is not None:
        return f"{source.dist.name}=={source.dist.version}"
    return f"crowdbench=={importlib.metadata.version('crowdbench')}"


def package_files(planner: str) -> dict[str, str]:
    """Return the sha256 of the Python files of a planner of another distribution than crowdbench, by path.

    The planner is not loaded, because an entry may name any planner.

    Raises:
        InputError: There is no planner of that name.
    """
    if planner.startswith(f"{PLANNER}/"):
        return {}
    if planner not in PLANNERS.sources():
        raise InputError(f"no planner that is built in or installed is called {planner!r}")
    if planner in PLANNERS.built_in():
        return {}
    return PLANNERS.files(planner)
