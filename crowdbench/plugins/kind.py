"""Load Python files and installed packages as plug-ins: find them, execute them, and call their functions."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.machinery import (
    EXTENSION_SUFFIXES,
    SOURCE_SUFFIXES,
    ExtensionFileLoader,
    FileFinder,
    SourceFileLoader,
)
from importlib.metadata import EntryPoint
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from crowdbench.plugins.options import read_options, takes_any
from crowdbench.plugins.plugin_files import package_digests, read_files, short_digest
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, did_you_mean, find_named, plugin_errors
from crowdbench.utils.fork_guard import ForkGuard
from crowdbench.utils.resources import plugin_in_time

PACKAGE = Path(__file__).parent.parent

ROOT = PACKAGE if (PACKAGE / "agents").is_dir() else PACKAGE.parent
"""The parent of the folders `agents` and `scenarios`: the package in a wheel, its parent folder in a checkout."""

FORMATS = ".onnx", ".zip", ".pt", ".pth"
"""Suffixes of non-Python files for which a kind may have a reader. Some readers only raise an error with the reason."""

Source = Callable[..., Any] | Path | EntryPoint
"""Source of a plug-in: a function, a file, or an installed package."""


@dataclass(frozen=True)
class Kind:
    """A kind of plug-in, with methods that find a plug-in by name or file and construct it.

    Attributes:
        word: The noun for a plug-in of this kind.
        function: Name of the function that a file of this kind defines.
        functions: Plug-ins that are built in as functions, by name.
        folder: Folder with the files, or subfolders, of other built-in plug-ins, if there are any.
        entry_points: The group of entry points with plug-ins of installed packages, if there is one.
        makes: Type of the objects that its function returns; None if the function itself is the plug-in.
        validate: Raises InputError if a plug-in, given with its name, violates a rule of its kind.
        reader: The function that constructs a plug-in from a file that is not Python, if there is one.
    """

    word: str
    function: str
    functions: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    folder: Path | None = None
    entry_points: str = ""
    makes: type | None = None
    validate: Callable[[str, Any], None] | None = None
    reader: EntryPoint | None = None

    def built_in(self) -> dict[str, Source]:
        """Return the source of each built-in plug-in, by name: `name.py`, or `name/name.py` with files beside it."""
        sources: dict[str, Source] = dict(self.functions)
        if self.folder:
            in_folders = [path for path in self.folder.glob("*/*.py") if path.stem == path.parent.name]
            paths = sorted([*self.folder.glob("*.py"), *in_folders], key=lambda path: path.stem)
            sources |= {path.stem: path for path in paths if path.stem != "__init__"}
        return sources

    def sources(self) -> dict[str, Source]:
        """Return the source of each plug-in that is built in or installed, by name. Takes 10 ms, unlike `built_in`."""
        sources = self.built_in()
        installed = sorted(importlib.metadata.entry_points(group=self.entry_points)) if self.entry_points else []
        for entry in installed:
            sources.setdefault(entry.name, entry)
        return sources

    def names(self) -> list[tuple[str, str]]:
        """Return name and first docstring line of all plug-ins that are built in or installed."""
        return [(name, _docstring(source).partition("\n")[0]) for name, source in self.sources().items()]

    def find(self, spec: str) -> tuple[str, Callable[..., Any]]:
        """Return a plug-in's name and function.

        Args:
            spec: A name, `file.py` or `file.py:function`, or a file that the `reader` reads.

        Raises:
            InputError: There is no such plug-in, or it cannot be loaded.
        """
        file, function = file_and_function(spec)
        if program(spec):
            raise InputError(f"{spec} is a program and no file of Python: a planner that is a program needs --isolated")
        source = file or self.built_in().get(spec) or find_named(self.word, spec, self.sources(), ".py")
        if isinstance(source, Path) and (reader := self._reader_of(source)):
            return plugin_name(spec), functools.partial(reader.load(), source)
        if isinstance(source, Path):
            loaded = getattr(load_module(source), function or self.function, None)
            if not callable(loaded):
                raise InputError(f"{source} defines no function {function or self.function}()")
            return plugin_name(spec), loaded
        if isinstance(source, EntryPoint):
            with plugin_in_time(f"the installed {self.word} {spec} cannot be loaded:"), ForkGuard(spec):
                return spec, source.load()
        return spec, source

    def load(self, spec: str, options: Mapping[str, Any] | None = None) -> tuple[str, Any]:
        """Return a plug-in's name, and the plug-in: its function, or the object that the function returns for options.

        Raises InputError as `find` and `make` do.
        """
        name, function = self.find(spec)
        return name, function if self.makes is None else self.make(name, function, options or {})

    def load_with_digest(self, spec: str, folder: Path = Path()) -> tuple[str, Any, str | None]:
        """Load as `load`, with the digest of a user's file, whose path is relative to a folder; None for others."""
        file, _ = file_and_function(spec)
        if file is None:
            return *self.load(spec), None
        return *self.load(str(folder / spec)), short_digest(read_files(folder / file))

    def make(self, name: str, factory: Callable[..., object], options: Mapping[str, Any]) -> Any:
        """Return the object that a function returns for options.

        Args:
            name: Name of the function in errors.
            factory: The function or class.
            options: Its arguments, as they are written in TOML: see `plugins.options.Option.argument`.

        Raises:
            InputError: The function does not accept the options, raises, or returns an object of another type.
        """
        assert self.makes is not None
        known = {option.name: option for option in read_options(factory)}
        for option in options:
            if option not in known and not takes_any(factory):
                meant = did_you_mean(option, known)
                raise InputError(
                    f"{name} has no option {option!r}{meant}; its options are: {', '.join(known) or 'none'}"
                )
        with plugin_in_time(f"{name} cannot be made with {dict(options)}:"), ForkGuard(f"{self.word} {name}"):
            arguments = {
                option: known[option].argument(value) if option in known else value for option, value in options.items()
            }
            plugin = factory(**arguments)
            # Inside the context, because `isinstance` may call code of the plug-in.
            is_right = isinstance(plugin, self.makes)
        if not is_right:
            made = type(plugin).__name__
            raise InputError(f"{name}: the factory made a {made}, but must make a crowdbench.{self.makes.__name__}")
        if self.validate is not None:
            self.validate(name, plugin)
        return plugin

    def docstring(self, spec: str) -> str:
        """Return the docstring of the file of a plug-in that `find` finds, or of its function, empty without one."""
        reader = self._reader_of(source := self._source(spec))
        return importlib.import_module(reader.module).__doc__ or "" if reader else _docstring(source)

    def files(self, spec: str) -> dict[str, str]:
        """Return the sha256 of the files of a plug-in that `find` finds, or of a program. No file is executed.

        Built-in functions have no files. An installed plug-in has all files of its package.
        """
        source = self._source(spec)
        if isinstance(source, Path):
            return read_files(source)
        name = source.module.partition(".")[0] if isinstance(source, EntryPoint) else ""
        package = importlib.util.find_spec(name) if name else None
        if package is None or package.origin is None:
            return {}
        origin = Path(package.origin).resolve()
        return package_digests(origin.parent if package.submodule_search_locations else origin)

    def _reader_of(self, source: Source) -> EntryPoint | None:
        """Return the reader of a file that is not Python; None for other sources."""
        return self.reader if isinstance(source, Path) and source.suffix in FORMATS else None

    def _source(self, spec: str) -> Source:
        """Return the source of a plug-in; for a program, its path."""
        return file_and_function(spec)[0] or self.built_in().get(spec) or self.sources().get(spec, Path(spec))


