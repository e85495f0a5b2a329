"""A run simulated again from its scenario, its cases and the recorded commands, without its planner.

The replay does not use the program that made the run, nor its planner: the files of the run are data.
States, outcomes and metrics follow from the commands and can be checked. The origin of the commands, their computation
time and the information used for them cannot be checked.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.types import Observation, Trace, World
from crowdbench.metrics.registry import Metric, need_undisturbed
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.results.episodes import EPISODES, RECORDING, Episodes
from crowdbench.results.result_file import RESULT
from crowdbench.results.run_result import RunResult
from crowdbench.results.stored_commands import COMMANDS, StoredCommands
from crowdbench.runs.differences import Difference, Differences
from crowdbench.runs.identity import code, source_of
from crowdbench.runs.rollout import Progress, rollout
from crowdbench.runs.run import fit_batch, read_versions
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError

Loader = Callable[[RunResult], Scenario]
"""Reconstructs the scenario of a simulated run."""

Watch = Callable[[World], None]
"""Called with the worlds before each step."""


class Playback(Planner):
    """Planner that returns given commands, in one batch of cases.

    Args:
        command: The commands of the vehicle's dynamics, by world and step.
        privileged: True if they come from a planner that uses information that no vehicle could measure.
    """

    native = True

    def __init__(self, command: Float[np.ndarray, "world step 2"], privileged: bool = False) -> None:
        self._command = command
        self.privileged = privileged

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the commands of this step."""
        return self._command[obs.row, obs.step]


@dataclass(frozen=True)
class Replay:
    """Result of a replay.

    Attributes:
        cases: Number of cases that were simulated again.
        recorded: Number of these cases with their states in `run.rrd`.
        metrics: Number of metrics that were compared.
        unchecked: The columns of `episodes.csv` whose metric is not known.
        versions: Differences between the versions and the machine of the run and of the replay. If empty, everything
            was compared to the last bit.
        differences: Differences between the run and its replay.
    """

    cases: int
    recorded: int
    metrics: int
    unchecked: list[str]
    versions: list[str]
    differences: list[Difference]

    def to_json(self) -> dict[str, Any]:
        """Return all fields as JSON values, and whether the run agrees with its replay."""
        return {"agrees": not self.differences, **dataclasses.asdict(self)}

    def __str__(self) -> str:
        how = "outcomes exactly and figures to 1e-6" if self.versions else "to the last bit"
        states = f", the states of {self.recorded} episodes with run.rrd" if self.recorded else ""
        lines = [
            f"{self.cases} cases were simulated again from their commands and compared, {how}: outcomes, steps and "
            f"{self.metrics} metrics with episodes.csv, their summary with result.json{states}."
        ]
        if self.versions:
            lines.append(f"The last bits may differ, because {', '.join(self.versions)}.")
        if self.unchecked:
            unknown = ", ".join(self.unchecked)
            lines.append(f"Not compared, because their metric is not known: {unknown} (see --metric).")
        if self.differences:
            return "\n".join([*lines, "The run is not what its commands lead to:", *map(str, self.differences)])
        lines.append(
            "All agree. Stated by the run alone: the planner with its options, `privileged`, names, times and versions."
        )
        return "\n".join(lines)


