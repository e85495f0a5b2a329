"""Compiled functions (kernels), cached on disk so that only the first run on a machine compiles them.

The cache is that of numba. By itself it detects an edit of the file that defines a kernel, but not of a file whose
kernels or constants it uses. Here cached code is valid for one version of all files of the package that define kernels
and, for a plug-in, of the files in its folder. Each version has a folder in `crowdbench/kernels` in the cache of the
user (`XDG_CACHE_HOME`, or else `~/.cache`), or in `NUMBA_CACHE_DIR` if that is set. All installations of a user share
it.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import hashlib
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import hold_lock

try:
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Environment variable", RuntimeWarning)
        import numba
except ValueError as error:
    threads = os.environ.get("NUMBA_NUM_THREADS")
    raise InputError(f"numba does not start with NUMBA_NUM_THREADS={threads}: {error}") from error
except RuntimeWarning as error:  # a variable that numba would ignore, after a traceback
    raise InputError(f"numba does not start: {str(error).partition(chr(10))[0]}") from error

import llvmlite
import numpy as np
from numba.core import config, event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.dispatcher import Dispatcher
from numba.misc.appdirs import AppDirs

__all__ = ["njit", "number_of_threads", "on_first_compilation"]

PACKAGE = Path(__file__).parents[1]

CONSTANTS = ("core/types/rules.py",)
"""Files of the package without kernels, whose constants kernels use."""

LONGEST_UNUSED = 90 * 86400.0
"""Seconds after which the code of an unused version is removed."""

COMPILER = (
    sys.version,
    numba.__version__,
    llvmlite.__version__,
    np.__version__,
    config.OPT,
    config.LOOP_VECTORIZE,
    config.SLP_VECTORIZE,
    config.BOUNDSCHECK,
)

_listeners: list[Callable[[], None]] = []


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function, as `numba.njit` does, with the cache of this package.

    Args:
        function: A function that uses no globals except NumPy, `math`, and constants and kernels of crowdbench or of
            files beside it.
        **options: Options of `numba.njit`, apart from `cache`.

    Returns:
        The kernel, or a decorator if there is no function.
    """
    if function is None:
        return functools.partial(njit, **options)
    # The wrapper for C would take a twelfth of the time to compile, and nothing calls it.
    kernel: Any = numba.njit(**{"no_cfunc_wrapper": True, **options})(function)
    is_in_file = Path(function.__code__.co_filename).is_file()
    if is_in_file and not config.DISABLE_JIT:
        kernel._cache = _Cache(function)
    return kernel


def number_of_threads() -> int:
    """Return the number of threads that kernels share their work among: `NUMBA_NUM_THREADS`, or one per core."""
    return int(config.NUMBA_NUM_THREADS)


def on_first_compilation(tell: Callable[[], None]) -> None:
    """Call a function, once, when a kernel is not in the cache."""
    if tell not in _listeners:
        _listeners.append(tell)


def cache_folder() -> Path:
    """Return the folder of all versions. It need not exist."""
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR).absolute() / "crowdbench" / "kernels"
    return Path(AppDirs("crowdbench", appauthor=False).user_cache_dir) / "kernels"


@functools.cache
def kernel_files() -> tuple[Path, ...]:
    """Return the files of the package that define kernels, and those whose constants kernels use."""
    files = [path for path in sorted(PACKAGE.rglob("*.py")) if b"import njit" in path.read_bytes()]
    return (*files, *(PACKAGE / name for name in CONSTANTS))


def read_version(folder: Path) -> str:
    """Return the digest of all that determines the code of the kernels in a folder, apart from the processor."""
    files = kernel_files()
    if not folder.is_relative_to(PACKAGE):
        files += tuple(sorted(folder.glob("*.py")))
    return _digest([repr(COMPILER), *(path.read_text(encoding="utf-8") for path in files)])


version_of = functools.cache(read_version)
"""Return the version at the time of the first call, when the files are imported."""


