"""Merge several runs of adjoining cases into one run of all cases."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.results.episodes import RECORDING, Episodes
from crowdbench.results.result_file import digest_of, has_run, read_result
from crowdbench.results.run_result import RunResult, write_run
from crowdbench.results.stored_commands import COMMANDS, join_commands
from crowdbench.runs.identity import code
from crowdbench.runs.recording import most_failures
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import new_directory

MAY_DIFFER = ("timing", "versions", "isolation")
"""Sections that may differ between the parts of a run."""


def merge(directories: Sequence[Path], out: Path, overwrite: bool = False) -> dict[str, Any]:
    """Merge several runs into one.

    Its episodes and commands are the same, to the last byte, as in a run that drives all cases. It has the metrics that
    all parts have: a part lacks a metric of the user that failed in it.

    Args:
        directories: The runs, in any order.
        out: The directory to write. If it has the merged run already, nothing is written.
        overwrite: True if an earlier run in `out` is replaced.

    Returns:
        The contents of its `result.json`.

    Raises:
        InputError: The runs do not fit together, a file is not the one that its run wrote, or `out` cannot be written.
    """
    parts = sorted(map(RunResult.read, directories), key=lambda part: (part.cases.split, part.cases.start))
    _check_fitting(parts)
    metrics = _shared_metrics(parts)
    episodes = Episodes.join([part.episodes.without(part.episodes.columns.keys() - metrics) for part in parts])
    first, last = parts[0].cases, parts[-1].cases
    cases = Cases(first.split, first.start, last.stop)
    run = parts[0].result["run"] | {"cases": str(cases), "metrics": metrics}
    if not overwrite and has_run(out, digest_of(run)):
        return read_result(out)
    stated = [part.result["stated"] for part in parts]
    joined = {name: _join([table[name] for table in stated]) for name in ("versions", "isolation") if name in stated[0]}
    with new_directory(out, overwrite) as directory:
        if (parts[0].directory / COMMANDS).exists():
            join_commands([part.directory / COMMANDS for part in parts], directory / COMMANDS)
        return write_run(
            directory,
            episodes,
            run=run,
            scenario=parts[0].result["scenario"],
            recorded=_join_recordings(parts, directory / RECORDING),
            stated={**stated[0], "timing": _timing(parts), **joined},
        )


def _check_fitting(parts: Sequence[RunResult]) -> None:
    if not parts:
        raise InputError("there is no run to merge: name the directories of runs")
    for part in parts:
        if not part.is_simulated:
            raise InputError(f"{part.directory} holds tracks, and only simulated runs are merged")
        if part.result["run"]["code"] != code():
            raise InputError(f"{part.directory} was not made by this version of crowdbench: make it again")
    metrics = _shared_metrics(parts)
    for before, after in itertools.pairwise(parts):
        a, b = _shared(before, metrics), _shared(after, metrics)
        if differ := [key for key in dict.fromkeys([*a, *b]) if a.get(key) != b.get(key)]:
            raise InputError(f"{before.directory} and {after.directory} are not of one run: they differ in {differ[0]}")
        if (before.cases.split, before.cases.stop) != (after.cases.split, after.cases.start):
            raise InputError(
                f"{before.directory} has cases {before.cases} and {after.directory} has {after.cases}, but the cases "
                "of runs that are merged must follow each other without a gap and without an overlap"
            )


def _shared_metrics(parts: Sequence[RunResult]) -> dict[str, str]:
    """Return the digests of the metrics that all parts have, by name."""
    first, *others = (part.result["run"]["metrics"] for part in parts)
    return {name: digest for name, digest in first.items() if all(name in metrics for metrics in others)}


def _shared(part: RunResult, metrics: Mapping[str, str]) -> dict[str, Any]:
    """Return the fields that must be equal in all parts of a run, beginning with the run's identity."""
    run = part.result["run"] | {"cases": "", "metrics": {name: part.result["run"]["metrics"][name] for name in metrics}}
    stated = {key: value for key, value in part.result["stated"].items() if key not in MAY_DIFFER}
    return {**run, "name of the scenario": part.result["scenario"]["name"], **stated}


def _join_recordings(parts: Sequence[RunResult], path: Path) -> int:
    """Join the recordings of the parts until `most_failures` is reached, and return the number of episodes.

    Args:
        parts: The parts.
        path: The recording to write.
    """
    recorded = [part for part in parts if part.result["recorded"]]
    if not recorded:
        return 0
    from crowdbench.record.write import Recorder

    number = 0
    # Recorded crowds have no key `number`, and are not that large.
    most = most_failures(parts[0].result["scenario"]["pedestrians"].get("number", [0, 0])[1])
    with Recorder(path, **parts[0].header) as recorder:
        for part in recorded:
            if number < most or part.result["stated"]["record"] == "all":
                number += recorder.copy(part.directory / RECORDING)
    return number


def _timing(parts: Sequence[RunResult]) -> dict[str, float]:
    timings = [part.result["stated"]["timing"] for part in parts]
    steps = [int(part.episodes.steps.sum()) for part in parts]
    mean = float(np.average([timing["decision_ms_per_step"] for timing in timings], weights=steps))
    return {"decision_ms_per_step": mean, "seconds": sum(timing["seconds"] for timing in timings)}


def _join(tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the joined table: the largest of numbers, and all distinct texts, such as the machines of a cluster."""
    joined: dict[str, Any] = {}
    for name in tables[0]:
        values = [table[name] for table in tables if name in table]
        is_text = any(isinstance(value, str) for value in values)
        joined[name] = ", ".join(dict.fromkeys(map(str, values))) if is_text else max(values)
    return joined