def replay_run(
    run: RunResult, scenario: Scenario, metrics: Mapping[str, Metric], progress: Progress | None = None
) -> Replay:
    """Simulate the cases of a run again and compare.

    Args:
        run: The stored run.
        scenario: The scenario, reconstructed from its `result.json`.
        metrics: Metrics by name; only metrics that the run contains are measured.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        The compared items and their differences.

    Raises:
        InputError: The run has no commands of any of its cases, or a pedestrian policy or a metric breaks its contract.
    """
    changed = _changed_versions(run)
    columns = dict.fromkeys([*run.episodes.columns, *run.result["metrics"]])
    measured = {name: metrics[name] for name in columns if name in metrics}
    differences = Differences(run.cases, exact=not changed)
    differences.note("checks of the files fail", [run.broken] if run.broken else [], 1)
    differences.note_values(RESULT, {"run.scenario": run.result["run"]["scenario"]}, {"run.scenario": scenario.digest})
    parts: list[Episodes] = []
    wrong_states: list[str] = []
    undisturbed = run.recording is not None or need_undisturbed(measured)
    for trace in traces(run, scenario, undisturbed=undisturbed, progress=progress):
        parts.append(Episodes.of(trace, measured))
        if run.recording is not None and _kind(run.recording.trace) == _kind(trace):
            wrong_states += differences.compare_states(run.recording.trace, trace)
    replayed = Episodes.join(parts)
    recorded = 0 if run.recording is None else len(run.recording.trace)
    _compare_commands(differences, run.commands, scenario, replayed)
    _compare_episodes(differences, run, replayed)
    if run.recording is not None:
        recording, kind = run.recording, _kind(trace)
        differences.note_values(RECORDING, _kind(recording.trace), kind)
        differences.note_rows(RECORDING, recording.trace.case, some_missing=True)
        differences.note(f"episodes in {RECORDING} have other states", wrong_states, recorded)
    unchecked = [name for name in columns if name not in metrics]
    return Replay(len(replayed), recorded, len(measured), unchecked, changed, list(differences))


def check_recorded(run: RunResult, recorded: Episodes, metrics: Mapping[str, Metric]) -> None:
    """Raise InputError if metrics of recorded states differ from those in `episodes.csv`.

    Args:
        run: The run.
        recorded: The episodes of its recording, with their metrics.
        metrics: The metrics by name. Metrics whose source differs from that in the run are not compared.
    """
    same = [name for name in recorded.columns if run.result["run"]["metrics"].get(name) == source_of(metrics[name])]
    rows = np.searchsorted(run.episodes.case, recorded.case)
    differences = Differences(run.cases, exact=False)
    columns = {name: recorded.columns[name] for name in same}
    differences.note_episodes(run.episodes.take(rows), dataclasses.replace(recorded, columns=columns))
    if differences:
        raise InputError(f"{run.directory / EPISODES} and {RECORDING} differ: {differences[0]}; make the run again")


def traces(
    run: RunResult,
    scenario: Scenario,
    only: Collection[int] | None = None,
    undisturbed: bool = True,
    progress: Progress | None = None,
    watch: Watch | None = None,
) -> Iterator[Trace]:
    """Simulate cases of a run again, in order, and yield their traces batch by batch.

    Args:
        run: The stored run.
        scenario: The scenario, reconstructed from its `result.json`.
        only: The numbers of the requested cases; None for every case that has commands.
        undisturbed: See `rollout`.
        progress: Called after each step with what it added to the episodes, in parts of an episode.
        watch: Called with the worlds before each step.

    Raises:
        InputError: The run has no commands of any of these cases, or a pedestrian policy breaks its contract.
    """
    case, first = np.unique(run.commands.case, return_index=True)
    inside = (case >= run.cases.start) & (case < run.cases.stop)
    if only is not None:
        inside &= np.isin(case, list(only))
    case, first = case[inside], first[inside]
    if len(case) == 0:
        raise InputError(f"{COMMANDS} has no commands of the cases {run.cases}, so that nothing can be replayed")
    possible = _possible(run.commands, scenario)
    for rows in np.split(np.arange(len(case)), np.flatnonzero(np.diff(case) > 1) + 1):
        together = Cases(run.cases.split, int(case[rows[0]]), int(case[rows[-1]]) + 1)
        for part in together.batches(fit_batch(BATCH, scenario)):
            chosen = first[rows[part.start - together.start : part.stop - together.start]]
            command = run.commands.pad(chosen, scenario.rules.max_steps)
            command[~possible[chosen]] = 0.0  # the driver would raise an error for them
            driver = Driver(Playback(command), "of the replay")
            yield rollout(driver, scenario, part, undisturbed=undisturbed, progress=progress, watch=watch)


