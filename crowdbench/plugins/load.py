"""Python files and installed packages as plug-ins: finding them, running them, calling what they define."""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.metadata
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from crowdbench.plugins.files import file_digests, joint, module_digests
from crowdbench.plugins.options import read_options, takes_any
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, plugin_errors

_PACKAGE = Path(__file__).parent.parent

ROOT = _PACKAGE if (_PACKAGE / "agents").is_dir() else _PACKAGE.parent
"""Where the folders `agents` and `scenarios` lie: inside the package in a wheel, beside it in a checkout."""


Made = TypeVar("Made")


@dataclass(frozen=True)
class Kind:
    """A kind of plug-in.

    Attributes:
        word: What one of them is called.
        function: The function that a file of it defines.
        functions: Those that are built in as functions, by name.
        folder: Where the files of others that are built in are, if there are any.
        entry_points: The group of entry points by which installed packages offer others, if they can.
    """

    word: str
    function: str
    functions: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    folder: Path | None = None
    entry_points: str = ""

    def names(self) -> list[tuple[str, str]]:
        """Name and first docstring line of everything that is built in or installed."""
        built_in = [(name, _first_line(docstring(path))) for name, path in self.built_in().items()]
        installed = [
            (entry.name, _first_line(_installed_docstring(entry)) or f"installed: {entry.value}")
            for entry in self._installed()
        ]
        functions = [(name, _first_line(function.__doc__ or "")) for name, function in self.functions.items()]
        return functions + built_in + installed

    def find(self, spec: str) -> tuple[str, Callable[..., Any]]:
        """A plug-in's name and function.

        Args:
            spec: A name, `file.py` or `file.py:function`.

        Returns:
            The name, and the function that makes what the plug-in offers.

        Raises:
            InputError: There is none, or it cannot be loaded.
        """
        file, function = file_and_function(spec)
        if file is not None:
            return function or file.stem, load_function(file, function or self.function)
        if spec in self.functions:
            return spec, self.functions[spec]
        if spec in (built_in := self.built_in()):
            return spec, load_function(built_in[spec], self.function)
        for entry in self._installed():
            if entry.name == spec:
                with plugin_errors(f"the installed {self.word} {spec} cannot be loaded:"):
                    return spec, entry.load()
        known = ", ".join(name for name, _ in self.names())
        raise InputError(f"no {self.word} is called {spec!r}; there are {known}, or give a file: ./mine.py")

    def docstring(self, spec: str) -> str:
        """The docstring of the file of a plug-in that `find` finds, empty if it has none."""
        path = self._file(spec)
        if path is not None:
            return docstring(path)
        return "".join(_installed_docstring(entry) for entry in self._installed() if entry.name == spec)

    def files(self, spec: str) -> dict[str, str]:
        """The sha256 of every Python file of a plug-in that `find` finds, by its path: see `plugins.files`.

        No file is run. Of a program it is the sha256 of its file.
        """
        path = self._file(spec)
        if path is not None:
            return file_digests(path)
        if program(spec) is not None:
            return {Path(spec).name: files.sha256(Path(spec))}
        (module,) = (entry.module for entry in self._installed() if entry.name == spec)
        parts = tuple(module.split("."))
        found = _find_module(parts)
        if found is None or found.origin is None:
            return {}
        origin = Path(found.origin).resolve()
        depth = len(parts) if found.submodule_search_locations is not None else len(parts) - 1
        return module_digests(origin.parents[depth], parts, package=parts[0])

    def built_in(self) -> dict[str, Path]:
        """The files of those that are built in, by name."""
        return {path.stem: path for path in sorted(self.folder.glob("*.py"))} if self.folder else {}

    def _file(self, spec: str) -> Path | None:
        """The Python file of a plug-in, None where it has none of its own."""
        path = file_and_function(spec)[0] or self.built_in().get(spec)
        return path if path is not None and path.exists() else None

    def _installed(self) -> list[importlib.metadata.EntryPoint]:
        return sorted(importlib.metadata.entry_points(group=self.entry_points)) if self.entry_points else []


