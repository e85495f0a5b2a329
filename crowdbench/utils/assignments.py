"""Keys and values that are written as texts, such as `vehicle.visible=true`."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

from crowdbench.utils.errors import InputError


def read_overrides(overrides: object) -> dict[str, Any]:
    """Return values for keys of a scenario, given as a table by dotted key, as texts or as None.

    Raises:
        InputError: They are something else, or a text is no assignment.
    """
    if overrides is None:
        return {}
    if isinstance(overrides, Mapping) and all(isinstance(key, str) for key in overrides):
        return dict(overrides)
    if isinstance(overrides, list | tuple) and all(isinstance(text, str) for text in overrides):
        return assignments(overrides, "overrides")
    right = "a table such as {'vehicle.visible': True}, or texts such as ['vehicle.visible=true']"
    raise InputError(f"overrides are {overrides!r}, but must be {right}")


def assignments(texts: Iterable[str], flag: str) -> dict[str, Any]:
    """Return the keys and values of options such as `--set key=value`.

    Args:
        texts: The given texts. A value is TOML; a value that is not valid TOML is a text.
        flag: The option, for the error.

    Returns:
        The values by their keys.

    Raises:
        InputError: A text has no key or no `=`, or its value is TOML that cannot be used.
    """
    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            option = f"{flag} " if flag.startswith("--") else ""
            raise InputError(f"{flag} {text!r} sets nothing: write {option}key=value")
        try:
            pairs[key.strip()] = _parse_value(value)
        except InputError as error:
            raise InputError(f"{flag} {key.strip()} cannot be used: {error}") from None
    return pairs


def _parse_value(text: str) -> Any:
    """Return the value of a text in TOML; the text itself if it is not valid TOML."""
    from crowdbench.utils.toml import toml  # commands start without pydantic

    try:
        read = toml(f"value = {text}")
        # Results are JSON, which has no dates and no infinity. These stay texts.
        json.dumps(read, allow_nan=False)
    except InputError:
        raise
    except (tomllib.TOMLDecodeError, TypeError, ValueError):
        return text
    return read["value"] if len(read) == 1 else text
