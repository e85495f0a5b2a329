"""`result.json`: the identity, the results and the stated facts of a run, and the sha256 of each of its files.

The digests detect a file that was edited afterwards or belongs to another run. They do not detect forged files with
matching digests: for that, a run is simulated again (`runs.replay`).
"""

from __future__ import annotations

import glob
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, create_model

from crowdbench.metrics.user_metrics import LARGEST
from crowdbench.results.episodes import EPISODES, RECORDING
from crowdbench.results.stored_commands import COMMANDS
from crowdbench.scenario.cases import Cases
from crowdbench.utils import files
from crowdbench.utils.defaults import RECORD
from crowdbench.utils.errors import InputError
from crowdbench.utils.records import check_record

RESULT = "result.json"

FORMAT = 1
"""Version of the format of a result."""

STATED = (
    "Means and intervals are recomputed from episodes.csv, and `crowdbench score RUN --replay` recomputes that file. "
    "Stated by the runs alone: planners with their options, `privileged`, names, times and versions."
)
"""Note on the facts that a table of runs cannot prove; a re-run, such as a signed verification on a board, does."""

_Texts = dict[str, str]
_Table = dict[str, Any]
_Figure = Annotated[float, Field(ge=0.0, le=1e12)]
_Seconds = Annotated[float, Field(gt=0.0, lt=1e9)]
_Mean = Annotated[float, Field(ge=-LARGEST, le=LARGEST)] | None
_Count = Annotated[int, Field(ge=0)]

_ALONE: Any = {"__config__": ConfigDict(extra="forbid")}
_Planner = create_model("_Planner", name=str, options=_Table, files=_Table, facts=_Texts, key=str, **_ALONE)
_Rest = create_model(
    "_Rest", replanning=_Table, batch=(int | None, ...), code=str, simulator=int, decision_limit=float, **_ALONE
)
_Run = create_model("_Run", __base__=_Rest, planner=_Planner, scenario=str, cases=str, metrics=_Texts)
_Scenario = create_model(
    "_Scenario", name=str, layout=(_Table, {}), pedestrians=_Table, dt=_Seconds, time_limit=_Seconds
)
_Estimate = create_model("_Estimate", n=int, mean=(_Mean, None))
_Timing = create_model("_Timing", seconds=_Figure, decision_ms_per_step=(_Figure, 0.0), **_ALONE)
_Machine = create_model("_Machine", versions=_Texts, isolation=(dict[str, str | _Figure], {}), timing=_Timing, **_ALONE)
_Record: Any = Literal[RECORD]
_Stated = create_model("_Stated", __base__=_Machine, privileged=bool, overrides=_Table, record=_Record)
_Metrics: Any = dict[str, _Estimate]  # type: ignore[valid-type]
_Found = create_model("_Found", outcomes=dict[str, int], metrics=_Metrics, blocks=(_Count, 0), **_ALONE)
_Head = create_model("_Head", __base__=_Found, format=int, id=str, run=_Run, scenario=_Scenario, rates=list[str])
_Result = create_model("_Result", __base__=_Head, recorded=_Count, stated=_Stated, files=_Texts)
"""The contents of results, see `identity.RunId`. The section `stated` cannot be recomputed from the other files."""


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
    check_record(_Result, result, path, "result", FORMAT)
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
    for name in (EPISODES, COMMANDS, RECORDING):
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


def digest_of(contents: Mapping[str, Any]) -> str:
    """Return the sha256 of a table of JSON values: of the parts of a run's identity, or of a result without `files`."""
    return hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()