def file_and_function(spec: str) -> tuple[Path | None, str]:
    """Return the file and the function, perhaps empty, of `file.py:function`; no file if the spec is a name."""
    if Path(spec).suffix in FORMATS:
        return Path(spec), ""
    match = re.fullmatch(r"(.+\.py)(?::(\w+))?", spec)
    return (Path(match[1]), match[2] or "") if match else (None, "")


def program(spec: str) -> Path | None:
    """Return the path of a planner that is a program, such as `./mine`; None if `spec` is not a program."""
    path = Path(spec)
    is_program = "/" in spec and file_and_function(spec)[0] is None and path.is_file() and os.access(path, os.X_OK)
    return path if is_program else None


def plugin_name(spec: str) -> str:
    """Return the name of a plug-in, without loading it: the name of its function, or else of its file or program."""
    file, function = file_and_function(spec)
    if file is not None:
        return function or file.stem
    return spec if program(spec) is None else Path(spec).name


class _SourceLoader(SourceFileLoader):
    """Loader that compiles a file whenever it is loaded: the `__pycache__` beside it may belong to another file."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


@functools.cache
def _import_from_source(folder: Path) -> None:
    """Register `_SourceLoader` for imports from a folder, except for installed packages."""
    make = FileFinder.path_hook((ExtensionFileLoader, EXTENSION_SUFFIXES), (_SourceLoader, SOURCE_SUFFIXES))

    def find(entry: str) -> Any:
        if Path(entry).is_relative_to(folder) and "-packages" not in entry.removeprefix(str(folder)):
            return make(entry)
        raise ImportError

    sys.path_hooks.insert(0, find)
    sys.path_importer_cache.pop(str(folder), None)  # it may be cached already


def _package_of(folder: Path) -> str:
    """Return the name of a package whose modules are the files of a folder, so that they can import relatively."""
    name = f"crowdbench_plugins_{hashlib.sha256(os.fsencode(folder)).hexdigest()[:8]}"
    if name not in sys.modules:
        package = ModuleType(name)
        package.__path__ = [str(folder)]
        sys.modules[name] = package
    return name


def load_module(path: Path) -> ModuleType:
    """Execute a Python file as a module. Raises InputError if it fails.

    The module can import files beside it, by their name (`import helper`) or relatively (`from .helper import f`).
    """
    try:
        path = path.resolve(strict=True)
        files.check_regular(path)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"there is no file {path}: {getattr(error, 'strerror', None) or error}") from None
    if path.suffix != ".py":
        raise InputError(f"{path} is not a Python file")
    # Registered under a unique name, because dataclasses and pickle look it up.
    name = f"{_package_of(path.parent)}.{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_SourceLoader(name, str(path)))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    _import_from_source(path.parent)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    with plugin_in_time(f"{path} cannot be loaded:"), ForkGuard(path.name):
        spec.loader.exec_module(module)
    return module


def _docstring(source: Source) -> str:
    """Return the docstring of a plug-in's function or file, or the entry point of an installed package.

    No file is executed. Raises InputError if the file cannot be read.
    """
    if isinstance(source, EntryPoint):
        return f"installed: {source.value}"
    if isinstance(source, Path):
        with plugin_errors(f"{source} cannot be read:"):
            return ast.get_docstring(ast.parse(files.read_regular(source))) or ""
    return source.__doc__ or ""