def _find_module(module: tuple[str, ...]) -> ModuleSpec | None:
    """Where a module is, by the parts of its name. `importlib.util.find_spec` would run the packages around it."""
    found = None
    for depth in range(1, len(module) + 1):
        around = None if found is None else found.submodule_search_locations
        name = ".".join(module[:depth])
        found = next((spec for finder in sys.meta_path if (spec := finder.find_spec(name, around))), None)
        if found is None:
            return None
    return found


def file_and_function(spec: str) -> tuple[Path | None, str]:
    """The file and the function, perhaps empty, of `file.py:function`; no file where the spec is a name."""
    match = re.fullmatch(r"(.+\.py)(?::(\w+))?", spec)
    return (Path(match[1]), match[2] or "") if match else (None, "")


def program(spec: str) -> Path | None:
    """The program that a planner is, given by a path such as `./mine`; None where `spec` is something else."""
    path = Path(spec)
    is_program = "/" in spec and file_and_function(spec)[0] is None and path.is_file() and os.access(path, os.X_OK)
    return path if is_program else None


def load_function(path: Path, name: str) -> Callable[..., Any]:
    """Get a function that a Python file defines.

    Args:
        path: The file.
        name: The function's name.

    Returns:
        The function.

    Raises:
        InputError: The file or the function does not exist, or the file cannot be run.
    """
    function = getattr(load_module(path), name, None)
    if not callable(function):
        raise InputError(f"{path} defines no function {name}()")
    return function


def load_module(path: Path) -> ModuleType:
    """Run a Python file as a module, which can import files beside it. Raises InputError where it fails."""
    try:
        path = path.resolve(strict=True)
        files.check_regular(path)
    except (OSError, RuntimeError, ValueError) as error:
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
    with plugin_errors(f"{path} cannot be loaded:"):
        spec.loader.exec_module(module)
    return module


def make_plugin(kind: type[Made], name: str, factory: Callable[..., object], options: Mapping[str, Any]) -> Made:
    """What a function makes with options.

    Args:
        kind: What it must make.
        name: What errors call the function.
        factory: The function or class.
        options: Its arguments, as they are written in TOML: see `plugins.options.Option.argument`.

    Returns:
        What the function returns.

    Raises:
        InputError: The function does not take the options, fails, or makes something else.
    """
    known = {option.name: option for option in read_options(factory)}
    for option in options:
        if option not in known and not takes_any(factory):
            raise InputError(f"{name} has no option {option!r}; its options are: {', '.join(known) or 'none'}")
    with plugin_errors(f"{name} cannot be made with {dict(options)}:"):
        arguments = {
            option: known[option].argument(value) if option in known else value for option, value in options.items()
        }
        made = factory(**arguments)
        # In here, because it asks an object of the plug-in's for its class.
        if isinstance(made, kind):
            return made
    raise InputError(f"{name}: the factory made a {type(made).__name__}, but must make a crowdbench.{kind.__name__}")


def source_digest(spec: str) -> str | None:
    """Twelve hexadecimal digits that change with a user's file and what it imports from its folder.

    None for other plug-ins.
    """
    file, _ = file_and_function(spec)
    return None if file is None else joint(file_digests(file))


def docstring(path: Path) -> str:
    """A Python file's docstring, empty if it has none. The file is read, not run, which would run its imports.

    Raises InputError where it cannot be read.
    """
    with plugin_errors(f"{path} cannot be read:"):
        return ast.get_docstring(ast.parse(files.read_regular(path))) or ""


def _installed_docstring(entry: importlib.metadata.EntryPoint) -> str:
    # Finding a module runs the packages around it, and these may be broken.
    with contextlib.suppress(InputError), plugin_errors(f"{entry.module} cannot be found:"):
        spec = importlib.util.find_spec(entry.module)
        if spec and spec.origin and spec.origin.endswith(".py"):
            return docstring(Path(spec.origin))
    return ""


def _first_line(text: str) -> str:
    return text.partition("\n")[0]
