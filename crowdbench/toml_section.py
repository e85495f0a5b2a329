"""Reads TOML files and says in one sentence what is wrong with them."""

from __future__ import annotations

import contextlib
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from crowdbench.errors import InputError


def read_toml(path: Path, kind: str) -> dict[str, Any]:
    """The table of a file; `kind` is the word for what it describes. Raises InputError where it cannot be read."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{kind} {path} cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{kind} {path} is not valid TOML: {error}") from None


class Section:
    """One table of the file. Every read names the key and its default; `close` finds keys nobody reads.

    `complete` collects what was read, defaults included, in one form however it was written. Every read raises
    InputError, naming the file and the key, where the value is of another kind.
    """

    def __init__(self, table: dict[str, Any], source: str, prefix: str = "") -> None:
        self.table = table
        self.source = source
        self.prefix = prefix
        self.complete: dict[str, Any] = {}
        self.sections: dict[str, Section] = {}

    def wrong(self, key: str, right: str) -> InputError:
        """The error that says what a key should be."""
        found = repr(self.table[key]) if key in self.table else "missing"
        return InputError(f"{self.source}: {self.prefix}{key} is {found}, but must be {right}")

    @contextlib.contextmanager
    def blamed(self) -> Iterator[None]:
        """Says of an InputError raised elsewhere that this table is the reason."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.source}: in {self.prefix.rstrip('.')}, {error}") from error

    def read(self, key: str, default: Any) -> Any:
        """Whatever the key holds."""
        self.complete[key] = self.table.get(key, default)
        return self.complete[key]

    def section(self, key: str) -> Section:
        """The table under a key, empty where there is none."""
        if key not in self.sections:
            table = self.table.get(key, {})
            if not isinstance(table, dict):
                raise self.wrong(key, f"a table [{self.prefix}{key}]")
            self.sections[key] = Section(table, self.source, f"{self.prefix}{key}.")
            self.complete[key] = self.sections[key].complete
        return self.sections[key]

    def tables(self, key: str) -> list[Section]:
        """The tables of a list, none where there is no list. Their errors count them from 1."""
        tables = self.read(key, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise self.wrong(key, "a list of tables")
        return [Section(table, self.source, f"{self.prefix}{key}[{i}].") for i, table in enumerate(tables, 1)]

    def text(self, key: str, default: str = "") -> str:
        """A text."""
        value = self.read(key, default)
        if not isinstance(value, str):
            raise self.wrong(key, "a text in quotes")
        return value

    def needed(self, key: str) -> str:
        """A text that must be there and not be empty."""
        if not self.text(key):
            raise self.wrong(key, "a text in quotes")
        return self.text(key)

    def texts(self, key: str) -> list[str]:
        """One text or more, none of them twice."""
        value = self.read(key, None)
        if (
            not isinstance(value, list)
            or not value
            or not all(isinstance(text, str) for text in value)
            or len(set(value)) < len(value)
        ):
            raise self.wrong(key, "a list of texts in quotes, none of them twice")
        return value

    def values(self, key: str) -> dict[str, Any]:
        """A table of whatever results can hold, empty where there is none."""
        value = self.read(key, {})
        try:
            # Results are JSON, which knows neither dates nor infinity.
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError):
            raise self.wrong(key, "a table of texts, numbers, true, false, and lists of them") from None
        if not isinstance(value, dict):
            raise self.wrong(key, "a table such as { key = 1.0 }")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """True or false."""
        value = self.read(key, default)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def choice(self, key: str, default: str, choices: tuple[str, ...]) -> str:
        """One of the texts named."""
        value = self.read(key, default)
        if value not in choices:
            raise self.wrong(key, "one of " + ", ".join(f'"{choice}"' for choice in choices))
        return str(value)

    def integer(self, key: str, default: int, low: int, high: int) -> int:
        """A whole number, bounds included."""
        value = self.read(key, default)
        if not is_integer(value) or not low <= value <= high:
            raise self.wrong(key, f"a whole number from {low} to {high}")
        return int(value)

    def number(
        self, key: str, default: float, *, least: float | None = None, above: float = 0.0, below: float
    ) -> float:
        """A number above `above`, or equal to `least`, and below `below`."""
        value = self.read(key, default)
        if not is_number(value) or not (value > above or value == least) or not value < below:
            bound = f"of at least {least:g}" if least is not None else f"above {above:g}"
            raise self.wrong(key, f"a number {bound} and below {below:g}")
        self.complete[key] = float(value)
        return float(value)

    def interval(self, key: str, default: int, low: int, high: int) -> tuple[int, int]:
        """The least and the largest of whole numbers, which may be written as one."""
        value = self.read(key, default)
        pair = [value, value] if is_integer(value) else value
        if (
            not isinstance(pair, list)
            or len(pair) != 2
            or not all(map(is_integer, pair))
            or not low <= pair[0] <= pair[1] <= high
        ):
            raise self.wrong(key, f"a whole number from {low} to {high}, or a pair of them, [least, most]")
        self.complete[key] = pair
        return pair[0], pair[1]

    def close(self) -> None:
        """Raises InputError where the table has a key that nobody has read."""
        for key in self.table:
            if key not in self.complete:
                known = ", ".join(self.complete)
                raise InputError(f"{self.source}: unknown key {self.prefix}{key}; the keys here are {known}")


def is_integer(value: Any) -> bool:
    """Whether a value of a TOML file is a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Whether a value of a TOML file is a number, not NaN."""
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value
