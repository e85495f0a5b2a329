"""Stored runs as traces: simulated again from their scenario and commands, without the planner, or read from tracks.

The simulation uses neither the program that made the run nor its planner: the files of the run are data.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.types import Observation, Trace, World
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.results.episodes import RECORDING
from crowdbench.results.run_result import RunResult
from crowdbench.results.stored_commands import COMMANDS, StoredCommands
from crowdbench.runs.rollout import Progress, rollout
from crowdbench.runs.run import fit_batch
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError

Loader = Callable[[RunResult], Scenario]
"""Loads the scenario of a simulated run, see `loading.load_stored_scenario`."""

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


def stored_traces(
    run: RunResult,
    load: Loader,
    only: Collection[int] | None = None,
    *,
    undisturbed: bool = False,
    progress: Progress | None = None,
    watch: Watch | None = None,
) -> Iterator[Trace]:
    """Yield the traces of a stored run: one of its tracks, or batches that are simulated again from its commands.

    Args:
        run: The stored run.
        load: Loads the scenario of a simulated run.
        only: The numbers of the requested cases, if the run is simulated; None for every case that has commands.
        undisturbed: See `rollout`.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.
        watch: Called with the worlds before each step.

    Raises:
        InputError: The run has no commands of any of these cases, or a pedestrian policy breaks its contract.
    """
    if not run.is_simulated:
        yield run.tracks
        return
    case, first = np.unique(run.commands.case, return_index=True)
    inside = (case >= run.cases.start) & (case < run.cases.stop)
    if only is not None:
        inside &= np.isin(case, list(only))
    case, first = case[inside], first[inside]
    if len(case) == 0:
        raise InputError(f"{COMMANDS} has no commands of the cases {run.cases}, so that nothing can be simulated again")
    scenario = load(run)
    possible = possible_commands(run.commands, scenario)
    for rows in np.split(np.arange(len(case)), np.flatnonzero(np.diff(case) > 1) + 1):
        together = Cases(run.cases.split, int(case[rows[0]]), int(case[rows[-1]]) + 1)
        for part in together.batches(fit_batch(BATCH, scenario)):
            chosen = first[rows[part.start - together.start : part.stop - together.start]]
            command = run.commands.pad(chosen, scenario.rules.max_steps)
            command[~possible[chosen]] = 0.0  # the driver would raise an error for them
            driver = Driver(Playback(command), "of the replay")
            yield rollout(driver, scenario, part, undisturbed=undisturbed, progress=progress, watch=watch)


def possible_commands(recorded: StoredCommands, scenario: Scenario) -> Bool[np.ndarray, "case"]:
    """Return for each case whether all commands are finite and within the limits of the vehicle, as a run requires."""
    speed = np.full(len(recorded.command), scenario.vehicle.preferred_speed)
    with np.errstate(over="ignore"):
        is_within = scenario.rules.dynamics.is_within(recorded.command, speed)  # False if not finite
    row_of_step = np.repeat(np.arange(len(recorded.case)), recorded.steps)
    return np.bincount(row_of_step[~is_within], minlength=len(recorded.case)) == 0


def stored_case(run: RunResult, load: Loader, case: int) -> tuple[Trace, int]:
    """Return a trace with one case of a stored run, and the row of the case.

    Args:
        run: The stored run.
        load: Loads the scenario of a simulated run.
        case: The number of the case.

    Raises:
        InputError: The run has no commands of the case, or the case ends differently from the run.
    """
    (trace,) = stored_traces(run, load, [case])
    (row,) = np.flatnonzero(trace.case == case).tolist()
    episode = run.episodes.take(np.flatnonzero(run.episodes.case == case))
    if (trace.outcome[row], trace.steps[row]) != (episode.outcome[0], episode.steps[0]):
        raise InputError(
            f"case {case} of {run.directory} ends in another way when it is simulated again: make the run again"
        )
    return trace, row


def recording_of(run: RunResult, load: Loader, case: int, folder: Path) -> Path:
    """Return a recording with a case of a stored run: that of the run, or else a new one without the decisions.

    Args:
        run: The stored run.
        load: Loads the scenario of a simulated run.
        case: The number of the case.
        folder: The folder of a new recording.

    Raises:
        InputError: As `stored_case` does.
    """
    from crowdbench.record.recorded_cases import recorded_outcomes
    from crowdbench.record.write import Recorder

    recording = run.directory / RECORDING
    if recording.exists() and case in recorded_outcomes(recording):
        return recording
    trace, row = stored_case(run, load, case)
    values = run.episodes.take(np.flatnonzero(np.isin(run.episodes.case, trace.case))).columns
    with Recorder(folder / RECORDING, **run.header) as recorder:
        recorder.add(trace, np.array([row]), values)
    return folder / RECORDING
