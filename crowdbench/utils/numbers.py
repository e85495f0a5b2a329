"""Whether a value that somebody wrote is a number: in Python `True` is one, and so is NaN."""

from __future__ import annotations

from typing import Any

from crowdbench.utils.errors import InputError


def is_integer(value: Any) -> bool:
    """Whether a value is a whole number, and not True or False."""
    return isinstance(value, int) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Whether a value is a number, and neither True, False nor NaN."""
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def require(name: str, value: object, good: bool, right: str) -> None:
    """Raise InputError, which says what the value called `name` is and what it must be, unless it is good."""
    if not good:
        raise InputError(f"{name} is {value!r}, but must be {right}")


def require_count(name: str, value: object) -> None:
    """Raise InputError unless the value called `name` is a whole number above 0."""
    require(name, value, is_integer(value) and value >= 1, "a whole number, 1 or more")  # type: ignore[operator]
