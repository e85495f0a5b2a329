"""A run simulated again from its scenario, its cases and the recorded commands, without its planner.

Whatever made the run, its planner included, has no part in the replay: the files of the run are data. What follows from
the commands can be checked: states, outcomes, metrics. Who gave the commands, how fast, and what he knew cannot.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool

from crowdbench.errors import InputError
from crowdbench.evaluate import commands, differences, seal
from crowdbench.evaluate.commands import COMMANDS, Commands
from crowdbench.evaluate.differences import Difference, listed
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import Metric
from crowdbench.evaluate.playback import Playback
from crowdbench.evaluate.results import (
    EPISODES,
    RECORDING,
    RESULT,
    Episodes,
    planner_label,
    read_result,
    replanning_of,
    to_json,
)
from crowdbench.evaluate.rollout import rollout
from crowdbench.evaluate.seal import MANIFEST, checked
from crowdbench.evaluate.wanted import fitting, versions
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import BATCH
from crowdbench.types import Trace

if TYPE_CHECKING:
    from crowdbench.record.read import Recording


@dataclass(frozen=True)
class RunFiles:
    """What a run has left, read but not checked.

    Attributes:
        result: The contents of `result.json`.
        cases: The cases that it says the run has.
        episodes: The rows of `episodes.csv`.
        commands: The commands.
        recording: The recorded episodes; None where none is there.
        code: The digest of the code of crowdbench that made the run, as its manifest says; empty where that is unknown.
        broken: In which file the manifest finds an edit, as a sentence; empty if in none.
    """

    result: dict[str, Any]
    cases: Cases
    episodes: Episodes
    commands: Commands
    recording: Recording | None
    code: str
    broken: str

    @property
    def recorded(self) -> int:
        """How many episodes are recorded."""
        return 0 if self.recording is None else len(self.recording.trace)

    @classmethod
    def read(cls, directory: Path) -> RunFiles:
        """Read the files of a run. Raises InputError where one is missing or damaged; `run.rrd` may be missing."""
        if not directory.is_dir():
            raise InputError(f"{directory} is not the directory of a run, which --replay needs")
        result = read_result(directory)
        recording = None
        if (directory / RECORDING).exists():
            from crowdbench.record.read import read

            recording = read(directory / RECORDING)
        code, broken = "", ""
        try:
            manifest = checked(directory, (RESULT, EPISODES, COMMANDS, RECORDING))
            code = manifest.code if manifest is not None else ""
        except InputError as error:
            broken = str(error)  # and the replay says what in the file is wrong
        return cls(
            result,
            Cases.parse(result["cases"]),
            Episodes.read(directory / EPISODES),
            commands.read(directory / COMMANDS),
            recording,
            code,
            broken,
        )


@dataclass(frozen=True)
class Replay:
    """What a replay has found.

    Attributes:
        cases: How many cases were simulated again.
        recorded: How many of them have their states in `run.rrd`.
        metrics: How many metrics were compared.
        unchecked: The columns of `episodes.csv` whose metric is not known.
        versions: What differs between the run's versions and machine and the present ones; if nothing does, everything
            was compared to the last bit.
        differences: What differs between the run and its replay.
    """

    cases: int
    recorded: int
    metrics: int
    unchecked: list[str]
    versions: list[str]
    differences: list[Difference]

    def to_json(self) -> dict[str, Any]:
        """Everything as JSON has it, and whether the run agrees with its replay."""
        return {"agrees": not self.differences, **dataclasses.asdict(self)}

    def __str__(self) -> str:
        how = "outcomes exactly and figures to 1e-9" if self.versions else "to the last bit"
        states = f", the states of {self.recorded} episodes with run.rrd" if self.recorded else ""
        lines = [
            f"{self.cases} cases were simulated again from their commands and compared, {how}: outcomes, steps and "
            f"{self.metrics} metrics with episodes.csv, their summary with result.json{states}."
        ]
        if self.versions:
            lines.append(f"The last bits may differ, because {', '.join(self.versions)}.")
        if self.unchecked:
            lines.append(
                f"Not compared, because their metric is not known: {', '.join(self.unchecked)} (see --metric)."
            )
        if self.differences:
            return "\n".join([*lines, "The run is not what its commands lead to:", *map(str, self.differences)])
        lines.append(
            "All agree. This does not tell which planner gave the commands, nor how long it took or what it knew."
        )
        return "\n".join(lines)


def replay(
    files: RunFiles, scenario: Scenario, metrics: Mapping[str, Metric], progress: Callable[[float], None] | None = None
) -> Replay:
    """Simulate the cases of a run again and compare.

    Args:
        files: What the run has left.
        scenario: The scenario that its `result.json` describes, made again.
        metrics: Metrics by name; those are measured that the run has.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        What was compared, and what differs.

    Raises:
        InputError: The run has commands of none of its cases, or a pedestrian policy or a metric breaks its contract.
    """
    changed = _changed_versions(files)
    columns = dict.fromkeys([*files.episodes.columns, *files.result["metrics"]])
    measured = {name: metrics[name] for name in columns if name in metrics}
    parts: list[Episodes] = []
    wrong_states: list[str] = []
    for trace in traces(files, scenario, progress=progress):
        parts.append(Episodes.of(trace, measured))
        wrong_states += _wrong_states(files, trace, exact=not changed)
    replayed = Episodes.joined(parts)
    return Replay(
        cases=len(replayed),
        recorded=files.recorded,
        metrics=len(measured),
        unchecked=[name for name in columns if name not in metrics],
        versions=changed,
        differences=[
            *listed(f"checks of {MANIFEST} fail", [files.broken] if files.broken else [], 1),
            *_commands(files, scenario, replayed),
            *_episodes(files, replayed, exact=not changed),
            *_result(files, scenario, replayed, exact=not changed),
            *_recording(files, trace, scenario, wrong_states),
        ],
    )


def traces(
    files: RunFiles,
    scenario: Scenario,
    only: Collection[int] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Trace]:
    """Simulate cases of a run again, in order, and yield their traces batch by batch.

    Args:
        files: What the run has left.
        scenario: The scenario that its `result.json` describes, made again.
        only: The numbers of the wanted cases; None for every case that has commands.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Raises:
        InputError: The run has commands of none of these cases, or a pedestrian policy breaks its contract.
    """
    case, first = np.unique(files.commands.case, return_index=True)
    inside = (case >= files.cases.start) & (case < files.cases.stop)
    if only is not None:
        inside &= np.isin(case, list(only))
    case, first = case[inside], first[inside]
    if len(case) == 0:
        raise InputError(f"{COMMANDS} has no commands of the cases {files.cases}, so that nothing can be replayed")
    possible = _possible(files.commands, scenario)
    for rows in np.split(np.arange(len(case)), np.flatnonzero(np.diff(case) > 1) + 1):
        together = Cases(files.cases.split, int(case[rows[0]]), int(case[rows[-1]]) + 1)
        for part in together.batches(fitting(BATCH, scenario)):
            chosen = first[rows[part.start - together.start : part.stop - together.start]]
            command = files.commands.padded(chosen, scenario.rules.max_steps)
            command[~possible[chosen]] = 0.0  # the driver would end the replay at them
            driver = Driver(Playback(command), "of the replay")
            yield rollout(driver, scenario, part, progress=progress)


def _possible(recorded: Commands, scenario: Scenario) -> Bool[np.ndarray, "case"]:
    """Whether a run accepts all commands of each case: they are finite, and within the limits of the vehicle."""
    speed = np.full(len(recorded.command), scenario.vehicle_speed)
    with np.errstate(over="ignore"):
        is_within = scenario.rules.dynamics.is_within(recorded.command, speed)  # nothing that is not finite is
    row_of_step = np.repeat(np.arange(len(recorded.case)), recorded.steps)
    return np.bincount(row_of_step[~is_within], minlength=len(recorded.case)) == 0


def _wrong_states(files: RunFiles, trace: Trace, exact: bool) -> list[str]:
    """The episodes of a batch that `run.rrd` holds with other states; none where it is of another kind altogether."""
    if files.recording is None or _kind(files.recording.trace) != _kind(trace):
        return []
    recorded = files.recording.trace
    _, *rows = np.intersect1d(recorded.case, trace.case, return_indices=True)
    return differences.states(recorded, trace, (rows[0], rows[1]), exact)


def _commands(files: RunFiles, scenario: Scenario, replayed: Episodes) -> list[Difference]:
    """What is wrong with `commands.parquet`."""
    split, recorded = files.cases.split, files.commands
    refused = recorded.case[~_possible(recorded, scenario)].tolist()
    _, one, two = np.intersect1d(recorded.case, replayed.case, return_indices=True)
    lengths = zip(replayed.case[two].tolist(), recorded.steps[one].tolist(), replayed.steps[two].tolist(), strict=True)
    return [
        *differences.rows(COMMANDS, files.cases, recorded.case),
        *listed(
            f"cases in {COMMANDS} have commands that a run refuses, beyond the limits of the vehicle or not finite",
            [f"{split}:{case}" for case in refused],
            len(recorded.case),
        ),
        *listed(
            f"cases have more or fewer commands in {COMMANDS} than steps",
            [f"{split}:{case} ({n}, replayed: {steps})" for case, n, steps in lengths if n != steps],
            len(one),
        ),
    ]


def _episodes(files: RunFiles, replayed: Episodes, exact: bool) -> list[Difference]:
    """What is wrong with `episodes.csv`."""
    _, one, two = np.intersect1d(files.episodes.case, replayed.case, return_indices=True)
    return [
        *differences.rows(EPISODES, files.cases, files.episodes.case),
        *listed(
            f"metrics have no column in {EPISODES}",
            [name for name in replayed.columns if name not in files.episodes.columns],
            len(replayed.columns),
        ),
        *differences.episodes(files.cases.split, files.episodes.take(one), replayed.take(two), exact),
    ]


def _result(files: RunFiles, scenario: Scenario, replayed: Episodes, exact: bool) -> list[Difference]:
    """What is wrong with `result.json`."""
    result, metrics = files.result, files.result["metrics"]
    recorded = {
        "scenario": {"digest": result["scenario"].get("digest")},
        "outcomes": result.get("outcomes"),
        "metrics": {name: metrics.get(name) for name in replayed.columns},
        "recorded": result.get("recorded"),
    }
    again = {
        "scenario": {"digest": scenario.digest},
        "outcomes": replayed.counts(),
        "metrics": to_json(replayed.summary()),
        "recorded": files.recorded,
    }
    return differences.values(RESULT, recorded, again, exact)


def _recording(files: RunFiles, trace: Trace, scenario: Scenario, wrong_states: list[str]) -> list[Difference]:
    """What is wrong with `run.rrd`; `trace` is a part of the replay."""
    if files.recording is None:
        return []
    result, recording = files.result, files.recording
    label = planner_label(result["planner"], result["options"], replanning_of(result))
    recorded = {"planner": recording.planner, "scenario": recording.scenario_digest, **_kind(recording.trace)}
    return [
        *differences.values(RECORDING, recorded, {"planner": label, "scenario": scenario.digest, **_kind(trace)}, True),
        *differences.surplus(RECORDING, files.cases, recording.trace.case),
        *listed(f"episodes in {RECORDING} have other states", wrong_states, len(recording.trace)),
    ]


def _kind(trace: Trace) -> dict[str, Any]:
    """What two traces have in common whose states can be compared."""
    return {
        "split": trace.split,
        "agents": trace.position.shape[2],
        "undisturbed": trace.undisturbed is not None,
        "perceived": trace.perceived is not None,
        "rules": trace.rules.to_table(),
    }


def _changed_versions(files: RunFiles) -> list[str]:
    """What the last bits depend on and is not known to be the same as in the run."""
    recorded = files.result.get("versions")
    known = recorded if isinstance(recorded, dict) else {}
    changed = [
        f"{name} is {here} here and was {known.get(name, 'another')} in the run"
        for name, here in versions().items()
        if known.get(name) != here
    ]
    if files.code and files.code != seal.code():
        changed.append("the code of crowdbench is another than in the run")
    return changed
