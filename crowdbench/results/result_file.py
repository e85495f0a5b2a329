"""`result.json`: the identity, the results and the stated facts of a run, and the sha256 of each of its files.

The digests detect a file that was edited afterwards or belongs to another run. They do not detect forged files with
matching digests: for that, a run is computed again (`runs.score`).
"""

from __future__ import annotations

import glob
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from crowdbench.metrics.user_metrics import LARGEST
from crowdbench.results.episodes import EPISODES, RECORDING
from crowdbench.results.stored_commands import COMMANDS
from crowdbench.results.stored_tracks import TRACKS
from crowdbench.scenario.cases import Cases
from crowdbench.utils import files
from crowdbench.utils.defaults import RECORD
from crowdbench.utils.errors import InputError
from crowdbench.utils.records import check_record

RESULT = "result.json"

FORMAT = 1
"""Version of the format of a result."""

Table = dict[str, Any]
Amount = Annotated[float, Field(ge=0.0, le=1e12)]
Seconds = Annotated[float, Field(gt=0.0, lt=1e9)]
Mean = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Count = Annotated[int, Field(ge=0)]


class PlannerPart(BaseModel, extra="forbid"):
    """The planner of a run, see `identity.PlannerId`."""

    name: str
    options: Table
    files: Table
    facts: dict[str, str]
    key: str


class RunPart(BaseModel, extra="forbid"):
    """The identity of a run, see `identity.RunId`."""

    planner: PlannerPart
    scenario: str
    cases: str
    replanning: Table
    batch: int | None
    metrics: dict[str, str]
    decision_limit: float
    code: str
    simulator: int
    others: PlannerPart | None = None


class ScenarioPart(BaseModel):
    """The keys of a scenario that are read without loading it. Others are checked when it is loaded."""

    name: str
    layout: Table = {}
    pedestrians: Table
    dt: Seconds
    time_limit: Seconds


class EstimatePart(BaseModel):
    """The mean of a metric. `RunResult.check` computes all its numbers again."""

    n: int
    mean: Mean | None = None


class TimingPart(BaseModel, extra="forbid"):
    """Wall-clock times. A robot has no decision time."""

    seconds: Amount
    decision_ms_per_step: Amount = 0.0


class StatedPart(BaseModel, extra="forbid"):
    """Facts that cannot be computed from the other files."""

    privileged: bool
    raw: bool = False
    overrides: Table
    record: Literal[RECORD]  # type: ignore[valid-type]
    timing: TimingPart
    versions: dict[str, str]
    isolation: dict[str, str | Amount] = {}
    notes: list[str] = []


class ResultContents(BaseModel, extra="forbid"):
    """The contents of `result.json`."""

    format: int
    id: str
    run: RunPart
    scenario: ScenarioPart
    recorded: Count
    outcomes: dict[str, int]
    metrics: dict[str, EstimatePart]
    blocks: Count = 0
    rates: list[str]
    stated: StatedPart
    files: dict[str, str]


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
    sealed = {**contents, "files": {**digests, RESULT: digest_of(contents)}}
    with files.write_whole(folder / RESULT) as partial:
        partial.write_text(json.dumps(sealed, indent=2) + "\n", encoding="utf-8")
    return sealed


def read_result(directory: Path) -> dict[str, Any]:
    """Return the contents of a run's `result.json`. Raises InputError if it is missing or has other contents."""
    path = directory / RESULT
    try:
        result = files.read_json(path)
    except OSError as error:
        inside = f"; give those in it: {directory}/*" if glob.glob(f"*/{RESULT}", root_dir=directory) else ""
        raise InputError(
            f"{directory} is not the directory of a run: {path} cannot be read ({error.strerror}){inside}"
        ) from None
    check_record(ResultContents, result, path, "result", FORMAT)
    if elsewhere := [name for name in result["files"] if Path(name).name != name]:
        raise InputError(f"{path} lists {elsewhere[0]!r}, but the files of a run lie beside it")
    try:
        Cases.parse(result["run"]["cases"])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return result


def check_result(directory: Path, tables_only: bool = False) -> dict[str, Any]:
    """Read `result.json`, and check its digest, its id and the digests of the run's files.

    Args:
        directory: The directory of the run.
        tables_only: True if files other than `episodes.csv` may be missing.

    Returns:
        The contents of `result.json`.

    Raises:
        InputError: It cannot be read, its id does not follow from its parts, or a file is missing or was changed.
    """
    result, path = read_result(directory), directory / RESULT
    digests = {**result["files"]}
    if digests.pop(RESULT, "") != digest_of({key: value for key, value in result.items() if key != "files"}):
        raise InputError(f"{path} is not the file that the run wrote: its sha256 differs; make the run again")
    if result["id"] != digest_of(result["run"]):
        raise InputError(f"{path} has an id that is not that of its run; make the run again")
    for name in (EPISODES, COMMANDS, TRACKS, RECORDING):
        if name not in digests and (directory / name).exists():
            raise InputError(f"{directory / name} is not a file of this run: {RESULT} does not list it; remove it")
    for name, expected in digests.items():
        if tables_only and name != EPISODES and not (directory / name).exists():
            continue
        try:
            actual = files.sha256(directory / name)
        except OSError as error:
            raise InputError(f"{directory / name} cannot be read ({error.strerror}): make the run again") from None
        if actual != expected:
            raise InputError(f"{directory / name} is not the file that the run wrote: its sha256 differs; run it again")
    return result


def has_run(directory: Path, digest: str) -> bool:
    """Return whether a directory contains the run with an id. Raises InputError if its files are not as written."""
    return (directory / RESULT).exists() and bool(check_result(directory)["id"] == digest)


def digest_of(contents: Mapping[str, Any]) -> str:
    """Return the sha256 of a table of JSON values: of the parts of a run's identity, or of a result without `files`."""
    return hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()
