"""A digest of everything that determines the machine code of a kernel: code, constants, called kernels, compiler."""

from __future__ import annotations

import dis
import enum
import functools
import hashlib
import sys
import types
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


def code_digest(kernel: Dispatcher) -> str:
    """Return the digest of a kernel in memory, not of its file, which may have been edited after the import.

    Names of modules do not count, so that equal kernels in different modules have the same digest.

    Args:
        kernel: A function that `numba.njit` made.

    Returns:
        32 hexadecimal digits.

    Raises:
        TypeError: A kernel uses a global of which no digest can be made.
    """
    kernels = [kernel]
    texts = [repr(_COMPILER), *(_text(called, kernels) for called in kernels)]  # the list grows meanwhile
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:32]


def _text(kernel: Dispatcher, kernels: list[Dispatcher]) -> str:
    """Return everything that determines the machine code. A called kernel is its index in the extended `kernels`."""
    function = kernel.py_func
    values = {name: function.__globals__[name] for name in _globals(function.__code__) if name in function.__globals__}
    if function.__closure__:
        cells = zip(function.__code__.co_freevars, function.__closure__, strict=True)
        values |= {name: cell.cell_contents for name, cell in cells}
    called = {name: value for name, value in values.items() if isinstance(value, Dispatcher)}
    kernels += [value for value in dict.fromkeys(called.values()) if not any(value is known for known in kernels)]
    try:
        constants = [f"{name}={_describe(value)}" for name, value in values.items() if name not in called]
        defaults = _describe(function.__defaults__)
    except TypeError as error:
        raise TypeError(f"kernel {_name(function)}: {error}") from None
    indices = [(name, next(i for i, known in enumerate(kernels) if known is value)) for name, value in called.items()]
    options = sorted(kernel.targetoptions.items())
    return f"{function.__name__} {options} {_code(function.__code__)} {constants} {indices} {defaults}"


@functools.cache
def _globals(code: types.CodeType) -> tuple[str, ...]:
    """Return the globals that some code reads, also inside of comprehensions."""
    names = {step.argval for step in dis.get_instructions(code) if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            names.update(_globals(inner))
    return tuple(sorted(names))


def _code(code: types.CodeType) -> str:
    """Return some code without its place in the file."""
    constants = [_code(c) if isinstance(c, types.CodeType) else _describe(c) for c in code.co_consts]
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount, code.co_flags
    return f"{code.co_code.hex()} {names} {constants}"


def _describe(value: Any) -> str:
    """Return a constant as a text, or the name of an object that is identified by its name.

    Raises:
        TypeError: It is neither.
    """
    if value is None or isinstance(value, str | bytes | int | float | complex | np.generic):
        return f"{_name(type(value))} {value!r}"
    if isinstance(value, tuple):
        return f"{_name(type(value))} {[_describe(item) for item in value]}"
    if isinstance(value, frozenset):
        return f"frozenset {sorted(_describe(item) for item in value)}"
    if isinstance(value, np.ndarray):
        return f"array {value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, enum.EnumType):
        return f"{_name(value)} {[(name, _describe(value[name].value)) for name in value.__members__]}"
    if isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
        return f"{_name(value)} {value._fields}"
    if isinstance(value, types.ModuleType | type | types.BuiltinFunctionType | types.FunctionType):
        name = value.__name__ if isinstance(value, types.ModuleType) else _name(value)
        if name.partition(".")[0] in _KNOWN_BY_VERSION:
            return name
    raise TypeError(f"{value!r} is neither a constant nor a kernel, so its changes would pass unnoticed")


def _name(thing: Any) -> str:
    return f"{thing.__module__}.{thing.__qualname__}"
