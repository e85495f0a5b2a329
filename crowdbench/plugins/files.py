"""The files that a plug-in consists of: its own, and those that it imports from its folder."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator, Mapping
from importlib.machinery import all_suffixes
from pathlib import Path

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import sha256

Module = tuple[str, ...]
"""A module's name, its parts one by one: a file may be called `my.planner.py`."""


def file_digests(file: Path) -> dict[str, str]:
    """The sha256 of a file and of those that belong to it, by their paths in its folder.

    To a Python file belongs every file that it imports from its folder. Imports count wherever they stand, also in
    functions, and the imports of imported files count too. A module whose name is computed is not found. crowdbench
    itself does not count. To weights belongs their card.

    Args:
        file: The file.

    Raises:
        InputError: One of the files cannot be read.
    """
    if file.suffix == ".py":
        file = file.resolve()
        return module_digests(file.parent, (file.stem,))
    card = file.with_suffix(".json")
    has_card = file.suffix == ".safetensors" and card.is_file()
    return {each.name: sha256(each) for each in ([file, card] if has_card else [file])}


def imports_of(file: Path) -> set[str]:
    """Return the names of the modules of crowdbench that a file, or one that it imports from its folder, imports."""
    file = file.resolve()
    return crowdbench_imports(file.parent, (file.stem,)) if file.suffix == ".py" else set()


def module_digests(folder: Path, module: Module, package: str = "") -> dict[str, str]:
    """Return the sha256 of the files of a module that is imported by its name, as `file_digests` does.

    Args:
        folder: The folder in which its top-level package lies.
        module: Its name.
        package: A top-level package to which the files must belong; all of the folder count where it is empty.
    """
    found = _reach(folder, module, package)
    return {name: hashlib.sha256(content).hexdigest() for name, (content, _) in sorted(found.items())}


def crowdbench_imports(folder: Path, module: Module, package: str = "") -> set[str]:
    """Return the names of the modules of crowdbench that a module imports, or a module that it imports.

    The arguments and errors are those of `module_digests`.
    """
    imports = (module for _, modules in _reach(folder, module, package).values() for module in modules)
    return {".".join(module) for module in imports if module[:1] == ("crowdbench",)}


def _reach(folder: Path, module: Module, package: str) -> dict[str, tuple[bytes, list[Module]]]:
    """Return the contents and the imports of each file that a module runs, by the file's path in the folder."""
    found: dict[str, tuple[bytes, list[Module]]] = {}
    waiting = [module]
    while waiting:
        for path in _files(folder, waiting.pop(), package):
            name = path.relative_to(folder).as_posix()
            if name not in found:
                try:
                    content = path.read_bytes()
                except OSError as error:
                    raise InputError(f"{path}, which a plug-in imports, cannot be read: {error.strerror}") from None
                found[name] = content, _imports(content, path.relative_to(folder).parent.parts, path.suffix)
                waiting += found[name][1]
    return found


def _imports(content: bytes, package: Module, suffix: str) -> list[Module]:
    """Return the modules that a file imports; none where it is not Python."""
    if suffix != ".py":
        return []
    try:
        return imported_modules(ast.parse(content), package)
    except (SyntaxError, ValueError, RecursionError):
        return []


def joint(digests: Mapping[str, str]) -> str:
    """Twelve hexadecimal digits that change with each of the files; those of the file itself where it is the only one.

    Args:
        digests: The sha256 of each file by its path.
    """
    if len(digests) == 1:
        return next(iter(digests.values()))[:12]
    return hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()[:12]


def _files(folder: Path, module: Module, package: str) -> Iterator[Path]:
    """The files in the folder that are run when a module is imported: its own, and those of the packages around it."""
    if not module or module[0] == "crowdbench" or (package and module[0] != package):
        return
    for depth in range(1, len(module) + 1):
        path = folder.joinpath(*module[:depth])
        for suffix in all_suffixes():
            for candidate in (path / f"__init__{suffix}", path.with_name(path.name + suffix)):
                if candidate.is_file():
                    yield candidate


def imported_modules(tree: ast.AST, package: Module) -> list[Module]:
    """Return the modules that a Python file may import; a name in `from a import b` may be one.

    Args:
        tree: The file's syntax tree. Imports under `if TYPE_CHECKING` do not count.
        package: The package that it lies in.
    """
    found: list[Module] = []
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found += [tuple(alias.name.split(".")) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: max(0, len(package) + 1 - node.level)] if node.level else ()
            base = (*above, *(node.module or "").split(".")) if node.module else above
            found += [base, *((*base, alias.name) for alias in node.names)]
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            waiting += node.orelse
        elif not isinstance(node, ast.expr):
            waiting += ast.iter_child_nodes(node)
    return found
