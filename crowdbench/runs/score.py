"""Compute a run again from its exact store, and compare the result with its files.

States, outcomes and metrics follow from commands or tracks and can be checked. The origin of the commands, their
computation time and the information used for them cannot be checked.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import Metric, need_undisturbed
from crowdbench.results.episodes import EPISODES, RECORDING, Episodes
from crowdbench.results.result_file import RESULT, digest_of, has_run
from crowdbench.results.run_result import RunResult, write_run
from crowdbench.results.stored_commands import COMMANDS
from crowdbench.results.stored_tracks import TRACKS
from crowdbench.runs.differences import Difference, compare_episodes, compare_values
from crowdbench.runs.identity import code, source_of
from crowdbench.runs.replay import stored_traces
from crowdbench.runs.rollout import Progress
from crowdbench.runs.run import read_versions
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import new_directory


@dataclass(frozen=True)
class Replay:
    """Result of computing a run again.

    Attributes:
        episodes: The episodes that were computed again.
        store: The file of the exact store.
        metrics: Number of metrics that were compared.
        unchecked: The columns of `episodes.csv` whose metric is not known.
        versions: Differences between the versions and the machine of the run and of the replay. If empty, everything
            was compared to the last bit.
        differences: Differences between the run and its replay.
    """

    episodes: Episodes
    store: str
    metrics: int
    unchecked: list[str]
    versions: list[str]
    differences: list[Difference]

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as JSON values."""
        return {
            "agrees": not self.differences,
            "cases": len(self.episodes),
            "metrics": self.metrics,
            "unchecked": self.unchecked,
            "versions": self.versions,
            "differences": [vars(difference) for difference in self.differences],
        }

    def __str__(self) -> str:
        how = "outcomes exactly and figures to 1e-6" if self.versions else "to the last bit"
        again = "measured again from their tracks" if self.store == TRACKS else "simulated again from their commands"
        lines = [
            f"{len(self.episodes)} cases were {again} and compared, {how}: outcomes, steps and {self.metrics} metrics "
            "with episodes.csv, their summary with result.json."
        ]
        if self.versions:
            lines.append(f"The last bits may differ, because {', '.join(self.versions)}.")
        if self.unchecked:
            unknown = ", ".join(self.unchecked)
            lines.append(f"Not compared, because their metric is not known: {unknown} (see --metric).")
        if self.differences:
            return "\n".join([*lines, f"The run differs from what {self.store} gives:", *map(str, self.differences)])
        lines.append(
            "All agree. Stated by the run alone: the planner with its options, `privileged`, `raw`, names, times and "
            "versions."
        )
        return "\n".join(lines)


def replay_run(
    run: RunResult, scenario: Scenario | None, metrics: Mapping[str, Metric], progress: Progress | None = None
) -> Replay:
    """Compute all cases of a run again, and compare.

    Args:
        run: The stored run.
        scenario: The scenario of a simulated run, loaded from its `result.json`; None for stored tracks.
        metrics: Metrics by name; all are measured, and those that the run contains are compared.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.

    Raises:
        InputError: The run has no commands or other ones than a vehicle can execute, or a pedestrian policy or a metric
            breaks its contract.
    """
    changed = _changed_versions(run)
    if scenario is None:
        store, parts = TRACKS, [Episodes.of(run.tracks, metrics)]
    else:
        undisturbed = need_undisturbed(metrics)
        traces = stored_traces(run, lambda _: scenario, undisturbed=undisturbed, progress=progress)
        store, parts = COMMANDS, [Episodes.of(trace, metrics) for trace in traces]
        if "others" in run.result["run"]:
            parts = [part.of_first_vehicle() for part in parts]
    replayed = Episodes.join(parts)
    if not np.array_equal(replayed.case, run.episodes.case):
        raise InputError(f"{run.directory / store}: its cases differ from {EPISODES}; make the run again")
    names = [f"{run.cases.split}/{case}" for case in replayed.case.tolist()]
    differences = compare_episodes(names, run.episodes, replayed, exact=not changed)
    return Replay(
        episodes=replayed,
        store=store,
        metrics=sum(name in metrics for name in run.episodes.columns),
        unchecked=[name for name in run.episodes.columns if name not in metrics],
        versions=changed,
        differences=[*differences, *_compare_recording(run, replayed)],
    )


def scored_parts(run: RunResult, metrics: Mapping[str, Metric]) -> dict[str, Any]:
    """Return the parts of the identity of a stored run with these metrics."""
    return run.result["run"] | {"metrics": {name: source_of(metric) for name, metric in metrics.items()}}


def write_scored(run: RunResult, replay: Replay, metrics: Mapping[str, Metric], out: Path, overwrite: bool) -> None:
    """Write a stored run with the metrics of its replay, as if it had been driven with them.

    Args:
        run: The stored run.
        replay: Its replay.
        metrics: The metrics of the replay, by name.
        out: The directory to write. If it has this run already, nothing is written.
        overwrite: True to replace an earlier run in `out`.

    Raises:
        InputError: The replay differs from the run, or `out` cannot be written.
    """
    if replay.differences:
        raise InputError(f"{out} is not written, because {run.directory} differs from its replay: make the run again")
    parts = scored_parts(run, metrics)
    if not overwrite and has_run(out, digest_of(parts)):
        return
    result = run.result
    with new_directory(out, overwrite) as folder:
        for name in (COMMANDS, TRACKS, RECORDING):
            if (run.directory / name).exists():
                shutil.copyfile(run.directory / name, folder / name)
        write_run(
            folder,
            replay.episodes,
            run=parts,
            scenario=result["scenario"],
            recorded=result["recorded"],
            stated=result["stated"],
        )


def _compare_recording(run: RunResult, replayed: Episodes) -> list[Difference]:
    """Return the cases of the recording with another outcome, and a difference in their number."""
    if not (run.directory / RECORDING).exists():
        return []
    from crowdbench.record.recorded_cases import recorded_outcomes

    recorded = recorded_outcomes(run.directory / RECORDING)
    labels = [Outcome(end).label for end in replayed.outcome.tolist()]
    outcomes = list(zip(replayed.case.tolist(), labels, strict=True))
    ends = dict(outcomes) | {case: end for case, end in outcomes if recorded.get(case) == end}
    names = [f"{run.cases.split}/{case}" for case in recorded]
    number = [run.result["recorded"]], [len(recorded)]
    return [
        *compare_values(f"values in {RESULT} differ", ["recorded"], *number),
        *compare_values(f"episodes in {RECORDING} end otherwise", names, recorded.values(), map(ends.get, recorded)),
    ]


def _changed_versions(run: RunResult) -> list[str]:
    """Return the versions that influence the last bits of results and differ from the run."""
    known = run.result["stated"]["versions"]
    changed = [
        f"{name} is {here} here and was {known.get(name, 'another')} in the run"
        for name, here in read_versions().items()
        if known.get(name) != here
    ]
    if run.result["run"]["code"] != code():
        changed.append("the code of crowdbench is another than in the run")
    return changed
