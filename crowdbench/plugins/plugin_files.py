"""The files of a plug-in: its main file, and the files beside it that it imports."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator, Mapping
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from pathlib import Path

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import sha256

_SUFFIXES = (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)


def read_files(file: Path) -> dict[str, str]:
    """Return the sha256 of a file and of those that belong to it, by path in its folder. No file is executed.

    To a Python file belong the modules beside it that it imports, directly or indirectly, also in functions. A package
    beside it counts with all its files. A module whose name is computed at run time is not found. To a file of weights
    belongs its card.

    Args:
        file: The file.

    Raises:
        InputError: One of the files cannot be read.
    """
    if file.suffix != ".py":
        card = file.with_suffix(".json")
        has_card = file.suffix == ".safetensors" and card.is_file()
        return {path.name: sha256(path) for path in ([file, card] if has_card else [file])}
    file = file.resolve()
    folder, waiting = file.parent, [file]
    digests: dict[str, str] = {}
    while waiting:
        path = waiting.pop()
        name = path.relative_to(folder).as_posix()
        if name in digests:
            continue
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}, which a plug-in imports, cannot be read: {error.strerror}") from None
        digests[name] = hashlib.sha256(content).hexdigest()
        if path.suffix == ".py":
            for module in _imported_modules(content):
                waiting += _files_of_module(folder, module)
    return dict(sorted(digests.items()))


def package_digests(package: Path) -> dict[str, str]:
    """Return the sha256 of all files of a package, or of a single module, by path beside it."""
    paths = _files_of_package(package) if package.is_dir() else [package]
    return {path.relative_to(package.parent).as_posix(): sha256(path) for path in sorted(paths)}


def short_digest(digests: Mapping[str, str]) -> str:
    """Return twelve hexadecimal digits that change with each file: of a single file, the first of its sha256."""
    if len(digests) == 1:
        return next(iter(digests.values()))[:12]
    return hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()[:12]


def _imported_modules(content: bytes) -> set[str]:
    """Return the top-level modules that a Python file may import, apart from crowdbench; none if it is broken."""
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError, RecursionError):
        return set()
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {node.module} if node.module else {alias.name for alias in node.names}
    return {name.partition(".")[0] for name in names} - {"crowdbench"}


def _files_of_module(folder: Path, module: str) -> Iterator[Path]:
    """Yield the files of a module, or of a package, in a folder."""
    paths = [folder / f"{module}{suffix}" for suffix in _SUFFIXES]
    yield from (path for path in paths if path.is_file())
    yield from _files_of_package(folder / module)


def _files_of_package(package: Path) -> Iterator[Path]:
    """Yield the Python files and the compiled extensions of a package; none if there is no such folder."""
    yield from (path for path in package.rglob("*") if path.name.endswith(_SUFFIXES) and path.is_file())