def _digest(texts: Iterable[str]) -> str:
    """Return 32 hexadecimal digits of texts."""
    total = hashlib.sha256()
    for text in texts:
        total.update(hashlib.sha256(text.encode()).digest())
    return total.hexdigest()[:32]


@functools.cache
def _folder_of(version: str) -> Path:
    """Return the folder of a version, marked as used. Before it is made, remove versions not used for long."""
    folder = cache_folder() / version
    with contextlib.suppress(OSError):
        if folder.exists():
            os.utime(folder)
            return folder
        for other in cache_folder().iterdir():
            if time.time() - other.stat().st_mtime > LONGEST_UNUSED:
                shutil.rmtree(other, ignore_errors=True)
    return folder


class _Locator(_CacheLocator):  # type: ignore[misc]
    """The place of a kernel in the cache."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self.folder = Path(file).resolve().parent
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        """Return the place of a kernel."""
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        """Return the folder of the kernel: files of the same name in different folders do not share it."""
        folder = self.folder
        name = ".".join(folder.relative_to(PACKAGE).parts) if folder.is_relative_to(PACKAGE) else folder.name
        return str(_folder_of(version_of(folder)) / (name or "package"))

    def get_source_stamp(self) -> str:
        """Return the version of the files that determine the machine code."""
        return version_of(self.folder)

    def get_disambiguator(self) -> str:
        """Return a text that distinguishes functions of the same name in a file."""
        return str(self._line)


class _Files(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _Cache(FunctionCache):  # type: ignore[misc]
    """The cached code of a kernel, by its signature and the processor."""

    _impl_class = _Files

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel compiled for a signature, or None if it has to be compiled."""
        try:
            found = super().load_overload(sig, target_context)
        except Exception:  # a damaged file, which unpickling reports in many ways
            found = None
            with contextlib.suppress(OSError):
                os.unlink(self._cache_file._index_path)
        if found is None:
            while _listeners:
                _listeners.pop()()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled kernel, unless a file was edited after its import.

        A folder that cannot be written, such as on a full disk, must not stop a run.
        """
        folder, locator = Path(self.cache_path), self._impl.locator
        with contextlib.suppress(OSError):
            if read_version(locator.folder) != locator.get_source_stamp():
                return
            folder.mkdir(parents=True, exist_ok=True)
            # Processes that save two signatures of a kernel at the same time would choose the same file.
            with hold_lock(folder / "lock"):
                super().save_overload(sig, data)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """Return the key of a signature: with the processor and, for a function in a function, its variables."""
        cells = self._py_func.__closure__ or ()
        return sig, codegen.magic_tuple(), tuple(_describe(cell.cell_contents) for cell in cells)


def _describe(value: Any) -> str:
    """Return the value of a variable of a closure as a text: a number, or a kernel with the version of its files."""
    if not isinstance(value, Dispatcher):
        return repr(value)
    function = value.py_func
    folder = Path(function.__code__.co_filename).resolve().parent
    return f"{function.__qualname__} {function.__code__.co_firstlineno} {version_of(folder)}"


class _WithoutCollections(event.Listener):  # type: ignore[misc]
    """Context without garbage collection while a kernel is compiled: collection takes a sixth of the time."""

    depth = 0
    """Number of kernels that are being compiled, each called by the one before."""
    is_on = True
    """True if garbage collection was enabled before."""

    def on_start(self, event: event.Event) -> None:
        """Disable garbage collection before a kernel is compiled."""
        if self.depth == 0:
            self.is_on = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """Restore garbage collection after a kernel is compiled, or after an error in it."""
        self.depth -= 1
        if self.depth == 0 and self.is_on:
            gc.enable()


event.register("numba:compile", _WithoutCollections())
if config.DISABLE_JIT:  # NumPy warns where compiled code overflows silently, as random streams do
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="crowdbench")
