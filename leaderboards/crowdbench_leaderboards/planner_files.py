"""The files of an entry's planner: copied into the entry, checked and located there."""

from __future__ import annotations

import contextlib
import filecmp
import hashlib
import itertools
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import safetensors

from crowdbench import PLANNERS, InputError
from crowdbench.plugins import file_and_function, read_files
from crowdbench.utils import sha256

PLANNER = "planner"
"""The folder of the planner's files in an entry."""

LARGEST, MOST_FILES = 50e6, 100
"""Bytes and number of all files of an entry, at most: entries are kept in git."""

TEXTS = {".py", ".toml", ".md", ".txt", ".csv", ".json"}
ARRAYS = {".safetensors", ".onnx", ".npz"}
"""Suffixes of the files that a planner may have. A file without one of them must be a text, such as a program."""

FILE_NAME = rf"{PLANNER}(/[A-Za-z0-9_][A-Za-z0-9_.+-]*)+"
"""The pattern of the path of a planner's file in an entry."""

EXTERNAL = re.compile("sha256:[0-9a-f]{64}")
"""The pattern of an option that names a file outside of the entry, which a verification needs."""

Files = Mapping[str, Path]
"""The files that `EXTERNAL` options name, by these options."""


def external_files(paths: list[Path]) -> dict[str, Path]:
    """Return files by their names as options. Raises InputError if a file cannot be read."""
    try:
        return {f"sha256:{sha256(path)}": path.resolve() for path in paths}
    except OSError as error:
        raise InputError(f"a file of --file cannot be read: {error}") from None


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


def locate_named_files(value: Any, folder: Path, external: Files = {}) -> Any:  # noqa: B006, it is only read
    """Return the planner of an entry, or the value of an option, with the full paths of the files that it names.

    Raises InputError if a file outside of the entry is not given.
    """

    def locate(text: str) -> str:
        if EXTERNAL.fullmatch(text):
            if text not in external:
                raise InputError(f"the entry needs a file that is not in it, {text}: give it, --file PATH")
            return str(external[text])
        file, function = file_and_function(text)
        path = folder.resolve() / (file or text)
        if "/" not in text or not path.is_file():
            return text
        return f"{path}:{function}" if function else str(path)

    return _map_texts(locate, value)


def named_externals(value: Any) -> list[str]:
    """Return the options in a value that name files outside of the entry."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list):
        return [name for item in value for name in named_externals(item)]
    return [value] if isinstance(value, str) and EXTERNAL.fullmatch(value) else []


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
            shutil.copyfile(path.parent / name, target / name)
            # As git stores it. It may be a program; only its owner may read what safetensors has written.
            (target / name).chmod(0o755 if os.access(path.parent / name, os.X_OK) else 0o644)
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
    """Raise InputError if an entry has too many or too large files, or one that is neither text nor arrays."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir()]
    if len(paths) > MOST_FILES:
        raise InputError(f"{folder} has {len(paths)} files, but an entry may have {MOST_FILES}")
    for path in paths:
        if path.is_symlink() or not path.is_file():
            raise InputError(f"{path} is not a plain file: an entry holds nothing else")
    size = sum(path.stat().st_size for path in paths)
    if size > LARGEST:
        raise InputError(f"{folder} has {size / 1e6:.0f} MB, but an entry may have {LARGEST / 1e6:g} MB")
    for path in (folder / PLANNER).rglob("*"):
        if path.is_file() and (why := _why_refused(path)):
            raise InputError(f"{path} {why}; allowed are {', '.join(sorted(TEXTS | ARRAYS))}: remove it")


def _why_refused(path: Path) -> str:
    """Return why an entry may not have a file; empty if it may."""
    if path.suffix not in TEXTS | ARRAYS | {""} or "__pycache__" in path.parts:
        return "is not of a kind that an entry may have"
    if path.suffix == ".npz":
        return _why_no_arrays(path)
    if path.suffix in ARRAYS:
        return "holds an archive" if zipfile.is_zipfile(path) else _why_no_tensors(path)
    try:
        text = path.read_bytes().decode()
    except UnicodeDecodeError:
        return "is no text in UTF-8"
    return "is no text: it has control characters" if re.search(r"[\0-\x08\x0e-\x1f\x7f]", text) else ""


def _why_no_tensors(path: Path) -> str:
    """Return why a file is neither safetensors nor ONNX, by its first bytes; empty if it may be one."""
    with path.open("rb") as file:
        head = file.read(9)
    length = int.from_bytes(head[:8], "little")
    is_safetensors = head[8:] == b"{" and length < path.stat().st_size
    is_onnx = head[:1] == b"\x08" and head[2:3] in b"\x12\x1a\x22\x2a\x3a"  # ir_version, then another field
    right = is_safetensors if path.suffix == ".safetensors" else is_onnx
    return "" if right else f"does not begin like a {path.suffix} file"


def _why_no_arrays(path: Path) -> str:
    """Return why a file is no archive of arrays without objects; empty if it is one."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if any(Path(member.filename).suffix != ".npy" for member in members):
                return "holds something else than arrays"
            if sum(member.file_size for member in members) > LARGEST:
                return f"unpacks to more than {LARGEST / 1e6:g} MB"
            heads = [archive.open(member).read(1024) for member in members]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, RuntimeError):
        return "is no archive of arrays"
    is_plain = all(head.startswith(b"\x93NUMPY") and b"'|O'" not in head for head in heads)
    return "" if is_plain else "holds Python objects or something else than arrays"


def contents(value: Any, folder: Path) -> Any:
    """Return the value of an option of an entry, with the names of files replaced by their digests.

    Two files of weights with the same tensors have the same digest, even if their other contents differ.
    """

    def digest(text: str) -> str:
        path = folder / text
        if "/" not in text or not path.is_file():
            return text
        content = path.read_bytes()
        with contextlib.suppress(safetensors.SafetensorError):
            tensors = dict(safetensors.deserialize(content))  # type: ignore[no-untyped-call]
            content = b"".join(tensors[name]["data"] for name in sorted(tensors))
        return hashlib.sha256(content).hexdigest()

    return _map_texts(digest, value)


def check_planner(planner: str) -> None:
    """Raise InputError if the planner of an entry is neither one of its files nor one that ships."""
    if not planner.startswith(f"{PLANNER}/") and planner not in PLANNERS.built_in():
        raise InputError(f"no planner that ships is called {planner!r}, and it is no file of {PLANNER}/")
