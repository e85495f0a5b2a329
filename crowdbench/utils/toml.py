"""Reads TOML files, and reports an error in a file in one sentence.

The model of a table is a pydantic model, a `TomlTable`. The `description` of each of its fields states the valid
values: it ends the sentence "FILE: KEY is FOUND, but must be ...".
"""

from __future__ import annotations

import contextlib
import inspect
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, ValidationError
from pydantic.fields import FieldInfo

from crowdbench.utils import files
from crowdbench.utils.errors import InputError, did_you_mean

DEEPEST = 32
"""Tables and lists are nested no deeper than this."""

TOO_DEEP = f"tables and lists can be nested {DEEPEST} deep at most"
TOO_LARGE = "an integer must fit into 64 bits, from -2^63 to 2^63 - 1"


def read_toml(path: Path, kind: str) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        kind: The word for what the file describes, such as "scenario".

    Raises:
        InputError: The file cannot be read, or is not TOML.
    """
    try:
        return toml(files.read_text(path))
    except OSError as error:
        raise InputError(f"{kind} {path} cannot be read: {error.strerror}") from None
    except InputError as error:
        raise InputError(f"{kind} {path} cannot be used: {error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{kind} {path} is not valid TOML: {error}") from None


def toml(text: str) -> dict[str, Any]:
    """Return the table that a text in TOML describes.

    Raises:
        tomllib.TOMLDecodeError: It is not TOML.
        InputError: It is TOML, but nested too deep or with integers that do not fit into 64 bits.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise InputError(TOO_DEEP) from None
    except ValueError:  # raised if Python refuses to read an integer of thousands of digits
        raise InputError(TOO_LARGE) from None
    values: list[Any] = [table]
    for _ in range(DEEPEST):
        if any(isinstance(value, int) and not -(2**63) <= value < 2**63 for value in values):
            raise InputError(TOO_LARGE)
        values = [child for value in values for child in _children(value)]
    if values:
        raise InputError(TOO_DEEP)
    return table


def _children(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


class TomlTable(BaseModel):
    """A table of a TOML file: unknown keys, NaN, infinity, and values of another type are refused."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)

    def complete(self) -> dict[str, Any]:
        """Return all keys with their values, including defaults, in the types of JSON."""
        return self.model_dump(mode="json", by_alias=True)


Model = TypeVar("Model", bound=TomlTable)


@dataclass(frozen=True)
class Location:
    """Location of a table in a file, for errors: `key` is dotted, and empty for the whole file."""

    file: str
    key: str = ""

    def at(self, *path: str | int) -> Location:
        """Return a location below this one: keys, and indices of lists, which errors count from 1."""
        key = self.key
        for part in path:
            if isinstance(part, int):
                key += f"[{part + 1}]"
            else:
                key = f"{key}.{part}" if key else part
        return Location(self.file, key)

    def wrong(self, value: str, expected: str) -> InputError:
        """Return the error with the value at this location and the valid values.

        Args:
            expected: Description of valid values.
        """
        return InputError(f"{self.file}: {self.key} is {value}, but must be {expected}")

    @contextlib.contextmanager
    def named(self) -> Iterator[None]:
        """Add this location to the message of an InputError that is raised inside."""
        try:
            yield
        except InputError as error:
            inside = f"in {self.key}, " if self.key else ""
            raise InputError(f"{self.file}: {inside}{error}") from error


def parse_table(model: type[Model], table: Mapping[str, Any], location: Location) -> Model:
    """Check a table.

    Args:
        table: The table, as read from the file.

    Returns:
        The table, with defaults for missing keys.

    Raises:
        InputError: There is an unknown key, which is reported first, or a value is missing or wrong.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        first = min(error.errors(include_url=False), key=lambda detail: detail["type"] != "extra_forbidden")
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, InputError):
            with location.at(*first["loc"][:-1]).named():
                raise cause from None
        raise _explained(model, table, first["loc"], location) from None


def number(default: Any = ..., *, above: float | None = None, least: float | None = None, below: float) -> Any:
    """Return a field for a number.

    Args:
        default: Its value if it is left out; without a default, the field is required.
        above: It must be larger than this.
        least: Or it must be at least this.
        below: It must be smaller than this.
    """
    bound = f"above {above:g}" if least is None else f"of at least {least:g}"
    return Field(default=default, gt=above, ge=least, lt=below, description=f"a number {bound} and below {below:g}")


def integer(default: Any = ..., *, least: int, most: int) -> Any:
    """Return a field for a whole number.

    Args:
        default: Its value if it is left out; without a default, the field is required.
        least: The smallest number allowed.
        most: The largest number allowed.
    """
    return Field(default=default, ge=least, le=most, description=f"a whole number from {least} to {most}")


def choice(names: Iterable[str], default: Any = ...) -> Any:
    """Return a field for one of several names.

    Args:
        default: Its value if it is left out; without a default, the field is required.
    """
    known = list(names)
    description = "one of " + ", ".join(f'"{name}"' for name in known)
    return Field(default=default, pattern=f"^({'|'.join(map(re.escape, known))})$", description=description)


def table(key: str) -> Any:
    """Return a field for a table with this dotted key, which may be left out."""
    return Field(default={}, validate_default=True, description=f"a table [{key}]")


def _different(texts: list[str]) -> list[str]:
    if len(set(texts)) < len(texts):
        raise ValueError
    return texts


Flag = Annotated[bool, Field(description="true or false")]
Text = Annotated[str, Field(description="a text in quotes")]
Name = Annotated[str, Field(min_length=1, description="a text in quotes, not an empty one")]
Names = Annotated[
    list[str],
    AfterValidator(_different),
    Field(min_length=1, description="a list of texts in quotes, none of them twice"),
]
Values = Annotated[
    dict[str, JsonValue],
    Field(description="a table such as { key = 1.0 }, of texts, numbers, true, false, and lists and tables of them"),
]


def _explained(
    model: type[TomlTable], table: Mapping[str, Any], path: tuple[str | int, ...], location: Location
) -> InputError:
    """Return the error at a path, with the description of the innermost field on the path that has one."""
    owner: type[TomlTable] | None = model
    key, expected = path, ""
    for depth, part in enumerate(path, 1):
        if owner is None or isinstance(part, int):
            continue
        fields = _fields(owner)
        if part not in fields:
            unknown = location.at(*path[:depth]).key
            meant = did_you_mean(part, fields)
            return InputError(f"{location.file}: unknown key {unknown}{meant}; the keys here are {', '.join(fields)}")
        description = fields[part].description
        if description:
            key, expected = path[:depth], description
        owner = _table_in(fields[part].annotation)
    return location.at(*key).wrong(_value_at(table, key), expected)


def _fields(model: type[TomlTable]) -> dict[str, FieldInfo]:
    """Return the fields of a table by their keys."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _table_in(annotation: Any) -> type[TomlTable] | None:
    """Return the kind of table in a type such as `list[Row]` or `Variant | None`."""
    if inspect.isclass(annotation) and issubclass(annotation, TomlTable):
        return annotation
    return next(filter(None, map(_table_in, get_args(annotation))), None)


def _value_at(table: Any, path: tuple[str | int, ...]) -> str:
    """Return the value at a path as a text for an error."""
    for part in path:
        if isinstance(table, dict) and part not in table:
            return "missing"
        table = table[part]
    return repr(table)
