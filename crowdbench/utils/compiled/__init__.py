"""Compiled functions (kernels), kept on disk so that only the first run on a machine compiles them.

The cache of numba does not detect changes of a called function in another file. It mixes up simultaneous writes of two
processes, and fails if no directory can be written. This cache has a file for each kernel and signature. Its name
contains a digest of everything that determines the machine code (`kernel_key.py`), and it begins with its checksum
(`kernel_files.py`). So stale or damaged code is not used, and all installations on a machine share equal kernels.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import hashlib
import os
import pickle
from collections.abc import Callable
from typing import Any

from crowdbench.utils.errors import InputError

try:
    import numba
except ValueError as error:
    threads = os.environ.get("NUMBA_NUM_THREADS")
    raise InputError(f"numba does not start with NUMBA_NUM_THREADS={threads}: {error}") from error

from numba import config, types
from numba.core import event
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

from crowdbench.utils.compiled.kernel_files import read, write
from crowdbench.utils.compiled.kernel_key import kernel_key

__all__ = ["njit", "number_of_threads", "on_first_compilation"]

_listeners: list[Callable[[], None]] = []


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function, as `numba.njit` does, with the cache of this package.

    Args:
        function: A function that uses no globals except constants, kernels, NumPy and `math`.
        **options: Options of `numba.njit`, apart from `cache`.

    Returns:
        The kernel, or a decorator if there is no function.
    """
    if function is None:
        return functools.partial(njit, **options)
    # The wrapper for C would take a twelfth of the time to compile, and nothing calls it.
    kernel: Any = numba.njit(**{"no_cfunc_wrapper": True, **options})(function)
    if not config.DISABLE_JIT:
        kernel._cache = _Cache(kernel)
    return kernel


def number_of_threads() -> int:
    """Return the number of threads that kernels share their work among: `NUMBA_NUM_THREADS`, or one per core."""
    return int(config.NUMBA_NUM_THREADS)


def on_first_compilation(tell: Callable[[], None]) -> None:
    """Call a function the first time that a kernel is not in the cache."""
    _listeners.append(tell)


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


class _Cache(NullCache):  # type: ignore[misc]
    def __init__(self, kernel: Dispatcher) -> None:
        self._kernel = kernel

    def load_overload(self, signature: Any, target: Any) -> CompileResult | None:
        """Return the kernel compiled for a signature, or None if it has to be compiled."""
        target.refresh()
        payload = read(self._file_name(signature, target.codegen()))
        # An equal kernel may have been compiled in a module that cannot be imported here.
        with contextlib.suppress(ImportError, AttributeError):
            # The files of the store were written by this class, and are machine code in any case.
            if payload is not None:
                stored_signature, reduced = pickle.loads(payload)
                if stored_signature == signature:
                    return CompileResult._rebuild(target, *reduced)
        while _listeners:
            _listeners.pop()()
        return None

    def save_overload(self, signature: Any, compiled: CompileResult) -> None:
        """Store a compiled kernel, if that is possible."""
        if all(loop.can_cache for loop in compiled.lifted) and not compiled.library.has_dynamic_globals:
            write(self._file_name(signature, compiled.codegen), dumps((signature, compiled._reduce())))

    def _file_name(self, signature: Any, codegen: Any) -> str:
        parts = kernel_key(self._kernel), repr(signature), *named_tuples(signature), *codegen.magic_tuple()
        return f"{self._kernel.py_func.__name__}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:32]}"


def named_tuples(signature: Any) -> list[str]:
    """Return the named tuples in a signature with their fields: its `repr` shows neither names nor module."""
    texts = []
    for argument in signature:
        if isinstance(argument, types.NamedTuple | types.NamedUniTuple):
            kind = argument.instance_class
            inner = argument.types if isinstance(argument, types.NamedTuple) else [argument.dtype]
            texts += [f"{kind.__module__}.{kind.__qualname__} {kind._fields}", *named_tuples(inner)]
    return texts
