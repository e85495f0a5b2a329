"""Checks the contents of JSON files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from crowdbench.utils.errors import InputError

Model = TypeVar("Model", bound=BaseModel)


def check_record(model: type[Model], contents: Any, path: Path, what: str, version: int) -> Model:
    """Check the contents of a JSON file.

    Args:
        what: The word for what it describes, such as "entry".
        version: The version of the format, which the file has under the key `format`.

    Raises:
        InputError: The file has another format, or anything in it is missing or wrong.
    """
    if isinstance(contents, dict) and contents.get("format") != version:
        raise InputError(f"{path} has the format {contents.get('format')!r}, but this version reads format {version}")
    try:
        return model.model_validate(contents, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"])) or "the whole file"
        said = first.get("ctx", {}).get("error", first["msg"])  # pydantic's own message begins with "Value error"
        raise InputError(f"{path} is no {what} of crowdbench: {key}: {said}") from None