def traces_of(run: RunResult, load: Loader, progress: Progress | None, watch: Watch | None = None) -> Iterator[Trace]:
    """Yield the traces of all cases of a run: simulated again, or recorded from the drives of a robot.

    Args:
        run: The stored run.
        load: Reconstructs the scenario of a simulated run.
        progress: See `traces`.
        watch: See `traces`.

    Raises:
        InputError: The run has no commands, or a pedestrian policy breaks its contract.
    """
    if run.drives is not None:
        yield run.drives
    else:
        yield from traces(run, load(run), undisturbed=False, progress=progress, watch=watch)


def record_case(run: RunResult, scenario: Scenario, case: int, path: Path) -> None:
    """Simulate a case of a run again from its commands, and write a recording of it.

    Args:
        run: The run.
        scenario: The scenario, reconstructed from its `result.json`.
        case: The number of the case.
        path: The recording to write.

    Raises:
        InputError: The run has no commands of the case, or the case ends differently from the run.
    """
    from crowdbench.record.write import Recorder

    (trace,) = traces(run, scenario, [case])
    episode = run.episodes.take(np.flatnonzero(run.episodes.case == case))
    if (trace.outcome[0], trace.steps[0]) != (episode.outcome[0], episode.steps[0]):
        raise InputError(
            f"case {case} of {run.directory} ends in another way when it is simulated again: make it again"
        )
    with Recorder(path, **run.header) as recorder:
        recorder.add(trace, np.array([0]), episode.columns)


def _possible(recorded: StoredCommands, scenario: Scenario) -> Bool[np.ndarray, "case"]:
    """Return for each case whether all commands are finite and within the limits of the vehicle, as a run requires."""
    speed = np.full(len(recorded.command), scenario.vehicle.preferred_speed)
    with np.errstate(over="ignore"):
        is_within = scenario.rules.dynamics.is_within(recorded.command, speed)  # False if not finite
    row_of_step = np.repeat(np.arange(len(recorded.case)), recorded.steps)
    return np.bincount(row_of_step[~is_within], minlength=len(recorded.case)) == 0


def _compare_commands(
    differences: Differences, commands: StoredCommands, scenario: Scenario, replayed: Episodes
) -> None:
    """Add the differences in `commands.parquet`."""
    differences.note_rows(COMMANDS, commands.case)
    refused = map(differences.name, commands.case[~_possible(commands, scenario)].tolist())
    what = "commands that a run refuses, beyond the limits of the vehicle or not finite"
    differences.note(f"cases in {COMMANDS} have {what}", refused, len(commands.case))
    case, *rows = np.intersect1d(commands.case, replayed.case, return_indices=True)
    numbers = commands.steps[rows[0]].tolist(), replayed.steps[rows[1]].tolist()
    lengths = zip(map(differences.name, case.tolist()), *numbers, strict=True)
    differences.note_pairs(f"cases have more or fewer commands in {COMMANDS} than steps", lengths, len(case))


def _compare_episodes(differences: Differences, run: RunResult, replayed: Episodes) -> None:
    """Add the differences in `episodes.csv`."""
    differences.note_rows(EPISODES, run.episodes.case)
    missing = (name for name in replayed.columns if name not in run.episodes.columns)
    differences.note(f"metrics have no column in {EPISODES}", missing, len(replayed.columns))
    _, *rows = np.intersect1d(run.episodes.case, replayed.case, return_indices=True)
    differences.note_episodes(run.episodes.take(rows[0]), replayed.take(rows[1]))


def _kind(trace: Trace) -> dict[str, Any]:
    """Return the properties that must be equal in two traces, so that their states can be compared."""
    return {
        "split": trace.split,
        "agents": trace.position.shape[2],
        "undisturbed": trace.undisturbed is not None,
        "perceived": trace.perceived is not None,
        "rules": trace.rules.to_table(),
    }


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
