"""Stored runs as traces: simulated again from their scenario and commands, without the planner, or read from tracks.

The simulation uses neither the program that made the run nor its planner: the files of the run are data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Observation, Trace, World
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.results.episodes import RECORDING
from crowdbench.results.run_result import RunResult
from crowdbench.runs.recording import shown_rows
from crowdbench.runs.rollout import Progress, rollout
from crowdbench.runs.run import fit_batch
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError

Loader = Callable[[RunResult], Scenario]
"""Loads the scenario of a simulated run, see `loading.load_stored_scenario`."""


class Playback(Planner):
    """Planner that returns given commands, in one batch of cases.

    Args:
        command: The commands of the vehicle's dynamics, by world and step.
        privileged: True if they come from a planner that uses information that no vehicle could measure.
        raw: True if they come from a planner that observes the detections of a detector without its tracker.
    """

    native = True

    def __init__(self, command: Float[np.ndarray, "world step 2"], privileged: bool = False, raw: bool = False) -> None:
        self._command = command
        self.privileged = privileged
        self.raw = raw

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the commands of this step."""
        return self._command[obs.row, obs.step]


def stored_traces(
    run: RunResult,
    load: Loader,
    cases: Cases | None = None,
    *,
    undisturbed: bool = False,
    progress: Progress | None = None,
    watch: Callable[[World], None] | None = None,
) -> Iterator[Trace]:
    """Yield the traces of a stored run: one of its tracks, or batches that are simulated again from its commands.

    Args:
        run: The stored run.
        load: Loads the scenario of a simulated run.
        cases: The requested cases, if the run is simulated; None for all.
        undisturbed: See `rollout`.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.
        watch: Called with the worlds before each step.

    Raises:
        InputError: The run has no commands, or other ones than a vehicle can execute, or a pedestrian policy breaks its
            contract.
    """
    if not run.is_simulated:
        yield run.tracks
        return
    scenario = load(run)
    for part in (cases or run.cases).batches(fit_batch(BATCH, scenario)):
        command = run.commands.pad(part, scenario.rules.max_steps)
        driver = Driver(Playback(command, raw=run.result["stated"].get("raw", False)), "of the replay")
        yield rollout(driver, scenario, part, undisturbed=undisturbed, progress=progress, watch=watch)


def stored_case(run: RunResult, load: Loader, case: int, *, undisturbed: bool = False) -> tuple[Trace, int]:
    """Return a trace with one case of a stored run, and the row of the case.

    Args:
        run: The stored run.
        load: Loads the scenario of a simulated run.
        case: The number of the case.
        undisturbed: See `rollout`.

    Raises:
        InputError: The run has no commands of the case, or the case ends differently from the run.
    """
    (trace,) = stored_traces(run, load, Cases(run.cases.split, case, case + 1), undisturbed=undisturbed)
    (row,) = np.flatnonzero(shown_rows(trace)).tolist()
    episode = run.episodes.take(np.flatnonzero(run.episodes.case == case))
    if any((getattr(trace, name)[: len(episode)] != getattr(episode, name)).any() for name in ("outcome", "steps")):
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
    episodes = run.episodes.take(np.isin(run.episodes.case, trace.case))
    with Recorder(folder / RECORDING, **run.header) as recorder:  # vehicles of other planners have no values
        recorder.add(trace, np.array([row]), episodes.columns if row < len(episodes) else {})
    return folder / RECORDING
