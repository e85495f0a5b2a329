"""The manifest of a run: what was asked for, with what it was made, and the sha256 of each of its files.

A file that was edited afterwards, or comes from another run, is noticed. Somebody who writes a fitting manifest is
not: for that, a run is simulated again.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import read_json, sha256

MANIFEST = "manifest.json"

FORMAT = 1
"""Version of what a manifest holds."""

_PACKAGE = Path(__file__).parent.parent
APART = tuple(
    _PACKAGE / name
    for name in (
        *("agents", "bench", "boards", "certify", "check", "cli", "envs", "figures", "study", "train", "notebook.py"),
        *("runs/compare.py", "runs/differences.py", "runs/on_ray.py", "runs/paired.py", "runs/replay.py"),
    )
)
"""Parts of the package on which no run depends, and the planners, whose files count one by one."""


@functools.cache
def code() -> str:
    """The sha256 of the code of crowdbench on which runs depend, apart from the planners' own files."""
    paths = [path for path in sorted(_PACKAGE.rglob("*.py")) if not any(map(path.is_relative_to, APART))]
    digests = {path.relative_to(_PACKAGE).as_posix(): sha256(path) for path in paths}
    return hashlib.sha256(json.dumps(digests).encode()).hexdigest()


def write_manifest(directory: Path, about: Mapping[str, Any]) -> None:
    """Write the manifest of a run, after all its other files.

    Args:
        directory: The directory of the run.
        about: What the manifest says beside its format, the digests of the files, and that of crowdbench's code.
    """
    files = {path.name: sha256(path) for path in sorted(directory.iterdir())}
    manifest = {"format": FORMAT, "files": files, "code": code(), **about}
    (directory / MANIFEST).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")


def check_files(directory: Path, needed: Iterable[str]) -> dict[str, Any]:
    """Check that the files of a run are those that it wrote.

    Args:
        directory: The directory of the run.
        needed: The files that will be read: the manifest must list them.

    Returns:
        The manifest, empty where there is none: `files` has the sha256 of each file by its name, `code` the digest of
        the code of crowdbench that made the run, `versions` those of Python and packages, and `interrupted` says
        whether the run ended before the last of its cases.

    Raises:
        InputError: The manifest cannot be read, or a file that it lists is missing or another one.
    """
    path = directory / MANIFEST
    if not path.exists():
        return {}
    manifest = _read(path)
    for name in needed:
        if name not in manifest["files"] and (directory / name).exists():
            raise InputError(f"{directory / name} is not a file of this run: {MANIFEST} does not list it; remove it")
    for name, digest in manifest["files"].items():
        try:
            found = sha256(directory / name)
        except OSError as error:
            raise InputError(
                f"{directory / name}, which {MANIFEST} lists, cannot be read ({error.strerror}): make the run again"
            ) from None
        if found != digest:
            raise InputError(
                f"{directory / name} is not the file that the run wrote: its sha256 differs from {MANIFEST}; "
                "make the run again"
            )
    return manifest


def doubts(directory: Path, needed: Iterable[str]) -> list[str]:
    """What there is to say of a run whose files are those that it wrote.

    Args:
        directory: The directory of the run.
        needed: The files that will be read.

    Returns:
        A sentence where it has no manifest, or was made by other code than the present one.

    Raises:
        InputError: As `check_files` does.
    """
    manifest = check_files(directory, needed)
    if not manifest:
        return [no_manifest(directory)]
    if manifest["code"] != code():
        return [f"{directory} was made by other code of crowdbench than this, whose figures may differ"]
    return []


def no_manifest(directory: Path) -> str:
    """The sentence on a run that has no manifest."""
    return f"{directory} has no {MANIFEST}, so that nobody can tell whether its files are those that the run wrote"


def _read(path: Path) -> dict[str, Any]:
    try:
        table = read_json(path)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON: {error}") from None
    if not isinstance(table, dict):
        raise InputError(f"{path} is not a manifest of crowdbench: it must be a table")
    if table.get("format") != FORMAT:
        raise InputError(f"{path} has the format {table.get('format')!r}, but this version reads format {FORMAT}")
    texts = table.get("files"), table.get("versions"), {"code": table.get("code")}
    if not all(map(_is_texts, texts)) or not isinstance(table.get("interrupted"), bool):
        raise InputError(
            f"{path} is not a manifest of crowdbench: it must hold files, code, versions, interrupted, each of its type"
        )
    if elsewhere := [name for name in table["files"] if Path(name).name != name]:
        raise InputError(f"{path} lists {elsewhere[0]!r}, but the files of a run lie beside its manifest")
    return table


def _is_texts(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(each, str) for each in value.values())
