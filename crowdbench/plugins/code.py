"""Digests of code: of syntax trees, so that comments, docstrings and the layout of a file do not count."""

from __future__ import annotations

import ast
import functools
import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from crowdbench.plugins import files
from crowdbench.plugins.files import imported_modules
from crowdbench.utils.compiled import store

_SILENT = frozenset({"ctx", "kind", "type_comment"})
"""Fields of syntax trees that do not change what the code does."""

DESCRIBES = "crowdbench.metrics.info", "describe"
"""The module, and its decorator, that describe metrics for tables: neither changes a value."""

PACKAGE = Path(__file__).parent.parent
NAME = PACKAGE.name


def code_digest(modules: Iterable[str], further: Iterable[Path] = ()) -> str:
    """Return the sha256 of the code that some modules of crowdbench run.

    It covers every module of crowdbench that they import, directly or not, also in functions. Imports for type
    checking do not count. A module counts by its syntax tree, without docstrings, comments and descriptions of metrics,
    and not by its name.

    Args:
        modules: Names of modules of crowdbench, such as `crowdbench.runs.rollout`.
        further: Further files, which count with what they import from crowdbench.
    """
    trees, imported, before = [], [], len(_kept())
    for file in further:
        tree, names = _read(file)
        trees.append(tree)
        imported += names
    trees += [_read(path)[0] for path in _reach([*modules, *imported]).values()]
    _keep(before)
    return hashlib.sha256(json.dumps(sorted(trees)).encode()).hexdigest()


def reached_modules(modules: Iterable[str]) -> set[str]:
    """Return the names of the modules of crowdbench that some of them import, directly or not, and their own."""
    return set(_reach(modules))


def _reach(modules: Iterable[str]) -> dict[str, Path]:
    """Return the files of the modules that some modules of crowdbench import, by name."""
    found: dict[str, Path] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        name = _public_names().get(name, name)
        path = _find(name)
        if path is not None and name not in found and name != DESCRIBES[0]:
            found[name] = path
            waiting += _read(path)[1]
    return found


@functools.cache
def _find(name: str) -> Path | None:
    """Return the file of a module of crowdbench; None for the package itself, which only names others, and others."""
    first, *parts = name.split(".")
    if first != NAME or not parts:
        return None
    path = PACKAGE.joinpath(*parts)
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@functools.cache
def _public_names() -> dict[str, str]:
    """Return the module of each public name, such as `crowdbench.Planner`."""
    tree = ast.parse((PACKAGE / "__init__.py").read_bytes())
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    return {f"{NAME}.{alias.name}": str(node.module) for node in nodes for alias in node.names}


@functools.cache
def _read(path: Path) -> tuple[str, list[str]]:
    """Return the digest of a file's syntax tree, and the modules of crowdbench that it imports."""
    source = path.read_bytes()
    package = (NAME, *path.relative_to(PACKAGE).parent.parts) if path.is_relative_to(PACKAGE) else ()
    name = hashlib.sha256(".".join(package).encode() + b"\n" + source).hexdigest()
    if name not in _kept():
        tree = ast.parse(source)
        modules = [".".join(module) for module in imported_modules(tree, package)]
        _kept()[name] = _tree_digest(tree), [module for module in modules if module.startswith(f"{NAME}.")]
    digest, imports = _kept()[name]
    return digest, imports


@functools.cache
def _kept() -> dict[str, Any]:
    """Return what `_read` has returned, by the digest of the source. It is kept on disk, beside compiled kernels."""
    content = store.read(_entry())
    return json.loads(content) if content else {}


def _keep(before: int) -> None:
    """Write what `_read` has returned to disk, if it is more than there was."""
    if len(_kept()) > before:
        store.write(_entry(), json.dumps(_kept()).encode())


@functools.cache
def _entry() -> store.Entry:
    """Return the name of the file on disk, which changes with the way in which digests are made."""
    own = hashlib.sha256(Path(__file__).read_bytes() + Path(files.__file__).read_bytes()).hexdigest()
    return store.Entry("syntax_trees", own[:16], "all")


def _tree_digest(tree: ast.AST) -> str:
    """Return the sha256 of a syntax tree, which is the same in all versions of Python."""
    texts: list[str] = []
    _write(tree, texts)
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def _write(node: ast.AST, texts: list[str]) -> None:
    """Append a syntax tree without docstrings. Empty fields are left out: other versions of Python may lack them."""
    texts.append(type(node).__name__)
    for name in node._fields:
        value = None if name in _SILENT else node.__dict__.get(name)
        for part in value if isinstance(value, list) else [] if value is None else [value]:
            if not isinstance(part, ast.AST):
                texts.append(f"{name} {part!r}")
            elif not _is_text(part) and not (name == "decorator_list" and _describes(part)):
                texts.append(name)
                _write(part, texts)
    texts.append("")


def _is_text(node: ast.AST) -> bool:
    """Return whether a statement is nothing but a text, such as a docstring."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _describes(decorator: ast.AST) -> bool:
    """Return whether a decorator only describes a metric for tables."""
    is_call = isinstance(decorator, ast.Call) and isinstance(decorator.func, ast.Name)
    return is_call and decorator.func.id == DESCRIBES[1]  # type: ignore[attr-defined]
