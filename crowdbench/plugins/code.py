"""Digests of code, computed from syntax trees, so that comments, docstrings and formatting do not count."""

from __future__ import annotations

import ast
import functools
import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import crowdbench
from crowdbench.plugins import plugin_files as files
from crowdbench.plugins.plugin_files import imported_modules
from crowdbench.utils.compiled import kernel_files as store

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
        further: Further files, which count with their imports from crowdbench.
    """
    size = len(_cached())
    trees = sorted(_read(path)[0] for path in reached_files(modules, further))
    if len(_cached()) > size:
        store.write(_file_name(), json.dumps(_cached()).encode())
    return hashlib.sha256(json.dumps(trees).encode()).hexdigest()


def reached_files(modules: Iterable[str], further: Iterable[Path] = ()) -> set[Path]:
    """Return the files of some modules of crowdbench, further files, and those that they import, directly or not."""
    reached: set[Path] = set()
    waiting = [*further, *map(_find, modules)]
    while waiting:
        path = waiting.pop()
        if path is not None and path not in reached:
            reached.add(path)
            waiting += map(_find, _read(path)[1])
    return reached


@functools.cache
def _public_names() -> dict[str, str]:
    """Return the module of each public name of the package."""
    stub = ast.parse(Path(crowdbench.__file__).with_suffix(".pyi").read_bytes())
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


@functools.cache
def _find(name: str) -> Path | None:
    """Return the file of a module, or of a public name; None for the package itself, which only imports names."""
    package, *parts = name.split(".")
    if package == NAME and len(parts) == 1:
        parts = _public_names().get(parts[0], name).split(".")
    if package != NAME or not parts or name == DESCRIBES[0]:
        return None
    path = PACKAGE.joinpath(*parts)
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@functools.cache
def _read(path: Path) -> tuple[str, list[str]]:
    """Return the digest of a file's syntax tree, and the modules of crowdbench that it imports."""
    source = path.read_bytes()
    package = (NAME, *path.relative_to(PACKAGE).parent.parts) if path.is_relative_to(PACKAGE) else ()
    name = hashlib.sha256(".".join(package).encode() + b"\n" + source).hexdigest()
    if name not in _cached():
        tree = ast.parse(source)
        modules = [".".join(module) for module in imported_modules(tree, package)]
        _cached()[name] = _tree_digest(tree), [module for module in modules if module.startswith(f"{NAME}.")]
    digest, imports = _cached()[name]
    return digest, imports


@functools.cache
def _cached() -> dict[str, Any]:
    """Return the results of `_read`, by the digest of the source. They are cached on disk, beside compiled kernels."""
    content = store.read(_file_name())
    return json.loads(content) if content else {}


@functools.cache
def _file_name() -> str:
    """Return the name of the file on disk, which changes with the code that computes digests."""
    digest = hashlib.sha256(Path(__file__).read_bytes() + Path(files.__file__).read_bytes()).hexdigest()
    return f"syntax_trees-{digest[:32]}"


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
