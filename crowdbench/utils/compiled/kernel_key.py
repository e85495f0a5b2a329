"""The key of a kernel in the cache: its code, the constants and kernels that it uses, the compiler and its versions."""

from __future__ import annotations

import dis
import functools
import hashlib
import marshal
import pickle
import sys
from enum import EnumType
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import config
from numba.core.dispatcher import Dispatcher

_COMPILER = (
    sys.version,
    numba.__version__,
    llvmlite.__version__,
    np.__version__,
    config.OPT,
    config.LOOP_VECTORIZE,
    config.SLP_VECTORIZE,
    config.BOUNDSCHECK,
)

_KNOWN_BY_VERSION = {"builtins", "math", "numba", "numpy"}
"""Packages whose code is the same as long as `_COMPILER` is."""


def kernel_key(kernel: Dispatcher) -> str:
    """Return a digest of everything that determines the machine code of a kernel, apart from the types of arguments.

    It is computed from code in memory: files may have been edited after their import, and constants may come from
    anywhere. Names of modules and places in files do not count, so that installations share equal kernels.

    Raises:
        TypeError: A kernel uses a global of which no digest can be made.
    """
    kernels = [kernel]
    digest = hashlib.sha256(repr(_COMPILER).encode())
    for called in kernels:  # the list grows meanwhile
        function, code = called.py_func, called.py_func.__code__
        cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
        values = {name: function.__globals__[name] for name in _globals(code) if name in function.__globals__}
        values |= {name: cell.cell_contents for name, cell in cells}
        for name, value in values.items():
            if not isinstance(value, Dispatcher):
                text = _describe(value, f"{name} in kernel {function.__module__}.{function.__qualname__}")
            else:
                if value not in kernels:
                    kernels.append(value)
                text = f"kernel {kernels.index(value)}"
            digest.update(f"{name} = {text}\n".encode())
        options = sorted(called.targetoptions.items())
        digest.update(f"{function.__name__} {function.__defaults__} {options}\n".encode())
        # Version 2 of the format does not depend on how often an object is used elsewhere.
        digest.update(marshal.dumps(code.replace(co_filename="", co_firstlineno=0, co_linetable=b""), 2))
    return digest.hexdigest()[:32]


@functools.cache
def _globals(code: CodeType) -> list[str]:
    """Return the names of the globals that some code reads, also inside of comprehensions."""
    names = {step.argval for step in dis.get_instructions(code) if step.opname == "LOAD_GLOBAL"}
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return sorted(names.union(*map(_globals, inner)))


def _describe(value: Any, place: str) -> str:
    """Return a constant, or the name of an object that is identified by its name, as a text.

    Raises:
        TypeError: It is neither.
    """
    if isinstance(value, EnumType):
        return f"{value.__qualname__} {[(name, int(value[name])) for name in value.__members__]}"
    if isinstance(value, type) and hasattr(value, "_fields"):
        return f"{value.__module__}.{value.__qualname__} {value._fields}"
    if isinstance(value, ModuleType | type | BuiltinFunctionType | FunctionType):
        name = value.__name__ if isinstance(value, ModuleType) else f"{value.__module__}.{value.__qualname__}"
        if name.partition(".")[0] not in _KNOWN_BY_VERSION:
            raise TypeError(f"{place} is neither a constant nor a kernel, so its changes would pass unnoticed")
        return name
    return pickle.dumps(value, 4).hex()
