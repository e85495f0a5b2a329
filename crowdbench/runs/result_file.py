"""`result.json`: what a run is, what it found, what it states, and the sha256 of each of the run's files.

A file that was edited afterwards, or comes from another run, is noticed. A file with fitting digests that somebody made
up is not: for that, a run is simulated again (`runs.replay`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from crowdbench.metrics.load import LARGEST
from crowdbench.runs.identity import code, digest
from crowdbench.scenario.cases import Cases
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, is_integer, is_number

RESULT = "result.json"

FORMAT = 1
"""Version of what a result holds."""

_KEYS = {
    **{"id": str, "run": dict, "scenario": dict, "interrupted": bool, "outcomes": dict, "metrics": dict},
    **{"stated": dict, "files": dict},
}
"""What every result holds."""

_RUN = {
    **{"planner": dict, "scenario": str, "cases": str, "replanning": dict, "metrics": dict, "code": str},
    "decision_limit": int | float,
}
"""What its section `run` holds, see `identity.RunId`."""

_STATED = {"privileged": bool, "overrides": dict, "record": str, "timing": dict, "versions": dict}
"""What its section `stated` holds at least: what nobody can recompute from the other files."""


def write_result(folder: Path, result: Mapping[str, Any]) -> dict[str, Any]:
    """Write `result.json`, after all other files of the run.

    Args:
        folder: The folder of the run.
        result: The contents, without the digests of the files.

    Returns:
        The contents with the digests.
    """
    contents = {"format": FORMAT, **{key: value for key, value in result.items() if key not in ("format", "files")}}
    digests = {path.name: files.sha256(path) for path in sorted(folder.iterdir()) if path.name != RESULT}
    sealed = {**contents, "files": {**digests, RESULT: _contents_digest(contents)}}
    with files.whole(folder / RESULT) as partial:
        partial.write_text(json.dumps(sealed, indent=2) + "\n", encoding="utf-8")
    return sealed


def read_result(directory: Path) -> dict[str, Any]:
    """Return the contents of a run's `result.json`. Raises InputError where it is missing or has other contents."""
    path = directory / RESULT
    try:
        result = files.read_json(path)
    except OSError as error:
        raise InputError(
            f"{directory} is not the directory of a run: {path} cannot be read ({error.strerror})"
        ) from None
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON: {error}") from None
    if isinstance(result, dict) and result.get("format") != FORMAT:
        raise InputError(f"{path} has the format {result.get('format')!r}, but this version reads format {FORMAT}")
    if not _is_result(result):
        raise InputError(f"{path} is not a result of crowdbench: it must hold {', '.join(_KEYS)}, each of its type")
    if elsewhere := [name for name in result["files"] if Path(name).name != name]:
        raise InputError(f"{path} lists {elsewhere[0]!r}, but the files of a run lie beside it")
    try:
        Cases.parse(result["run"]["cases"])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return result


def check_result(directory: Path, needed: Iterable[str] = ()) -> dict[str, Any]:
    """Read `result.json`, and check that it is whole and that the files of the run are those that it wrote.

    Args:
        directory: The directory of the run.
        needed: The files that will be read: `result.json` must list them.

    Returns:
        The contents of `result.json`.

    Raises:
        InputError: It cannot be read, its identity does not follow from its parts, or a file is missing or another one.
    """
    result, path = read_result(directory), directory / RESULT
    digests = {**result["files"]}
    if digests.pop(RESULT, "") != _contents_digest({key: value for key, value in result.items() if key != "files"}):
        raise InputError(f"{path} is not the file that the run wrote: its sha256 differs; make the run again")
    if result["id"] != digest(result["run"]):
        raise InputError(f"{path} has an id that is not that of its run; make the run again")
    for name in needed:
        if name not in digests and (directory / name).exists():
            raise InputError(f"{directory / name} is not a file of this run: {RESULT} does not list it; remove it")
    for name, expected in digests.items():
        try:
            actual = files.sha256(directory / name)
        except OSError as error:
            raise InputError(
                f"{directory / name}, which {RESULT} lists, cannot be read ({error.strerror}): make the run again"
            ) from None
        if actual != expected:
            raise InputError(
                f"{directory / name} is not the file that the run wrote: its sha256 differs from {RESULT}; "
                "make the run again"
            )
    return result


def warn_of_other_code(directory: Path, result: Mapping[str, Any]) -> list[str]:
    """Return a sentence where a run was made by another simulator than the present one."""
    if result["run"]["code"] == code():
        return []
    return [f"{directory} was made by other code of crowdbench than this, whose figures may differ"]


def _contents_digest(contents: Mapping[str, Any]) -> str:
    """Return the sha256 of the contents of `result.json` without its section `files`."""
    return hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()


def _is_result(result: Any) -> bool:
    if not isinstance(result, dict) or not all(isinstance(result.get(key), kind) for key, kind in _KEYS.items()):
        return False
    run, scenario, estimates = result["run"], result["scenario"], result["metrics"].values()
    if not all(isinstance(run.get(key), kind) for key, kind in _RUN.items()):
        return False
    planner = run["planner"]
    return (
        all(isinstance(result["stated"].get(key), kind) for key, kind in _STATED.items())
        and all(is_number(result["stated"]["timing"].get(key)) for key in ("decision_ms_per_step", "seconds"))
        and isinstance(planner.get("name"), str)
        and all(isinstance(planner.get(key), dict) for key in ("options", "files", "facts"))
        and all(map(_is_texts, (result["files"], run["metrics"], planner["facts"])))
        and isinstance(scenario.get("name"), str)
        and all(isinstance(scenario.get(key), dict) for key in ("layout", "pedestrians"))
        and all(is_number(scenario.get(key)) and 0.0 < scenario[key] < 1e9 for key in ("dt", "time_limit"))
        and all(map(is_integer, result["outcomes"].values()))
        and all(isinstance(estimate, dict) and is_integer(estimate.get("n")) for estimate in estimates)
        and all(estimate.get("mean") is None or _is_moderate(estimate["mean"]) for estimate in estimates)
    )


def _is_texts(table: Mapping[str, Any]) -> bool:
    return all(isinstance(value, str) for value in table.values())


def _is_moderate(value: Any) -> bool:
    return is_number(value) and abs(value) <= LARGEST
