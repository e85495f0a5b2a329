"""The options of a plug-in's function: read from its signature, and given to it as they are written in TOML."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from crowdbench.utils.errors import InputError, is_integer, is_number, plugin_errors

REQUIRED = inspect.Parameter.empty
"""The default of an option that has none."""


PLAIN: Mapping[Any, tuple[Callable[[Any], bool], str]] = {
    bool: (lambda value: isinstance(value, bool), "true or false"),
    int: (is_integer, "a whole number"),
    float: (is_number, "a number"),
    str: (lambda value: isinstance(value, str), "a text in quotes"),
}
"""The types of annotations that values are checked against: what belongs to each, and its name in errors."""


@dataclass(frozen=True)
class Option:
    """A parameter of a plug-in's function.

    Some options are parts of what the function makes: dataclasses, which are written as tables of their parameters.

    Attributes:
        name: Its name.
        default: Its value where it is not given, or `REQUIRED`.
        types: The types that its annotation allows; none where there is no annotation.
        keyword_only: Whether it can be given by its name alone.
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
        """Whether it may be None, which is written as false."""
        return types.NoneType in self.types and bool not in self.types

    def argument(self, value: Any) -> Any:
        """What the function is given for a value.

        Args:
            value: As it is written in TOML, or the argument itself. A table of some of a part's parameters leaves
                the others as in the default, if that is such a part, and otherwise as the dataclass has them.

        Returns:
            The argument: None for false, a part for a table, and else the value.

        Raises:
            InputError: The value is of another type, or should be a table and is not, or has other parameters, or one
                of them is impossible.
        """
        if self.can_be_off and (value is None or value is False):
            return None
        if not self.parts:
            self._check(value)
            return value
        if isinstance(value, tuple(self.parts)):
            return value
        if isinstance(value, dict):
            for part, defaults in self._tables():
                arguments = {**defaults, **value}
                if arguments.keys() == defaults.keys() and all(each is not REQUIRED for each in arguments.values()):
                    try:
                        return part(**arguments)
                    except InputError as error:
                        raise InputError(f"in {self.name}, {error}") from error
        right = " or ".join(f"a table with {', '.join(parameters(part))}" for part in self.parts)
        raise InputError(f"{self.name} is {value!r}, but must be {'false or ' * self.can_be_off}{right}")

    def _check(self, value: Any) -> None:
        """Raises InputError where all of the types are plain, and a value is none of them."""
        plain = [kind for kind in self.types if kind is not types.NoneType]
        if not plain or any(kind not in PLAIN for kind in plain) or any(PLAIN[kind][0](value) for kind in plain):
            return
        found = str(value).lower() if isinstance(value, bool) else repr(value)
        right = " or ".join(PLAIN[kind][1] for kind in plain)
        raise InputError(f"{self.name} is {found}, but must be {'false or ' * self.can_be_off}{right}")

    def _tables(self) -> list[tuple[type, dict[str, Any]]]:
        """The parts that a table may be, each with the defaults of its parameters: first the part of the default."""
        tables = [(part, parameters(part)) for part in self.parts]
        own = type(self.default)
        if own in self.parts:
            tables.insert(0, (own, {name: getattr(self.default, name) for name in parameters(own)}))
        return tables


def parameters(part: type) -> dict[str, Any]:
    """The parameters of a dataclass, with their defaults."""
    return {name: parameter.default for name, parameter in inspect.signature(part).parameters.items()}


def read_options(factory: Callable[..., object]) -> list[Option]:
    """The options of a function or class, without `*args` and `**kwargs`.

    Raises InputError where it has no signature that can be read.
    """
    signature = _signature(factory)
    hints = _hints(factory)
    return [
        Option(name, parameter.default, _alternatives(hints.get(name)), parameter.kind is parameter.KEYWORD_ONLY)
        for name, parameter in signature.parameters.items()
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
    ]


def takes_any(factory: Callable[..., object]) -> bool:
    """Whether a function takes options of any name, `**kwargs`."""
    return any(each.kind is each.VAR_KEYWORD for each in _signature(factory).parameters.values())


def _signature(factory: Callable[..., object]) -> inspect.Signature:
    try:
        return inspect.signature(factory)
    except (TypeError, ValueError):
        name = getattr(factory, "__name__", type(factory).__name__)
        raise InputError(f"{name} is no function whose options can be read") from None


def _hints(factory: Callable[..., object]) -> dict[str, Any]:
    while isinstance(factory, functools.partial):
        factory = factory.func
    called = factory.__init__ if inspect.isclass(factory) else factory
    # Annotations may name what is imported for type checkers alone, and are evaluated, whatever they are.
    with contextlib.suppress(InputError), plugin_errors("annotations raised"):
        return typing.get_type_hints(called)
    return {}


def _alternatives(hint: Any) -> tuple[Any, ...]:
    if hint is None:
        return ()
    return typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
