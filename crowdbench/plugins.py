"""Python files and installed packages as plug-ins: finding them, running them, calling what they define."""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.metadata
import importlib.util
import inspect
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from crowdbench.errors import InputError

_PACKAGE = Path(__file__).parent

ROOT = _PACKAGE if (_PACKAGE / "agents").is_dir() else _PACKAGE.parent
"""Where the folders `agents` and `scenarios` lie: inside the package in a wheel, beside it in a checkout."""


@dataclass(frozen=True)
class Kind:
    """A kind of plug-in: its word, the folder of the built-in ones, the function that their files define."""

    word: str
    folder: Path
    function: str
    entry_points: str

    def names(self) -> list[tuple[str, str]]:
        """Name and first docstring line of everything that is built in or installed."""
        built_in = [(path.stem, first_line(path)) for path in sorted(self.folder.glob("*.py"))]
        return built_in + [(entry.name, _first_line_of(entry)) for entry in self._installed()]

    def find(self, spec: str) -> tuple[str, Callable[..., object]]:
        """Name and function of a plug-in, from a name, `file.py` or `file.py:function`.

        Raises InputError where there is none, or where it cannot be loaded.
        """
        file, function = parts(spec)
        if file is not None:
            return function or file.stem, function_of(file, function or self.function)
        if spec in (path.stem for path in self.folder.glob("*.py")):
            return spec, function_of(self.folder / f"{spec}.py", self.function)
        for entry in self._installed():
            if entry.name == spec:
                try:
                    return spec, entry.load()
                except (Exception, SystemExit) as error:
                    raise InputError(
                        f"the installed {self.word} {spec} cannot be loaded: {type(error).__name__}: {error}"
                    ) from error
        known = ", ".join(name for name, _ in self.names())
        raise InputError(f"no {self.word} is called {spec!r}; there are {known}, or give a file: ./mine.py")

    def _installed(self) -> list[importlib.metadata.EntryPoint]:
        return sorted(importlib.metadata.entry_points(group=self.entry_points))


def parts(spec: str) -> tuple[Path | None, str]:
    """The file and the function, perhaps empty, of `file.py:function`; no file where the spec is a name."""
    match = re.fullmatch(r"(.+\.py)(?::(\w+))?", spec)
    return (Path(match[1]), match[2] or "") if match else (None, "")


def function_of(path: Path, name: str) -> Callable[..., Any]:
    """A function that a Python file defines. Raises InputError where it does not exist, or the file fails."""
    function = getattr(load_module(path), name, None)
    if not callable(function):
        raise InputError(f"{path} defines no function {name}()")
    return function


def load_module(path: Path) -> ModuleType:
    """Run a Python file as a module, which can import files beside it. Raises InputError where it fails."""
    try:
        path = path.resolve(strict=True)
    except (OSError, RuntimeError) as error:
        raise InputError(f"there is no file {path}: {getattr(error, 'strerror', None) or error}") from None
    # Known to the interpreter under a name of its own: dataclasses and pickle look it up.
    name = f"crowdbench_plugin_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} is not a Python file: its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise InputError(f"{path} cannot be loaded: {type(error).__name__}: {error}") from error
    return module


def call(name: str, factory: Callable[..., object], options: Mapping[str, Any]) -> object:
    """What a factory makes with options. Raises InputError where it does not take them, or fails."""
    try:
        parameters = inspect.signature(factory).parameters
    except (TypeError, ValueError):
        raise InputError(f"{name} is no function whose options can be read") from None
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    for option in options:
        if option not in parameters and not takes_any:
            known = ", ".join(parameters) or "none"
            raise InputError(f"{name} has no option {option!r}; its options are: {known}")
    try:
        return factory(**options)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(f"{name} cannot be made with {dict(options)}: {type(error).__name__}: {error}") from error


def source(spec: str) -> str | None:
    """Twelve hexadecimal digits that change with a user's file, not with what it imports; None for other plug-ins."""
    file, _ = parts(spec)
    return None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()[:12]


def first_line(path: Path) -> str:
    """The first line of a Python file's docstring: read, not run, since running it imports what it imports."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    return (docstring or "").partition("\n")[0]


def _first_line_of(entry: importlib.metadata.EntryPoint) -> str:
    # Finding a module runs the packages around it, and these may be broken.
    with contextlib.suppress(Exception):
        spec = importlib.util.find_spec(entry.module)
        if spec and spec.origin and spec.origin.endswith(".py"):
            return first_line(Path(spec.origin)) or f"installed: {entry.value}"
    return f"installed: {entry.value}"
