"""Whether a value that somebody wrote is a number: in Python `True` is one, and so is NaN."""

from __future__ import annotations

from typing import Any


def is_integer(value: Any) -> bool:
    """Whether a value is a whole number, and not True or False."""
    return isinstance(value, int) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Whether a value is a number, and neither True, False nor NaN."""
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value
