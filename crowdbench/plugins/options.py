"""The options of a plug-in's function: read from its signature, and converted from TOML values to arguments."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import math
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from crowdbench.utils.errors import InputError, is_integer, is_number
from crowdbench.utils.resources import plugin_in_time

REQUIRED = inspect.Parameter.empty
"""The value of `Option.default` for an option without a default."""


PLAIN: Mapping[Any, tuple[Callable[[Any], bool], str]] = {
    bool: (lambda value: isinstance(value, bool), "true or false"),
    int: (is_integer, "a whole number"),
    float: (lambda value: is_number(value) and math.isfinite(value), "a number"),
    str: (lambda value: isinstance(value, str), "a text in quotes"),
}
"""The types of values that are no collections: the check of each type, and its name in errors."""

CHECKED: Mapping[Any, tuple[Callable[[Any], bool], str]] = {
    **PLAIN,
    list: (lambda value: isinstance(value, list | tuple), "a list"),
    tuple: (lambda value: isinstance(value, list | tuple), "a list"),
    dict: (lambda value: isinstance(value, dict), "a table"),
}
"""The types that values are checked against."""


@dataclass(frozen=True)
class Option:
    """A parameter of a plug-in's function.

    Some options are parts of the returned object: dataclasses, which are written as tables of their parameters.

    Attributes:
        name: Its name.
        default: Its value if it is not given, or `REQUIRED`.
        types: The types that its annotation allows; without an annotation, the type of its default if that is in
            `CHECKED`.
        keyword_only: True if it can be given only by name.
    """

    name: str
    default: Any
    types: tuple[Any, ...]
    keyword_only: bool = False

    @property
    def parts(self) -> list[type]:
        """The dataclasses among its types."""
        return [kind for kind in self.types if isinstance(kind, type) and dataclasses.is_dataclass(kind)]

    @property
    def can_be_off(self) -> bool:
        """True if it may be None, which is written as false."""
        return types.NoneType in self.types and bool not in self.types

    def part_options(self, part: type) -> list[Option]:
        """Return the parameters of one of its parts. Their defaults come from its default, if that is such a part."""
        options = read_options(part)
        if not isinstance(self.default, part):
            return options
        return [dataclasses.replace(option, default=getattr(self.default, option.name)) for option in options]

    def argument(self, value: Any) -> Any:
        """Return the argument of the function for a value.

        Args:
            value: The value in TOML, or the argument itself. If the table of a part has only some of its parameters,
                the others come from the option's default if that is such a part, and otherwise from the dataclass.

        Returns:
            The argument: None for false, a part for a table, a float or a tuple where only these are allowed, and else
            the value.

        Raises:
            InputError: The value has another type, is not a table although it must be one, or has unknown or invalid
                parameters.
        """
        if self.can_be_off and (value is None or value is False):
            return None
        if self.parts:
            return value if isinstance(value, tuple(self.parts)) else self._make_part(value)
        kinds = [typing.get_origin(kind) or kind for kind in self.types if kind is not types.NoneType]
        if kinds and all(kind in CHECKED for kind in kinds) and not any(CHECKED[kind][0](value) for kind in kinds):
            text = str(value).lower() if isinstance(value, bool) else repr(value)
            raise self._error(text, [CHECKED[kind][1] for kind in kinds])
        return kinds[0](value) if kinds in ([float], [tuple]) else value

    def _make_part(self, table: Any) -> Any:
        """Return the part whose parameters are in a table; if several parts match, one of the default's type."""
        tables = []
        for part in sorted(self.parts, key=lambda part: type(self.default) is not part):
            options = self.part_options(part)
            defaults = {option.name: option.default for option in options}
            tables.append(f"a table with {', '.join(defaults)}")
            if not isinstance(table, dict) or table.keys() - defaults.keys():
                continue
            arguments = {**defaults, **table}
            if all(argument is not REQUIRED for argument in arguments.values()):
                try:
                    arguments |= {
                        option.name: option.argument(table[option.name]) for option in options if option.name in table
                    }
                    return part(**arguments)
                except InputError as error:
                    raise InputError(f"in {self.name}, {error}") from error
        raise self._error(repr(table), tables)

    def _error(self, value: str, expected: list[str]) -> InputError:
        """Return the error with the given value and the allowed values."""
        return InputError(f"{self.name} is {value}, but must be {'false or ' * self.can_be_off}{' or '.join(expected)}")


def read_options(factory: Callable[..., object]) -> list[Option]:
    """Return the options of a function or class, without `*args` and `**kwargs`.

    Raises InputError if its signature cannot be read.
    """
    hints = _hints(factory)
    return [
        Option(
            name,
            parameter.default,
            _alternatives(hints[name]) if name in hints else _type_of(parameter.default),
            parameter.kind is parameter.KEYWORD_ONLY,
        )
        for name, parameter in _parameters(factory).items()
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
    ]


def takes_any(factory: Callable[..., object]) -> bool:
    """Return whether a function takes options of any name, `**kwargs`."""
    return any(parameter.kind is parameter.VAR_KEYWORD for parameter in _parameters(factory).values())


def _parameters(factory: Callable[..., object]) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(factory).parameters
    except (TypeError, ValueError):
        name = getattr(factory, "__name__", type(factory).__name__)
        raise InputError(f"{name} is no function whose options can be read") from None


def _hints(factory: Callable[..., object]) -> dict[str, Any]:
    while isinstance(factory, functools.partial):
        factory = factory.func
    called = factory.__init__ if inspect.isclass(factory) else factory
    # Annotations are evaluated: they may use names that are imported only for type checkers, or raise any exception.
    with contextlib.suppress(InputError), plugin_in_time("annotations raised"):
        return typing.get_type_hints(called)
    return {}


def _type_of(default: object) -> tuple[Any, ...]:
    """Return the type of a default that has one in `CHECKED`, or of a part; none for other defaults."""
    if dataclasses.is_dataclass(default) and not isinstance(default, type):
        return (type(default),)
    return tuple(kind for kind in CHECKED if isinstance(default, kind))[:1]


def _alternatives(hint: Any) -> tuple[Any, ...]:
    return typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
