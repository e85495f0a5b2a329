"""The files of a plug-in: its main file, and the files that it imports from its folder."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator
from importlib.machinery import all_suffixes
from pathlib import Path
from typing import NamedTuple

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import sha256

Module = tuple[str, ...]
"""The parts of a module's name: a file may be called `my.planner.py`."""


class PluginFiles(NamedTuple):
    """The files of a plug-in.

    Attributes:
        digests: The sha256 of each file, by its path in the folder.
        imports: The names of the modules of crowdbench that the files import.
    """

    digests: dict[str, str]
    imports: set[str]

    @property
    def digest(self) -> str:
        """Twelve hexadecimal digits that change with each file; for a single file, the first digits of its digest."""
        if len(self.digests) == 1:
            return next(iter(self.digests.values()))[:12]
        return hashlib.sha256(json.dumps(self.digests, sort_keys=True).encode()).hexdigest()[:12]


def read_files(file: Path) -> PluginFiles:
    """Read a file and those that belong to it. No file is run.

    For a Python file, these are the files that it imports from its folder, directly or indirectly, also in functions. A
    module whose name is computed at run time is not found. Files of crowdbench do not count. For weights, it is their
    card.

    Args:
        file: The file.

    Raises:
        InputError: One of the files cannot be read.
    """
    if file.suffix == ".py":
        file = file.resolve()
        return read_module(file.parent, (file.stem,))
    card = file.with_suffix(".json")
    has_card = file.suffix == ".safetensors" and card.is_file()
    return PluginFiles({path.name: sha256(path) for path in ([file, card] if has_card else [file])}, set())


def read_module(folder: Path, module: Module, package: str = "") -> PluginFiles:
    """Read the files of a module that is imported by its name, as `read_files` does.

    Args:
        folder: The folder in which its top-level package lies.
        module: Its name.
        package: A top-level package to which the files must belong; if it is empty, all files of the folder count.
    """
    digests: dict[str, str] = {}
    imports: set[str] = set()
    waiting = [module]
    while waiting:
        for path in _find_files(folder, waiting.pop(), package):
            relative = path.relative_to(folder)
            if relative.as_posix() in digests:
                continue
            try:
                content = path.read_bytes()
            except OSError as error:
                raise InputError(f"{path}, which a plug-in imports, cannot be read: {error.strerror}") from None
            digests[relative.as_posix()] = hashlib.sha256(content).hexdigest()
            modules = _imports(content, relative)
            waiting += modules
            imports |= {".".join(module) for module in modules if module[:1] == ("crowdbench",)}
    return PluginFiles(dict(sorted(digests.items())), imports)


def _find_files(folder: Path, module: Module, package: str) -> Iterator[Path]:
    """Yield the files in the folder that the import of a module executes: its file, and files of parent packages."""
    if not module or module[0] == "crowdbench" or (package and module[0] != package):
        return
    for depth in range(1, len(module) + 1):
        path = folder.joinpath(*module[:depth])
        for suffix in all_suffixes():
            for candidate in (path / f"__init__{suffix}", path.with_name(path.name + suffix)):
                if candidate.is_file():
                    yield candidate


def _imports(content: bytes, path: Path) -> list[Module]:
    """Return the modules that a file imports; none if it is not Python."""
    if path.suffix != ".py":
        return []
    try:
        return imported_modules(ast.parse(content), path.parent.parts)
    except (SyntaxError, ValueError, RecursionError):
        return []


def imported_modules(tree: ast.AST, package: Module) -> list[Module]:
    """Return the modules that a Python file may import; in `from a import b`, b may be a module.

    Args:
        tree: The file's syntax tree. Imports under `if TYPE_CHECKING` do not count.
        package: The package that contains the file.
    """
    modules: list[Module] = []
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            modules += [tuple(alias.name.split(".")) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: max(0, len(package) + 1 - node.level)] if node.level else ()
            base = (*above, *(node.module or "").split(".")) if node.module else above
            modules += [base, *((*base, alias.name) for alias in node.names)]
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            waiting += node.orelse
        elif not isinstance(node, ast.expr):
            waiting += ast.iter_child_nodes(node)
    return modules
